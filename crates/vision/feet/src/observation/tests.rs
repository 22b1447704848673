use super::*;

/// A foot with a pitch, seen by a tag whose other pose is tilted the other way; the wrong one
/// fits better in some frames.
fn frame(n: i64, pitch: f64, is_flipped: bool) -> FootCandidates {
    let at = |pitch: f64| {
        RigidTransform::from_rotation_vector([0.0, -pitch, 0.0], [0.0, 0.1, 0.0]).unwrap()
    };
    let (truth, wrong) = (at(pitch), at(0.2 - pitch));
    let poses = match is_flipped {
        true => [(wrong, 0.0), (truth, 4.0)],
        false => [(truth, 0.0), (wrong, 20.0)],
    };
    FootCandidates {
        time_ns: n * 33_333_333,
        poses: poses.to_vec(),
        covariance: Covariance::from_sigmas([2e-3; 3], [0.02; 3]).unwrap(),
        tag_place: Vector3::new(0.05 * n as f64, 0.1, 0.08),
    }
}

#[test]
fn poses_that_fit_each_other_count_also_where_the_other_ones_are_more_level() {
    let frames = (0..12).map(|n| frame(n, 0.25, n % 3 == 1));
    let found = foot_observations(frames, &FootConfig::default());
    assert_eq!(found.len(), 12);
    for (n, own) in found.iter().enumerate() {
        let [_, turn, _] = own.world_from_foot.rotation_vector();
        assert!((turn + 0.25).abs() < 1e-6, "{n}: {turn}");
    }
}

#[test]
fn a_frame_that_neighbors_contradict_is_left_out() {
    let frames = (0..9).map(|n| {
        let mut own = frame(n, 0.05, false);
        if n == 4 {
            own.poses = vec![(
                RigidTransform::from_rotation_vector([0.0, 0.8, 0.0], [0.0; 3]).unwrap(),
                0.0,
            )];
        }
        own
    });
    let found = foot_observations(frames, &FootConfig::default());
    assert_eq!(found.len(), 8);
    assert!(found.iter().all(|own| own.time_ns != 4 * 33_333_333));
}

/// A foot that lands, toe up, and rests from the fifth frame on; the other pose of its tag is
/// toe down, and more level. Its turn towards the camera changes while the rig passes.
fn landing() -> Vec<FootCandidates> {
    let frames = (0..10).map(|n| {
        let (pitch, x) = match n {
            0..5 => (0.3, -0.1 * f64::from(5 - n)),
            _ => (0.0, 0.0),
        };
        let other = if n < 5 {
            -0.2
        } else {
            -0.1 - 0.05 * f64::from(n)
        };
        let at = |pitch: f64| {
            RigidTransform::from_rotation_vector([0.0, -pitch, 0.0], [0.0, 0.1, 0.0]).unwrap()
        };
        let mut own = frame(i64::from(n), pitch, false);
        own.poses = vec![(at(other), 0.0), (at(pitch), 4.0)];
        own.tag_place = Vector3::new(x, 0.1, 0.08);
        own
    });
    frames.collect()
}

#[test]
fn a_foot_that_lands_has_its_toe_up_and_one_at_rest_is_level() {
    let found = foot_observations(landing(), &FootConfig::default());
    assert_eq!(found.len(), 10);
    for (n, own) in found.iter().enumerate() {
        let pitch = -own.world_from_foot.rotation_vector()[1];
        let truth = if n < 5 { 0.3 } else { 0.0 };
        assert!((pitch - truth).abs() < 1e-6, "{n}: {pitch}");
    }
}

#[test]
fn a_foot_that_rests_on_a_ramp_is_not_level() {
    // The other pose turns while the rig passes, by twice the change of its direction.
    let frames = (0..10).map(|n| {
        let mut own = frame(n, 0.2, false);
        let other = 0.1 - 0.05 * n as f64;
        own.poses[1].0 =
            RigidTransform::from_rotation_vector([0.0, -other, 0.0], [0.0, 0.1, 0.0]).unwrap();
        own.poses[1].1 = 6.0;
        own.tag_place = Vector3::zeros();
        own
    });
    for own in foot_observations(frames, &FootConfig::default()) {
        let pitch = -own.world_from_foot.rotation_vector()[1];
        assert!((pitch - 0.2).abs() < 1e-6, "{pitch}");
    }
}

#[test]
fn later_frames_change_no_causal_pose() {
    let (frames, config) = (landing(), FootConfig::default());
    let all = causal_observations(frames.iter().cloned(), &config);
    for n in 1..=frames.len() {
        let until = causal_observations(frames[..n].iter().cloned(), &config);
        assert_eq!(until, all[..n]);
    }
}

#[test]
fn of_two_tags_the_surer_one_counts() {
    let mut unsure = frame(3, 0.1, false);
    unsure.covariance = Covariance::from_sigmas([9e-3; 3], [0.1; 3]).unwrap();
    for both in [
        [unsure.clone(), frame(3, 0.0, false)],
        [frame(3, 0.0, false), unsure],
    ] {
        let found = foot_observations(both, &FootConfig::default());
        assert_eq!(found.len(), 1);
        assert!(found[0].world_from_foot.rotation_vector()[1].abs() < 1e-9);
    }
}
