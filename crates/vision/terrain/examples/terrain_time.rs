//! Time of all steps on simulated depth images: `terrain_time [THREADS] [VOXEL_M]`.
//!
//! Prints milliseconds of processor time per view, of all threads together and without making the
//! images, and counts of the volume.

#[path = "../tests/scene/mod.rs"]
mod scene;

use scene::{Noise, Shot, VGA, climb, stairs};
use terrain::convex::collision_parts;
use terrain::edges::{find_edges, snap};
use terrain::fusion::Volume;
use terrain::maps::build;
use terrain::mesh::Mesh;
use terrain::planes::PlaneRefiner;
use terrain::simplify::simplify;
use terrain::{
    ConvexConfig, EdgeConfig, FusionConfig, MapConfig, MeshConfig, PlaneConfig, SimplifyConfig,
};

/// Time on processors of all threads of this process, ms: on a machine that does other work as
/// well, the wall clock shows that work.
fn processor_ms() -> std::io::Result<f64> {
    let mut sum = 0.0;
    for task in std::fs::read_dir("/proc/self/task")? {
        let text = std::fs::read_to_string(task?.path().join("schedstat"))?;
        let first = text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok());
        sum += 1e-6 * first.unwrap_or(f64::NAN);
    }
    Ok(sum)
}

fn main() -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    let mut arguments = std::env::args().skip(1);
    let threads = arguments.next().map_or(Ok(2), |text| text.parse())?;
    let mut config = FusionConfig::default();
    if let Some(text) = arguments.next() {
        config.voxel_m = text.parse()?;
    }
    let camera = scene::Camera {
        size: [640, 480],
        line_s: 17e-6,
        ..VGA
    };
    let noise = Noise {
        disparity_px: 0.15,
        pose_m: 0.002,
        seed: 1,
        ..Noise::default()
    };
    let scene = stairs(6);
    for (name, pitch) in [
        ("feet camera, 70 degrees down", 1.22),
        ("shoulder camera, 30 degrees down", 0.52),
    ] {
        let shots = climb(&scene, camera, [-1.0, 1.4], pitch, noise);
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()?;
        println!("{name}, {} views, {threads} threads:", shots.len());
        pool.install(|| steps(&shots, config))?;
    }
    Ok(())
}

/// Prints the time of every step.
fn steps(
    shots: &[Shot],
    config: FusionConfig,
) -> Result<(), Box<dyn std::error::Error + Send + Sync>> {
    let mut start = processor_ms()?;
    let mut lap = |name: &str, count: usize| {
        let now = processor_ms()?;
        println!("  {name:<28} {:9.2} ms", (now - start) / count as f64);
        start = now;
        std::io::Result::Ok(())
    };
    let mut volume = Volume::new(config)?;
    // The first round allocates, the second only updates.
    for round in ["fusion, a new view", "fusion, a view seen before"] {
        shots.iter().try_for_each(|shot| volume.add(&shot.view()))?;
        lap(round, shots.len())?;
    }
    println!("  {:?}", volume.stats());
    let mut mesh = Mesh::of(&volume, &MeshConfig::default());
    lap("mesh", 1)?;
    let mut refiner = PlaneRefiner::new(&mesh, &PlaneConfig::default());
    lap("candidates of planes", 1)?;
    shots
        .iter()
        .try_for_each(|shot| refiner.add(&shot.view()))?;
    lap("planes, a view", shots.len())?;
    let planes = refiner.finish();
    lap("planes", 1)?;
    let edges = find_edges(&planes, &EdgeConfig::default());
    lap("edges", 1)?;
    snap(&mut mesh, &planes, &edges, config.voxel_m);
    lap("snapping", 1)?;
    let levels = build(&mesh, &edges, &[], &MapConfig::default());
    lap("maps", 1)?;
    let parts = collision_parts(&planes, &edges, &levels, &ConvexConfig::default());
    lap("convex parts", 1)?;
    let (simplified, _) = simplify(&mesh, &SimplifyConfig::default());
    lap("simplification", 1)?;
    println!(
        "  {} triangles, {} planes, {} edges, {} parts, {} triangles after simplification",
        mesh.triangles.len(),
        planes.planes.len(),
        edges.len(),
        parts.report.parts,
        simplified.triangles.len()
    );
    Ok(())
}
