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

fn of(poses: Vec<RigidTransform>) -> ReferencePoses {
    ReferencePoses::new(poses, &DeviationConfig::default()).unwrap()
}

#[test]
fn units_of_nothing_are_refused() {
    for config in [
        DeviationConfig {
            distance_m: 0.0,
            ..DeviationConfig::default()
        },
        DeviationConfig {
            angle_rad: f64::NAN,
            ..DeviationConfig::default()
        },
    ] {
        let error = ReferencePoses::new(vec![pose(1)], &config).unwrap_err();
        assert!(error.to_string().contains("deviation."), "{error}");
    }
}

#[test]
fn the_nearest_pose_is_that_of_a_search_over_all() {
    let poses: Vec<_> = (0..3000).map(pose).collect();
    let references = of(poses.clone());
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
    let references = of(vec![pose(1); 100]);
    assert_eq!(references.nearest(&pose(2)).index, 0);
}

#[test]
fn angles_are_those_of_the_optical_axes() {
    let references = of(vec![RigidTransform::identity()]);
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
    let error = ReferencePoses::new(Vec::new(), &DeviationConfig::default()).unwrap_err();
    assert!(error.to_string().contains("reference poses"), "{error}");
}
