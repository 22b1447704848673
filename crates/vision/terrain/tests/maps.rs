//! Maps of analytic scenes.

mod carpet;
mod scene;

use carpet::carpet;
use scene::surface::snapped_surface_of;
use scene::{GOING_M, HD720, Noise, RISE_M, Scene, Shot, Solid, climb, pose, shoot, stairs};
use terrain::MapConfig;
use terrain::evaluate::ErrorQuantiles;
use terrain::maps::{
    CONTRADICTED, FILLED, FREE, GroundSample, KNOWN, Level, OCCUPIED, SAMPLED, UNCERTAIN, UNKNOWN,
    build,
};

fn mapped(shots: &[Shot], ground: &[GroundSample]) -> Vec<Level> {
    let (mesh, _, edges) = snapped_surface_of(shots);
    build(&mesh, &edges, ground, &MapConfig::default())
}

fn noise(seed: u64) -> Noise {
    Noise {
        disparity_px: 0.15,
        pose_m: 0.002,
        pose_rad: 0.001,
        seed,
        ..scene::CLEAN
    }
}

#[test]
fn stairs_have_their_heights_edges_and_distances() {
    let scene = stairs(4);
    let levels = mapped(&climb(&scene, HD720, [-0.8, 0.8], 1.05, noise(2)), &[]);
    assert_eq!(levels.len(), 1);
    let level = &levels[0];
    let inside = |index: usize| {
        let [x, y] = level.center(index);
        (-0.5..1.2).contains(&x) && y.abs() < 0.6
    };
    let known: Vec<usize> = (0..level.flags.len())
        .filter(|i| inside(*i) && level.flags[*i] & KNOWN != 0)
        .collect();
    assert!(known.len() > 1000, "{}", known.len());
    let heights = ErrorQuantiles::of(known.iter().map(|index| {
        let [x, y] = level.center(*index);
        f64::from(level.elevation[*index]) - scene.height(x, y).unwrap()
    }));
    println!("heights {heights:?}");
    assert!(
        heights.median_m < 0.003 && heights.p95_m < 0.010,
        "{heights:?}"
    );
    // Distances to the nearest edge of the tread.
    let distances = ErrorQuantiles::of(known.iter().filter_map(|index| {
        let [x, _] = level.center(*index);
        let truth = (x - GOING_M * (x / GOING_M).round()).abs();
        let on_stairs = (0.02..3.0 * GOING_M).contains(&x) && truth > 0.01;
        on_stairs.then(|| f64::from(level.distance[*index]) - truth)
    }));
    println!("distances {distances:?}");
    assert!(distances.count > 300 && distances.median_m < 0.005 && distances.p95_m < 0.03);
    // In the middle of a tread the ground is level; its edges are steps.
    let middle = level.index(1.5 * GOING_M, 0.1).unwrap();
    assert!(level.slope[middle] < 0.05 && level.roughness[middle] < 0.005);
    let edge = level.index(2.0 * GOING_M - 0.02, 0.1).unwrap();
    assert!(
        (f64::from(level.step[edge]) - RISE_M).abs() < 0.02,
        "{}",
        level.step[edge]
    );
    let before = level.index(-0.3, 0.1).unwrap();
    assert!(level.traversability[edge] < 0.3 && level.traversability[before] > 0.8);
    assert_eq!(level.occupancy[middle], FREE);
}

#[test]
fn unknown_is_not_free_and_obstacles_are_occupied() {
    let floor = Scene {
        solids: vec![Solid::Ground(|_, _| 0.0)],
    };
    let mut scene = floor.clone();
    scene.solids.push(Solid::Box {
        min: [0.9, -0.2, 0.0],
        max: [1.2, 0.2, 0.6],
        color: [0; 3],
    });
    let shots: Vec<Shot> = (0..3)
        .map(|i| {
            shoot(
                &scene,
                HD720,
                pose([-0.2 + 0.1 * i as f64, 0.0, 1.4], 0.0, 0.8),
                Default::default(),
                noise(i),
            )
        })
        .collect();
    let levels = mapped(&shots, &[]);
    let level = &levels[0];
    let at = |x, y| level.occupancy[level.index(x, y).unwrap()];
    assert_eq!(at(0.5, 0.0), FREE);
    assert_eq!(at(0.9, 0.0), OCCUPIED);
    // The shade behind the box.
    assert_eq!(at(1.25, 0.0), UNKNOWN);
    for i in 0..level.flags.len() {
        assert!(level.has_height(i) || level.occupancy[i] != FREE);
    }
    let distance = |x, y| level.distance[level.index(x, y).unwrap()];
    assert!(
        (distance(0.6, 0.0) - 0.29).abs() < 0.05,
        "{}",
        distance(0.6, 0.0)
    );
    assert!(distance(1.25, 0.0) < 0.0);
}

#[test]
fn small_holes_are_filled_and_flagged() {
    let hole = |x: f64, y: f64, [cx, cy]: [f64; 2], [w, h]: [f64; 2]| {
        (x - cx).abs() < 0.5 * w && (y - cy).abs() < 0.5 * h
    };
    let height = |x: f64, y: f64| {
        let narrow = hole(x, y, [0.5, 0.5], [0.05, 0.3]);
        let wide = hole(x, y, [1.2, 0.5], [0.3, 0.3]);
        // A step beside the hole.
        let at_step = hole(x, y, [0.5, 1.2], [0.05, 0.1]);
        let step = if x > 0.5 && y > 1.0 { 0.1 } else { 0.0 };
        (!narrow && !wide && !at_step).then_some(0.05 * x + step)
    };
    let levels = build(&carpet([90, 80], height), &[], &[], &MapConfig::default());
    assert_eq!(levels.len(), 1);
    let level = &levels[0];
    let at = |x, y| level.index(x, y).unwrap();
    let filled = at(0.5, 0.5);
    assert_eq!(level.flags[filled] & (FILLED | KNOWN), FILLED);
    assert!((level.elevation[filled] - 0.025).abs() < 0.003);
    assert!(level.sigma[filled] >= 0.006);
    assert!(level.elevation[at(1.2, 0.5)].is_nan(), "wide holes stay");
    assert!(
        level.elevation[at(0.5, 1.2)].is_nan(),
        "holes at steps stay"
    );
    assert_eq!(level.occupancy[at(1.2, 0.5)], UNKNOWN);
}

#[test]
fn heights_with_a_large_sigma_are_flagged() {
    let mut mesh = carpet([90, 80], |_, _| Some(0.0));
    // Vertices beyond 1 m are known to 15 mm, those before to 3 mm.
    for (sigma, position) in mesh.sigma_m.iter_mut().zip(&mesh.positions) {
        if position[0] > 1.0 {
            *sigma = 0.015;
        }
    }
    let levels = build(&mesh, &[], &[], &MapConfig::default());
    let level = &levels[0];
    let flags = |x, y| level.flags[level.index(x, y).unwrap()] & (KNOWN | UNCERTAIN);
    assert_eq!(flags(0.5, 0.5), KNOWN);
    assert_eq!(flags(1.3, 0.5), KNOWN | UNCERTAIN);
}

#[test]
fn floors_above_each_other_are_levels() {
    // A bridge over a way.
    let way = carpet([100, 100], |_, _| Some(0.0));
    let bridge = carpet([100, 40], |_, _| Some(2.5));
    let mut mesh = way.clone();
    let first = mesh.positions.len() as u32;
    mesh.positions
        .extend(bridge.positions.iter().map(|p| [p[0], p[1] + 0.6, p[2]]));
    mesh.normals.extend(&bridge.normals);
    mesh.colors.extend(&bridge.colors);
    mesh.sigma_m.extend(&bridge.sigma_m);
    mesh.views.extend(&bridge.views);
    mesh.triangles
        .extend(bridge.triangles.iter().map(|t| t.map(|i| i + first)));
    let walked = GroundSample {
        position: [1.0, 1.0, 2.51],
        sigma_m: 0.01,
        contact: 0,
    };
    let levels = build(&mesh, &[], &[walked], &MapConfig::default());
    assert_eq!(levels.len(), 2);
    // The level that was walked on comes first, though it is smaller.
    let heights = [0, 1].map(|k| levels[k].elevation[levels[k].index(1.0, 1.0).unwrap()]);
    assert!(
        (heights[0] - 2.5).abs() < 0.01 && heights[1] == 0.0,
        "{heights:?}"
    );
    let clearance = levels[1].clearance[levels[1].index(1.0, 1.0).unwrap()];
    assert!((clearance - 2.5).abs() < 0.01, "{clearance}");
    assert!(levels[1].clearance[levels[1].index(1.0, 0.2).unwrap()].is_infinite());
    assert_ne!(
        levels[0].flags[levels[0].index(1.0, 1.0).unwrap()] & SAMPLED,
        0
    );
}

#[test]
fn ground_samples_give_heights_and_win() {
    let hole = |x: f64, y: f64| (x - 1.0).hypot(y - 1.0) > 0.3;
    let mesh = carpet([100, 100], |x, y| hole(x, y).then_some(0.0));
    let sample = |contact, position| GroundSample {
        position,
        sigma_m: 0.008,
        contact,
    };
    let samples = [
        // In the hole, where it is too wide to be filled; on the ground; in shallow water.
        sample(0, [1.0, 0.78, 0.004]),
        sample(1, [0.4, 0.4, 0.006]),
        sample(2, [1.7, 1.7, -0.12]),
    ];
    let level = &build(&mesh, &[], &samples, &MapConfig::default())[0];
    let at = |x, y| level.index(x, y).unwrap();
    assert_eq!(level.flags[at(1.0, 0.78)] & (SAMPLED | KNOWN), SAMPLED);
    assert!((level.elevation[at(1.0, 0.78)] - 0.004).abs() < 1e-6);
    assert_eq!(level.occupancy[at(1.0, 0.78)], FREE);
    assert_eq!(level.occupancy[at(1.0, 1.0)], UNKNOWN);
    assert!((level.elevation[at(0.4, 0.4)] - 0.0007).abs() < 3e-4);
    assert_ne!(level.flags[at(1.7, 1.7)] & CONTRADICTED, 0);
    assert!((level.elevation[at(1.7, 1.7)] + 0.12).abs() < 1e-6);
}

/// A step down of 17 cm at x = 1 m, on whose edge a sole rests with its heel over the lower tread.
#[test]
fn a_sole_that_hangs_over_an_edge_is_no_ground() {
    let mesh = carpet([100, 100], |x, _| Some(if x < 1.0 { 0.17 } else { 0.0 }));
    let sole = |contact: usize, z: f64| {
        (0..8).map(move |k| GroundSample {
            position: [0.86 + 0.04 * k as f64, 1.0, z],
            sigma_m: 0.006,
            contact,
        })
    };
    let height = |samples: &[GroundSample], x: f64| {
        let level = &build(&mesh, &[], samples, &MapConfig::default())[0];
        level.elevation[level.index(x, 1.0).unwrap()]
    };
    let samples: Vec<GroundSample> = sole(0, 0.17).collect();
    assert!((height(&samples, 0.9) - 0.17).abs() < 0.01);
    assert!(
        height(&samples, 1.1).abs() < 0.01,
        "{}",
        height(&samples, 1.1)
    );
    // One that depth contradicts everywhere stands on something that no view saw.
    let samples: Vec<GroundSample> = sole(0, 0.30).collect();
    assert!((height(&samples, 1.1) - 0.30).abs() < 0.01);
}

/// What is too high for a step and lower than a person is an obstacle, whatever its height.
#[test]
fn low_boxes_are_no_free_ground_of_the_level() {
    for height_m in [0.3_f32, 0.4, 0.45] {
        let is_box = |x: f64, y: f64| (0.8..1.2).contains(&x) && (0.8..1.2).contains(&y);
        let top = |x: f64, y: f64| {
            Some(if is_box(x, y) {
                f64::from(height_m)
            } else {
                0.0
            })
        };
        let mesh = carpet([100, 100], top);
        let level = &build(&mesh, &[], &[], &MapConfig::default())[0];
        let at = |x: f64, y: f64| level.index(x, y).unwrap();
        assert_eq!(level.occupancy[at(0.4, 0.4)], FREE);
        // Its sides are obstacles; what is on top of it is no ground of this level.
        let side = (0..6).map(|k| level.occupancy[at(0.74 + 0.02 * f64::from(k), 1.0)]);
        assert!(
            side.into_iter().any(|cell| cell == OCCUPIED),
            "{height_m} m"
        );
        for k in 0..9 {
            let cell = level.occupancy[at(0.84 + 0.04 * f64::from(k), 1.0)];
            assert_ne!(cell, FREE, "{height_m} m");
        }
    }
}

#[test]
fn every_number_of_threads_gives_the_same_maps() {
    let shots = climb(&stairs(2), scene::VGA, [-0.4, 0.2], 1.05, noise(2));
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| mapped(&shots, &[]))
    };
    // NaN differs from itself.
    assert_eq!(format!("{:?}", on(1)), format!("{:?}", on(3)));
}

/// A way of 60 m at 45 degrees to the axes, on ground that rises by 2 %.
#[test]
fn a_way_across_the_axes_is_divided_into_levels_that_overlap() {
    let config = MapConfig::default();
    let height = |x: f64, y: f64| 0.01 * (x + y);
    let mesh = carpet([2200, 2200], |x, y| {
        ((x - y).abs() < 0.7).then(|| height(x, y))
    });
    let walked = |at: f64| GroundSample {
        position: [at, at, height(at, at) + 0.004],
        sigma_m: 0.004,
        contact: (100.0 * at) as usize,
    };
    let samples: Vec<GroundSample> = (1..86).map(|k| walked(0.5 * f64::from(k))).collect();
    let levels = build(&mesh, &[], &samples, &config);
    let cells: usize = levels.iter().map(|level| level.flags.len()).sum();
    assert!(
        levels.len() > 1 && cells < 800_000,
        "{} levels, {cells} cells",
        levels.len()
    );
    for sample in &samples {
        let [x, y, _] = sample.position;
        let of = levels.iter().filter_map(|level| {
            let index = level.index(x, y).filter(|index| level.has_height(*index))?;
            Some((level, index))
        });
        let of: Vec<(&Level, usize)> = of.collect();
        assert!(!of.is_empty(), "{x}");
        for (level, index) in &of {
            let [x, y] = level.center(*index);
            let error = f64::from(level.elevation[*index]) - height(x, y);
            assert!(error.abs() < 0.005, "{error}");
            assert_ne!(level.flags[*index] & SAMPLED, 0, "in all of them: {x}");
        }
        // Somewhere the end of the ground is as far as its sides.
        let clear = of.iter().map(|(level, index)| level.distance[*index]);
        assert!(clear.fold(0.0, f32::max) > 0.4, "{x}");
    }
}
