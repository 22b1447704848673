//! Simplification on analytic scenes.

mod scene;

use scene::{Noise, Scene, Shot, Solid, VGA, climb, stairs};
use terrain::edges::{find_edges, snap};
use terrain::fusion::Volume;
use terrain::mesh::Mesh;
use terrain::planes::PlaneRefiner;
use terrain::simplify::{collapse, height_errors, simplify};
use terrain::{EdgeConfig, FusionConfig, MeshConfig, PlaneConfig, SimplifyConfig};

fn snapped(shots: &[Shot]) -> Mesh {
    let mut volume = Volume::new(FusionConfig::default()).unwrap();
    shots.iter().for_each(|shot| volume.add(&shot.view()).unwrap());
    let mut mesh = Mesh::of(&volume, &MeshConfig::default());
    let mut refiner = PlaneRefiner::new(&mesh, &PlaneConfig::default());
    shots.iter().for_each(|shot| refiner.add(&shot.view()).unwrap());
    let planes = refiner.finish();
    let edges = find_edges(&planes, &EdgeConfig::default());
    snap(&mut mesh, &planes, &edges, 0.02);
    mesh
}

const NOISE: Noise = Noise { disparity_px: 0.1, pose_m: 0.001, pose_rad: 0.0005, seed: 4 };

#[test]
fn stairs_need_few_triangles() {
    let mesh = snapped(&climb(&stairs(3), VGA, [-0.6, 0.6], 1.0, NOISE));
    let (simplified, report) = simplify(&mesh, &SimplifyConfig::default());
    println!("{report:?}");
    assert!(report.triangles_after * 5 < report.triangles_before, "{report:?}");
    assert!(report.height_errors.p95_m <= 0.002 && report.height_errors.max_m <= 0.010);
    assert_eq!(simplified.triangles.len(), report.triangles_after);
    for triangle in &simplified.triangles {
        assert!(triangle.iter().all(|i| (*i as usize) < simplified.positions.len()));
        assert!(simplified.area_m2(*triangle) > 0.0);
    }
    // The area stays: nothing folds and no hole opens.
    let area = |mesh: &Mesh| mesh.triangles.iter().map(|t| mesh.area_m2(*t)).sum::<f64>();
    assert!((area(&simplified) / area(&mesh) - 1.0).abs() < 0.03);
}

#[test]
fn rough_ground_keeps_more_triangles_than_smooth_ground() {
    let rough: fn(f64, f64) -> f64 = |x, y| 0.03 * (9.0 * x).sin() * (8.0 * y).cos();
    let flat: fn(f64, f64) -> f64 = |_, _| 0.0;
    let camera = scene::Camera { size: [336, 188], focal_px: 184.0, baseline_m: 0.126, ..VGA };
    let [rough, flat] = [rough, flat].map(|ground| {
        let scene = Scene { solids: vec![Solid::Ground(ground)] };
        let mesh = snapped(&climb(&scene, camera, [0.0, 0.4], 1.1, NOISE));
        let (_, report) = simplify(&mesh, &SimplifyConfig::default());
        println!("{report:?}");
        report.triangles_after as f64 / report.triangles_before as f64
    });
    assert!(rough > 3.0 * flat, "{rough} {flat}");
}

#[test]
fn simplification_is_deterministic_and_holes_stay_holes() {
    let mesh = snapped(&climb(&stairs(2), VGA, [-0.4, 0.2], 1.0, NOISE));
    let simplified = collapse(&mesh, 0.004);
    assert_eq!(simplified, collapse(&mesh, 0.004));
    let borders = |mesh: &Mesh| {
        let mut sides = std::collections::BTreeMap::new();
        for [a, b, c] in &mesh.triangles {
            for (from, to) in [(a, b), (b, c), (c, a)] {
                *sides.entry((from.min(to), from.max(to))).or_insert(0) += 1;
            }
        }
        sides.values().filter(|count| **count == 1).count()
    };
    assert_eq!(borders(&simplified), borders(&mesh));
    assert_eq!(collapse(&Mesh::default(), 0.01), Mesh::default());
    let errors = height_errors(&mesh, &Mesh::default(), 0.7);
    assert_eq!(errors.median_m, 0.5);
}
