//! Simplification on analytic scenes.

mod carpet;
mod scene;

use carpet::carpet;
use scene::surface::snapped_surface_of;
use scene::{Noise, VGA, climb, stairs};
use terrain::SimplifyConfig;
use terrain::mesh::Mesh;
use terrain::simplify::{collapse, height_errors, simplify};

const NOISE: Noise = Noise {
    disparity_px: 0.1,
    pose_m: 0.001,
    pose_rad: 0.0005,
    seed: 4,
    ..scene::CLEAN
};

#[test]
fn stairs_need_few_triangles() {
    let (mesh, ..) = snapped_surface_of(&climb(&stairs(3), VGA, [-0.6, 0.6], 1.0, NOISE));
    let (simplified, report) = simplify(&mesh, &SimplifyConfig::default());
    println!("{report:?}");
    assert!(
        report.triangles_after * 3 < report.triangles_before,
        "{report:?}"
    );
    assert!(report.height_errors.p95_m <= 0.002 && report.beyond_share <= 0.005);
    assert_eq!(simplified.triangles.len(), report.triangles_after);
    for triangle in &simplified.triangles {
        assert!(
            triangle
                .iter()
                .all(|i| (*i as usize) < simplified.positions.len())
        );
    }
    // The area remains: nothing folds and no hole opens.
    let area = |mesh: &Mesh| mesh.triangles.iter().map(|t| mesh.area_m2(*t)).sum::<f64>();
    assert!((area(&simplified) / area(&mesh) - 1.0).abs() < 0.03);
}

#[test]
fn rough_ground_keeps_more_triangles_than_smooth_ground() {
    let rough = carpet([100, 100], |x, y| {
        Some(0.03 * (9.0 * x).sin() * (8.0 * y).cos())
    });
    let slope = carpet([100, 100], |x, y| Some(0.2 * x - 0.1 * y));
    let [rough, slope] = [rough, slope].map(|mesh| {
        let (_, report) = simplify(&mesh, &SimplifyConfig::default());
        println!("{report:?}");
        assert!(report.height_errors.p95_m <= 0.002 && report.beyond_share <= 0.005);
        report.triangles_after
    });
    assert!(
        slope < 100 && rough > 10 * slope && rough < 10_000,
        "{rough} {slope}"
    );
}

#[test]
fn simplification_is_deterministic_and_holes_stay_holes() {
    let (mesh, ..) = snapped_surface_of(&climb(&stairs(2), VGA, [-0.4, 0.2], 1.0, NOISE));
    let simplified = collapse(&mesh, 0.004);
    assert_eq!(simplified, collapse(&mesh, 0.004));
    // Euler characteristic: each hole and each part counts.
    let euler = |mesh: &Mesh| {
        let sides: std::collections::BTreeSet<(u32, u32)> = mesh
            .triangles
            .iter()
            .flat_map(|[a, b, c]| [(a, b), (b, c), (c, a)].map(|(a, b)| (*a.min(b), *a.max(b))))
            .collect();
        (mesh.positions.len() + mesh.triangles.len()) as i64 - sides.len() as i64
    };
    assert_eq!(euler(&simplified), euler(&mesh));
    assert!(simplified.triangles.len() * 2 < mesh.triangles.len());
    assert_eq!(collapse(&Mesh::default(), 0.01), Mesh::default());
    let errors = height_errors(&mesh, &Mesh::default(), 0.7);
    assert_eq!(errors.median_m, 0.5);
}
