use super::*;

fn random(index: u64) -> f64 {
    counter_random::uniform(5, 1, index)
}

/// A pose at a position within 20 m x 4 m x 1 m, rotated by up to 1 rad about each axis.
fn pose(number: u64) -> RigidTransform {
    let value = |k: u64, scale: f64| (random(number * 8 + k) - 0.5) * 2.0 * scale;
    let rotation = [value(0, 1.0), value(1, 1.0), value(2, 1.0)];
    let position = [value(3, 10.0), value(4, 2.0), value(5, 0.5)];
    RigidTransform::from_rotation_vector(rotation, position).unwrap()
}

#[test]
fn the_nearest_pose_is_that_of_a_search_over_all() {
    let poses: Vec<_> = (0..3000).map(pose).collect();
    let references = ReferencePoses::new(poses.clone()).unwrap();
    for number in 10_000..10_600 {
        let camera = pose(number);
        let mut config = DeviationConfig::default();
        match number % 3 {
            0 => {}
            1 => config.angle_rad = 60.0,
            _ => config.distance_m = 60.0,
        }
        let at = coordinates(&camera);
        let cost = |reference: &RigidTransform| -> f64 {
            let point = coordinates(reference);
            let difference = |k: usize| (point[k] - at[k]) * config.weights()[k / 3];
            (0..6).map(|k| difference(k).powi(2)).sum()
        };
        let best = poses.iter().map(cost).fold(f64::INFINITY, f64::min);
        let found = references.nearest_by(&camera, &config);
        assert!((cost(&poses[found.index]) - best).abs() <= 1e-12 * best);
        assert_eq!(found, references.between(&camera, found.index));
    }
    for (index, reference) in poses.iter().enumerate() {
        let found = references.nearest(reference);
        assert_eq!((found.index, found.distance_m), (index, 0.0));
        assert!(found.angle_rad < 1e-7);
    }
}

#[test]
fn of_equal_poses_the_first_is_found() {
    let references = ReferencePoses::new(vec![pose(1); 100]).unwrap();
    assert_eq!(references.nearest(&pose(2)).index, 0);
}

#[test]
fn angles_are_those_of_the_optical_axes() {
    let references = ReferencePoses::new(vec![RigidTransform::identity()]).unwrap();
    let angle_of = |rotation: [f64; 3]| {
        let pose = RigidTransform::from_rotation_vector(rotation, [0.0; 3]).unwrap();
        references.nearest(&pose).angle_rad
    };
    for angle in [0.0, 1e-6, 0.5, 1.57, 3.0] {
        assert!((angle_of([angle, 0.0, 0.0]) - angle).abs() < 1e-12);
        assert!((angle_of([0.0, angle, 0.0]) - angle).abs() < 1e-12);
        // About the axis.
        assert!(angle_of([0.0, 0.0, angle]) < 1e-12);
    }
}

#[test]
fn without_poses_there_is_no_deviation() {
    let error = ReferencePoses::new(Vec::new()).unwrap_err();
    assert!(error.to_string().contains("reference poses"), "{error}");
}

/// Views whose PSNR falls with both, with noise of 1 dB.
fn samples(count: u64, noise_db: f64) -> Vec<SupportSample> {
    let sample = |number: u64| {
        let distance_m = 3.0 * random(number * 3);
        let angle_rad = 0.6 * random(number * 3 + 1);
        let loss = 9.0 * distance_m / (1.0 + distance_m) + 12.0 * angle_rad;
        let noise = noise_db * counter_random::bell(5, 2, number);
        SupportSample {
            distance_m,
            angle_rad,
            psnr_db: 29.0 - loss + noise,
        }
    };
    (0..count).map(sample).collect()
}

#[test]
fn support_follows_the_views() {
    let all = samples(1000, 1.0);
    let (fitted, held_out) = all.split_at(600);
    let support = SupportMap::fit(fitted).unwrap();
    // The mean of noise of 1 dB is 0.8 dB.
    let error = support.mean_error_db(held_out);
    assert!(error < 0.9, "{error}");
    let exact = SupportMap::fit(&samples(600, 0.0)).unwrap();
    let error = exact.mean_error_db(&samples(600, 0.0));
    assert!(error < 0.1, "{error}");
}

#[test]
fn support_never_rises_with_distance_or_angle() {
    // Views whose PSNR rises with the distance: the best that does not rise is constant.
    let rising: Vec<SupportSample> = samples(300, 3.0)
        .into_iter()
        .map(|sample| SupportSample {
            psnr_db: 20.0 + 2.0 * sample.distance_m,
            ..sample
        })
        .collect();
    for views in [rising, samples(300, 5.0)] {
        let support = SupportMap::fit(&views).unwrap();
        let db = |distance_m: f64, angle_rad: f64| {
            support.support_db(&Deviation {
                distance_m,
                angle_rad,
                index: 0,
            })
        };
        for step in 0..100 {
            let at = f64::from(step) * 0.05;
            assert!(db(at + 0.05, 0.1) <= db(at, 0.1));
            assert!(db(0.5, at + 0.05) <= db(0.5, at));
        }
    }
}

#[test]
fn bad_samples_are_named() {
    let mut views = samples(20, 1.0);
    assert!(SupportMap::fit(&views[..7]).is_err());
    views[13].psnr_db = f64::NAN;
    let error = SupportMap::fit(&views).unwrap_err();
    assert!(error.to_string().contains("index 13"), "{error}");
}

#[test]
fn samples_close_together_say_little_about_places_far_from_them() {
    // 3 dB of scatter within 11 cm, as of held-out views on the path of a walk.
    let samples: Vec<SupportSample> = (0..30)
        .map(|i| SupportSample {
            distance_m: 0.46 + 0.11 * counter_random::uniform(4, 0, i),
            angle_rad: 0.1 * counter_random::uniform(4, 1, i),
            psnr_db: 21.0 + 3.0 * counter_random::bell(4, 2, i),
        })
        .collect();
    let support = SupportMap::fit(&samples).unwrap();
    let far = Deviation {
        distance_m: 1.5,
        angle_rad: 0.05,
        index: 0,
    };
    let near = Deviation {
        distance_m: 0.5,
        ..far
    };
    let predicted = [support.support_db(&near), support.support_db(&far)];
    assert!((predicted[0] - 21.0).abs() < 2.0, "{predicted:?}");
    assert!(
        (8.0..=predicted[0]).contains(&predicted[1]),
        "{predicted:?}"
    );
}
