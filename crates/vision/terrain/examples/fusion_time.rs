//! Time of fusion and meshing of simulated depth images: `fusion_time [THREADS] [VOXEL_M]`.
//!
//! Prints milliseconds of processor time per view, of all threads together and without making the
//! images, and counts of the volume.

#[path = "../tests/scene/mod.rs"]
mod scene;

use scene::{Noise, VGA, climb, stairs};
use terrain::FusionConfig;
use terrain::fusion::Volume;

/// Time on processors of all threads of this process, ms: on a machine that does other work as well,
/// the wall clock shows that work.
fn processor_ms() -> std::io::Result<f64> {
    let mut sum = 0.0;
    for task in std::fs::read_dir("/proc/self/task")? {
        let text = std::fs::read_to_string(task?.path().join("schedstat"))?;
        let first = text.split(' ').next().and_then(|ns| ns.parse::<f64>().ok());
        sum += 1e-6 * first.unwrap_or(f64::NAN);
    }
    Ok(sum)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
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
        // The first round allocates, the second only updates.
        let mut volume = Volume::new(config)?;
        for round in 0..3 {
            let start = processor_ms()?;
            pool.install(|| shots.iter().try_for_each(|shot| volume.add(&shot.view())))?;
            let each = (processor_ms()? - start) / shots.len() as f64;
            println!(
                "{name}, round {round}: {each:.2} ms a view on {threads} threads, {:?}",
                volume.stats()
            );
        }
    }
    Ok(())
}
