//! Fusion on analytic scenes: against the reference implementation, against the truth, on threads.

mod reference;
mod scene;

use cad_transforms::RigidTransform;
use reference::Dense;
use scene::{Camera, Noise, Scene, Shot, Solid, VGA, climb, pose, shoot, stairs};
use terrain::fusion::Volume;
use terrain::{FusionConfig, PixelClass};

const SMALL: Camera = Camera {
    size: [320, 200],
    focal_px: 180.0,
    baseline_m: 0.063,
    line_s: 0.0,
    wide_px: 0,
};

fn fused(shots: &[Shot]) -> Volume {
    let mut volume = Volume::new(FusionConfig::default()).unwrap();
    for shot in shots {
        volume.add(&shot.view()).unwrap();
    }
    volume
}

/// Voxels of both volumes are compared: the share that differs by more than `tolerance_m`, or is
/// known to one only.
fn disagreement(volume: &Volume, dense: &Dense, tolerance_m: f64) -> (usize, f64) {
    let (mut known, mut differ) = (0, 0);
    for (i, expected) in dense.voxels.iter().enumerate() {
        let found = volume.voxel(dense.place(i));
        if expected.weight == 0.0 && found.is_none() {
            continue;
        }
        known += 1;
        let same = found.is_some_and(|found| {
            expected.weight > 0.0 && (found.distance_m - expected.distance_m).abs() < tolerance_m
        });
        differ += usize::from(!same);
    }
    (known, differ as f64 / known as f64)
}

#[test]
fn fast_fusion_agrees_with_the_reference() {
    let camera = Camera {
        line_s: 40e-6,
        ..SMALL
    };
    let noise = Noise {
        disparity_px: 0.1,
        pose_m: 0.003,
        pose_rad: 0.002,
        seed: 3,
        ..scene::CLEAN
    };
    let shots = climb(&stairs(4), camera, [-0.6, 0.6], 1.1, noise);
    let volume = fused(&shots);
    let mut dense = Dense::new(FusionConfig::default(), [-30, -30, -6], [60, 30, 36]);
    for shot in &shots {
        dense.add(&shot.view());
    }
    let (known, share) = disagreement(&volume, &dense, 2e-4);
    // Voxels that project to the border of two pixels may take either.
    assert!(
        known > 20_000 && share < 0.01,
        "{known} voxels, {share} differ"
    );
    // A rolling shutter that is ignored is found by this comparison.
    let mut other = Dense::new(FusionConfig::default(), [-30, -30, -6], [60, 30, 36]);
    for shot in &shots {
        let mut view = shot.view();
        view.row_motion = terrain::RowMotion::default();
        other.add(&view);
    }
    let (_, share) = disagreement(&volume, &other, 2e-4);
    assert!(share > 0.3, "{share} differ");
}

#[test]
fn distances_are_those_along_the_normal() {
    // A floor seen at a shallow angle, without noise: rays are twice as long as distances.
    let floor = Scene {
        solids: vec![Solid::Ground(|_, _| 0.013)],
    };
    let shot = shoot(
        &floor,
        SMALL,
        pose([0.0, 0.0, 1.0], 0.3, 0.7),
        Default::default(),
        Noise::default(),
    );
    let volume = fused(&[shot]);
    let mut count = 0;
    for x in 40..80 {
        for z in -1..3 {
            if let Some(voxel) = volume.voxel([x, 10, z]) {
                let truth = 0.02 * z as f64 - 0.013;
                assert!((voxel.distance_m - truth).abs() < 5e-4, "{voxel:?} {truth}");
                count += 1;
            }
        }
    }
    assert!(count > 100, "{count} voxels");
}

#[test]
fn distances_beyond_the_range_keep_their_sign() {
    // Depths with large sigmas change voxels up to the range of stored distances, and the place of
    // a voxel in its pixel adds to that.
    let floor = Scene {
        solids: vec![Solid::Ground(|_, _| -0.005)],
    };
    let mut shot = shoot(
        &floor,
        SMALL,
        pose([0.0, 0.0, 1.5], 0.0, 0.5),
        Default::default(),
        Noise::default(),
    );
    for (sigma, depth) in shot.sigma_m.iter_mut().zip(&shot.depth_m) {
        *sigma = 0.03 * depth;
    }
    let volume = fused(&[shot]);
    let (mut known, mut farthest) = (0, 0.0f64);
    for i in 0..200 * 100 * 8 {
        let at = [i % 200 + 20, i / 200 % 100 - 50, i / 20_000 + 1];
        if let Some(voxel) = volume.voxel(at) {
            assert!(voxel.distance_m > 0.0, "{at:?} {voxel:?}");
            known += 1;
            farthest = farthest.max(voxel.distance_m);
        }
    }
    assert!(known > 1000 && farthest > 0.1199, "{known} {farthest}");
}

#[test]
fn every_number_of_threads_gives_the_same_volume() {
    let noise = Noise {
        disparity_px: 0.2,
        seed: 9,
        ..Noise::default()
    };
    let shots = climb(&stairs(3), SMALL, [-0.6, 0.2], 1.0, noise);
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| fused(&shots))
    };
    let (one, four) = (on(1), on(4));
    assert_eq!(one.stats(), four.stats());
    for i in 0..100 * 60 * 40 {
        let at = [i % 100 - 30, i / 100 % 60 - 30, i / 6000 - 6];
        assert_eq!(one.voxel(at), four.voxel(at));
    }
}

#[test]
fn what_stood_once_is_carved() {
    let floor = Scene {
        solids: vec![Solid::Ground(|_, _| 0.0)],
    };
    let mut visited = floor.clone();
    visited.solids.push(Solid::Box {
        min: [1.0, -0.15, 0.0],
        max: [1.3, 0.15, 0.4],
        color: [200, 0, 0],
    });
    let noise = |seed| Noise {
        disparity_px: 0.1,
        seed,
        ..Noise::default()
    };
    let at = |i: u64| pose([0.05 * i as f64, 0.0, 1.4], 0.0, 0.9);
    let mut shots = vec![shoot(&visited, SMALL, at(0), Default::default(), noise(1))];
    // A voxel of the top of the box.
    let top = [57, 0, 20];
    assert!(
        fused(&shots)
            .voxel(top)
            .is_some_and(|v| v.distance_m.abs() < 0.01)
    );
    shots.push(shoot(&floor, SMALL, at(1), Default::default(), noise(2)));
    let once = fused(&shots);
    assert!(
        once.voxel(top).is_some_and(|v| v.distance_m.abs() < 0.01),
        "one view removes nothing"
    );
    assert_eq!(once.stats().carved, 0);
    shots.extend((2..9).map(|i| shoot(&floor, SMALL, at(i), Default::default(), noise(i + 1))));
    let carved = fused(&shots);
    let left = carved.voxel(top);
    assert!(left.is_none_or(|v| v.distance_m > 0.02), "{left:?}");
    // The floor remains.
    let floor = carved.voxel([40, 0, 0]).expect("seen");
    assert!(
        floor.distance_m.abs() < 0.01 && floor.views > 5,
        "{floor:?}"
    );
}

#[test]
fn excluded_pixels_are_not_used_and_unknown_ones_make_no_surface() {
    let floor = Scene {
        solids: vec![Solid::Ground(|_, _| 0.0)],
    };
    let mut shot = shoot(
        &floor,
        SMALL,
        pose([0.0, 0.0, 1.2], 0.0, 1.2),
        Default::default(),
        Noise::default(),
    );
    for class in [PixelClass::Excluded, PixelClass::Unknown] {
        shot.classes = Some(vec![class; shot.depth_m.len()]);
        let mut volume = Volume::new(FusionConfig::default()).unwrap();
        volume.add(&shot.view()).unwrap();
        assert_eq!(volume.stats().blocks, 0);
    }
    // Unknown pixels show that a box that stood there is no more.
    let mut boxed = floor.clone();
    boxed.solids.push(Solid::Box {
        min: [0.4, -0.15, 0.0],
        max: [0.7, 0.15, 0.4],
        color: [200, 0, 0],
    });
    let mut volume = fused(&[shoot(
        &boxed,
        SMALL,
        pose([0.0, 0.0, 1.2], 0.0, 1.2),
        Default::default(),
        Noise::default(),
    )]);
    let top = [27, 0, 20];
    assert!(volume.voxel(top).is_some());
    for _ in 0..20 {
        volume.add(&shot.view()).unwrap();
    }
    assert_eq!(volume.voxel(top), None);
}

#[test]
fn memory_grows_with_the_area_and_not_with_the_number_of_views() {
    let noise = Noise {
        disparity_px: 0.15,
        seed: 5,
        ..Noise::default()
    };
    let shots = climb(&stairs(5), VGA, [-0.8, 0.8], 1.2, noise);
    let once = fused(&shots);
    let mut more = once.clone();
    for shot in shots.iter().cycle().take(3 * shots.len()) {
        more.add(&shot.view()).unwrap();
    }
    let [once, more] = [once.stats(), more.stats()];
    assert_eq!(once.blocks, more.blocks);
    assert!(
        more.bytes < once.bytes + once.bytes / 50,
        "{once:?} {more:?}"
    );
    // Some 8 m2 of treads, risers and floor.
    assert!(once.bytes < 10_000_000, "{once:?}");
}

#[test]
fn invalid_views_change_nothing() {
    let shot = shoot(
        &stairs(1),
        SMALL,
        pose([0.0, 0.0, 1.2], 0.0, 1.2),
        Default::default(),
        Noise::default(),
    );
    let mut volume = Volume::new(FusionConfig::default()).unwrap();
    let mut view = shot.view();
    view.sigma_m = &shot.sigma_m[..10];
    assert!(volume.add(&view).is_err());
    let mut view = shot.view();
    view.world_from_view = RigidTransform::from_translation_m([1e9, 0.0, 0.0]).unwrap();
    let error = volume.add(&view).unwrap_err().to_string();
    assert!(error.contains("from the world's origin"), "{error}");
    assert_eq!(volume.stats(), Default::default());
    let mut config = FusionConfig::default();
    config.voxel_m = 0.0;
    assert!(
        Volume::new(config)
            .unwrap_err()
            .to_string()
            .contains("the voxel is 0")
    );
}
