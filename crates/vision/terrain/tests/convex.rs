//! Convex parts of analytic scenes.

mod scene;

use scene::surface::snapped_surface_of;
use scene::{Camera, HD720, Noise, RISE_M, Scene, Shot, Solid, climb, stairs};
use terrain::convex::{Collision, collision_parts};
use terrain::maps::build;
use terrain::planes::{Plane, PlaneOutline, Planes};
use terrain::{ConvexConfig, MapConfig, PlaneConfig};

fn collision(shots: &[Shot], configs: &[ConvexConfig]) -> (Planes, Vec<Collision>) {
    let (mesh, planes, edges) = snapped_surface_of(shots);
    let levels = build(&mesh, &edges, &[], &MapConfig::default());
    let all = configs
        .iter()
        .map(|config| collision_parts(&planes, &edges, &levels, config));
    let all = all.collect();
    (planes, all)
}

const NOISE: Noise = Noise {
    disparity_px: 0.15,
    pose_m: 0.002,
    pose_rad: 0.001,
    seed: 6,
    ..scene::CLEAN
};

#[test]
fn stairs_need_few_parts() {
    let mut fine = ConvexConfig::default();
    (fine.max_uncovered_share, fine.max_uncovered_m2) = (0.005, 0.0005);
    let shots = climb(&stairs(4), HD720, [-0.8, 0.8], 1.05, NOISE);
    let (planes, all) = collision(&shots, &[ConvexConfig::default(), fine]);
    println!("{:?}", all.iter().map(|of| of.report).collect::<Vec<_>>());
    let report = &all[0].report;
    assert!(report.height_errors.p95_m <= 0.010, "{report:?}");
    assert!(report.height_errors.median_m <= 0.003, "{report:?}");
    assert!(report.parts_per_100_m2 <= 500.0, "{report:?}");
    assert!(
        report.volume_added_m3 < 0.012 && report.volume_missing_m3 < 0.005,
        "{report:?}"
    );
    assert!(all[1].report.parts > report.parts, "{:?}", all[1].report);
    let second = planes
        .planes
        .iter()
        .position(|plane| plane.normal[2] > 0.99 && (plane.center[2] - 2.0 * RISE_M).abs() < 0.02);
    let of_tread = all[0]
        .parts
        .iter()
        .filter(|part| part.plane as usize == second.unwrap());
    let volume: f64 = of_tread.clone().map(|part| part.volume_m3()).sum();
    println!("{} parts of a tread, {volume} m3", of_tread.clone().count());
    assert!(of_tread.count() <= 3);
    assert!((volume / (0.2 * 0.29 * 2.0) - 1.0).abs() < 0.15, "{volume}");
}

#[test]
fn planes_of_files_give_the_same_ground() {
    let shots = climb(&stairs(3), HD720, [-0.8, 0.4], 1.05, NOISE);
    let (mesh, planes, edges) = snapped_surface_of(&shots);
    let levels = build(&mesh, &edges, &[], &MapConfig::default());
    let outlines = planes.planes.iter().map(PlaneOutline::from);
    let stored = Planes {
        planes: outlines
            .map(|outline| Plane::of_outline(&outline, &PlaneConfig::default()))
            .collect(),
        ..planes.clone()
    };
    for (plane, of_file) in planes.planes.iter().zip(&stored.planes) {
        let share = of_file.area_m2 / plane.area_m2;
        assert!((share - 1.0).abs() < 0.1, "{share} of {} m2", plane.area_m2);
        assert_eq!(PlaneOutline::from(of_file), PlaneOutline::from(plane));
    }
    let parts = |planes| collision_parts(planes, &edges, &levels, &ConvexConfig::default()).report;
    let (of_depths, of_files) = (parts(&planes), parts(&stored));
    println!("{of_depths:?}\n{of_files:?}");
    assert!(of_files.height_errors.p95_m <= 0.010);
    assert!(of_files.parts <= of_depths.parts * 5 / 4);
    assert!(of_files.volume_missing_m3 < 0.005 && of_files.volume_added_m3 < 0.012);
}

#[test]
fn parts_are_convex_and_closed() {
    let shots = climb(&stairs(2), HD720, [-0.6, 0.0], 1.05, NOISE);
    let (_, all) = collision(&shots, &[ConvexConfig::default()]);
    assert!(all[0].parts.len() > 3);
    for part in &all[0].parts {
        assert!(part.volume_m3() > 0.0);
        for triangle in &part.triangles {
            let [a, b, c] = triangle.map(|i| part.vertices[i as usize]);
            let minus = |p: [f64; 3]| [p[0] - a[0], p[1] - a[1], p[2] - a[2]];
            let (u, v) = (minus(b), minus(c));
            let n = [
                u[1] * v[2] - u[2] * v[1],
                u[2] * v[0] - u[0] * v[2],
                u[0] * v[1] - u[1] * v[0],
            ];
            let norm = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]).sqrt().max(1e-12);
            // Sides that flare are slightly bent.
            for p in &part.vertices {
                let d = minus(*p);
                let height = (n[0] * d[0] + n[1] * d[1] + n[2] * d[2]) / norm;
                assert!(height < 0.011, "{height} m in front of a face");
            }
        }
    }
}

#[test]
fn rough_ground_is_in_the_height_layer() {
    let rough: fn(f64, f64) -> f64 = |x, y| 0.04 * (8.0 * x + 1.0).sin() * (7.0 * y).cos();
    let camera = Camera {
        size: [336, 188],
        focal_px: 184.0,
        baseline_m: 0.126,
        ..HD720
    };
    let scene = Scene {
        solids: vec![Solid::Ground(rough)],
    };
    let (_, all) = collision(
        &climb(&scene, camera, [0.0, 0.8], 1.1, NOISE),
        &[ConvexConfig::default()],
    );
    let of = &all[0];
    println!("{:?}", of.report);
    assert!(of.report.height_errors.p95_m <= 0.010 && of.report.height_errors.count > 500);
    let layer = &of.layers[0];
    let error = |i: usize| {
        let [x, y] = [i % layer.size[0], i / layer.size[0]];
        let x = layer.origin[0] + x as f64 * layer.cell_m;
        let y = layer.origin[1] + y as f64 * layer.cell_m;
        (f64::from(layer.heights[i]) - rough(x, y)).abs()
    };
    let errors = terrain::evaluate::ErrorQuantiles::of((0..layer.heights.len()).map(error));
    assert!(errors.median_m < 0.01, "{errors:?}");
}
