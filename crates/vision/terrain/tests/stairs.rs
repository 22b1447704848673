//! Planes, step edges and riser heights of analytic stairs, of slopes and of rough ground.

mod scene;

use scene::score::{noise, p95, score, total, walk};
use scene::surface::surface_of;
use scene::{
    Camera, GOING_M, HD720, Noise, RISE_M, Scene, Solid, VGA, climb, join_steps, shoot, stairs,
};
use terrain::PlaneConfig;
use terrain::edges::{EdgeKind, snap};
use terrain::mesh::Mesh;
use terrain::planes::PlaneRefiner;

fn check(name: &str, camera: Camera, up: bool, disparity_px: f64, limits: [f64; 2]) {
    check_with(name, camera, up, noise(disparity_px, 0), limits);
}

fn check_with(name: &str, camera: Camera, up: bool, of: Noise, limits: [f64; 2]) {
    // Views of the small camera cost less.
    let walks = if camera.size[0] > 1000 { 1 } else { 2 };
    let scores = (0..walks).map(|seed| {
        let seed = seed + 1;
        let shots = walk(camera, 4, up, Noise { seed, ..of });
        score(&surface_of(&shots).2, 4)
    });
    let score = total(scores);
    let [height, place] = [p95(&score.heights), p95(&score.places)];
    println!(
        "{name}: {} of {} steps, height p95 {:.1} mm, place p95 {:.1} mm, {} of {} within two sigmas, {} invented",
        score.found,
        score.expected,
        1e3 * height,
        1e3 * place,
        score.within,
        2 * score.heights.len(),
        score.invented
    );
    assert!(
        score.found == score.expected && score.invented == 0,
        "{score:?}"
    );
    assert!(height <= limits[0] && place <= limits[1], "{score:?}");
    assert!(
        score.within * 10 >= 2 * score.heights.len() * 8,
        "{score:?}"
    );
}

#[test]
fn steps_going_up_at_hd720() {
    check("HD720 up", HD720, true, 0.15, [0.003, 0.010]);
}

#[test]
fn steps_going_down_at_hd720() {
    check("HD720 down", HD720, false, 0.15, [0.003, 0.015]);
}

#[test]
fn steps_at_672() {
    check("672 up", VGA, true, 0.2, [0.006, 0.010]);
    check("672 down", VGA, false, 0.2, [0.006, 0.015]);
}

#[test]
fn errors_that_pixels_share_are_within_the_stated_sigmas() {
    let of = Noise {
        common_px: 0.05,
        patch_px: 7,
        pose_m: 0.004,
        pose_rad: 0.002,
        ..noise(0.15, 0)
    };
    check_with("672 up, shared errors", VGA, true, of, [0.006, 0.010]);
    // Heights of steps allow for errors of single treads, so these do not cancel completely.
    check_with("672 down, shared errors", VGA, false, of, [0.008, 0.015]);
}

#[test]
fn errors_of_treads_are_within_the_stated_sigmas() {
    let of = Noise {
        tread_px: 0.08,
        ..noise(0.2, 0)
    };
    check_with("672 up, errors of treads", VGA, true, of, [0.010, 0.010]);
    check_with("672 down, errors of treads", VGA, false, of, [0.012, 0.015]);
}

/// Kerbs and stairs going down, as matchers show them: without ends of treads in single pixels.
#[test]
fn steps_that_a_matcher_joins_are_found_where_they_are() {
    let mut shots = walk(VGA, 4, false, noise(0.2, 1));
    shots.iter_mut().for_each(|shot| join_steps(shot, 4));
    let score = score(&surface_of(&shots).2, 4);
    let place = p95(&score.places);
    println!("{score:?}");
    assert!(score.found == 4 && score.invented == 0, "{score:?}");
    assert!(place <= 0.010, "{score:?}");
}

#[test]
fn foreground_that_is_too_wide_moves_ends_by_its_width() {
    let mut camera = HD720;
    camera.wide_px = 2;
    check(
        "HD720 down, foreground wider by 2 px",
        camera,
        false,
        0.15,
        [0.003, 0.015],
    );
}

#[test]
fn vertices_snap_to_planes_and_edges() {
    let shots = walk(HD720, 3, true, noise(0.15, 3));
    let (mut mesh, planes, edges) = surface_of(&shots);
    let scene = stairs(3);
    let errors = |mesh: &Mesh| {
        terrain::evaluate::surface_errors(mesh, |p| {
            let near_edge = (p[0] - GOING_M * (p[0] / GOING_M).round()).abs() < 0.03;
            if near_edge && p[1].abs() < 0.9 {
                scene.distance(p)
            } else {
                f64::NAN
            }
        })
    };
    let before = errors(&mesh);
    snap(&mut mesh, &planes, &edges, 0.02);
    let after = errors(&mesh);
    println!("near edges {before:?}, snapped {after:?}");
    assert!(
        after.median_m < 0.7 * before.median_m && after.p95_m < 0.4 * before.p95_m,
        "{after:?}"
    );
    assert!(mesh.positions.iter().flatten().all(|x| x.is_finite()));
}

#[test]
fn treads_have_the_area_of_treads() {
    let (_, planes, edges) = surface_of(&walk(HD720, 4, true, noise(0.1, 7)));
    let tread = planes
        .planes
        .iter()
        .find(|plane| plane.normal[2] > 0.99 && (plane.center[2] - 2.0 * RISE_M).abs() < 0.02);
    let tread = tread.expect("the second tread");
    assert!((tread.area_m2 - 2.0 * GOING_M).abs() < 0.15, "{tread:?}");
    let area: f64 = tread.polygons.iter().map(|polygon| polygon.area()).sum();
    assert!(
        (area - tread.area_m2).abs() < 0.03,
        "{area} {}",
        tread.area_m2
    );
    assert!((tread.chi_square - 1.0).abs() < 0.4, "{}", tread.chi_square);
    assert!(edges.iter().any(|edge| edge.kind == EdgeKind::Convex));
    assert!(edges.iter().any(|edge| edge.kind == EdgeKind::Concave));
}

#[test]
fn smooth_and_rough_ground_have_no_edges() {
    let slope: fn(f64, f64) -> f64 =
        |x, y| 0.18 * x + 0.04 * (1.3 * x).sin() + 0.03 * (0.9 * y).sin();
    let rough: fn(f64, f64) -> f64 = |x, y| {
        0.025 * (9.0 * x + 1.0).sin() * (7.0 * y).cos()
            + 0.012 * (23.0 * x).sin() * (19.0 * y + 2.0).sin()
    };
    for (name, ground) in [("slope", slope), ("rough", rough)] {
        let scene = Scene {
            solids: vec![Solid::Ground(ground)],
        };
        let small = Camera {
            size: [336, 188],
            focal_px: 184.0,
            baseline_m: 0.126,
            line_s: 50e-6,
            wide_px: 0,
        };
        let shots = climb(&scene, small, [0.0, 2.0], 1.1, noise(0.15, 11));
        let (_, planes, edges) = surface_of(&shots);
        println!(
            "{name}: {} planes, {} edges",
            planes.planes.len(),
            edges.len()
        );
        assert_eq!(edges.len(), 0, "{name}: {edges:?}");
    }
}

#[test]
fn every_number_of_threads_gives_the_same_planes_and_edges() {
    let shots = walk(VGA, 2, true, noise(0.2, 5));
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| surface_of(&shots))
    };
    assert!(on(1) == on(3));
}

#[test]
fn invalid_views_are_rejected() {
    let scene = stairs(1);
    let shot = shoot(
        &scene,
        VGA,
        scene::pose([-0.5, 0.0, 1.3], 0.0, 1.1),
        Default::default(),
        noise(0.1, 1),
    );
    let mut refiner = PlaneRefiner::new(&Mesh::default(), &PlaneConfig::default());
    assert_eq!(refiner.candidates(), 0);
    let mut view = shot.view();
    view.depth_m = &shot.depth_m[1..];
    assert!(refiner.add(&view).is_err());
    refiner.add(&shot.view()).unwrap();
    assert_eq!(refiner.finish().planes.len(), 0);
}
