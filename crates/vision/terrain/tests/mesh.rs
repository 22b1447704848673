//! The mesh on analytic scenes.

mod scene;

use scene::surface::mesh_of;
use scene::{HD720, Noise, RISE_M, Scene, Shot, Solid, climb, pose, shoot, stairs};
use terrain::evaluate::{height_errors, surface_errors, two_sigma_share};

fn stairs_shots(disparity_px: f64) -> Vec<Shot> {
    let noise = Noise {
        disparity_px,
        pose_m: 0.001,
        pose_rad: 0.0005,
        seed: 4,
        ..scene::CLEAN
    };
    let camera = scene::Camera {
        line_s: 15e-6,
        ..HD720
    };
    climb(&stairs(4), camera, [-0.8, 0.8], 1.0, noise)
}

#[test]
fn stairs_stay_stairs() {
    let scene = stairs(4);
    let mesh = mesh_of(&stairs_shots(0.15));
    let errors = surface_errors(&mesh, |p| scene.distance(p));
    println!("surface {errors:?}");
    assert!(
        errors.count > 3000 && errors.median_m < 0.003 && errors.p95_m < 0.010,
        "{errors:?}"
    );
    // Nothing hangs in the air.
    assert!(errors.max_m < 0.03, "{errors:?}");
    // Heights away from the edges.
    let going = scene::GOING_M;
    let heights = height_errors(&mesh, |x, y| {
        let from_edge = (x - going * (x / going).round()).abs();
        (from_edge > 0.03 && y.abs() < 0.9)
            .then(|| scene.height(x, y))
            .flatten()
    });
    println!("heights {heights:?}");
    assert!(
        heights.median_m < 0.004 && heights.p95_m < 0.01,
        "{heights:?}"
    );
    let share = two_sigma_share(&mesh, |p| scene.distance(p));
    println!("two sigma {share}");
    assert!(share > 0.9, "{share}");
    // Colors are those of the treads.
    let on_tread = |p: &[f32; 3]| p[2] > 0.1 && p[0] > 0.05;
    let colored = mesh
        .positions
        .iter()
        .zip(&mesh.colors)
        .filter(|(p, _)| on_tread(p));
    assert!(colored.clone().count() > 500);
    assert!(colored.filter(|(_, c)| c[0] != 120).count() < 20);
}

#[test]
fn unseen_risers_are_holes() {
    // From above, with no view of the risers.
    let noise = Noise {
        disparity_px: 0.05,
        seed: 2,
        ..Noise::default()
    };
    let scene = stairs(3);
    let shots = climb(&scene, HD720, [0.8, -0.4], 1.3, noise);
    let mesh = mesh_of(&shots);
    let riser = |p: &[f32; 3]| {
        // Between two treads, in the plane of the riser.
        let height = f64::from(p[2]).rem_euclid(RISE_M);
        (0.04..RISE_M - 0.04).contains(&height)
    };
    let invented = mesh.positions.iter().filter(|p| riser(p)).count();
    let treads = mesh.positions.len();
    assert!(
        treads > 1000 && invented * 200 < treads,
        "{invented} of {treads}"
    );
}

#[test]
fn the_shade_of_a_shoe_is_a_hole() {
    let floor = Scene {
        solids: vec![Solid::Ground(|_, _| 0.0)],
    };
    let mut shot = shoot(
        &floor,
        HD720,
        pose([0.0, 0.0, 1.2], 0.0, 1.3),
        Default::default(),
        Noise::default(),
    );
    let [width, height] = HD720.size;
    let inside = |pixel: usize| {
        let (u, v) = (pixel % width, pixel / width);
        u.abs_diff(width / 2) < 60 && v.abs_diff(height / 2) < 100
    };
    for pixel in (0..width * height).filter(|pixel| inside(*pixel)) {
        shot.depth_m[pixel] = f32::NAN;
    }
    let mesh = mesh_of(&[shot]);
    // Center of the hole on the floor: 17 degrees ahead of straight down.
    let in_hole = |p: &&[f32; 3]| (p[0] - 0.33).abs() < 0.1 && p[1].abs() < 0.05;
    assert_eq!(mesh.positions.iter().filter(in_hole).count(), 0);
    let beside = |p: &&[f32; 3]| (p[0] - 0.33).abs() < 0.1 && (p[1] - 0.3).abs() < 0.05;
    assert!(mesh.positions.iter().filter(beside).count() > 30);
    assert!(mesh.positions.iter().all(|p| p[2].abs() < 1e-3));
    // Triangles face up.
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| mesh.positions[i as usize]);
        let up = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
        assert!(up > 0.0);
    }
}

#[test]
fn every_number_of_threads_gives_the_same_mesh() {
    let shots = stairs_shots(0.2);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| mesh_of(&shots[..3]))
    };
    assert_eq!(on(1), on(3));
}
