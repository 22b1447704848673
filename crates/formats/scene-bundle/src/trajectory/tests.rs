use super::*;

fn pose(time_ns: i64, x: f64, status: Status) -> Pose {
    let world_from_rig = RigidTransform::from_translation_m([x, 0.0, 1.4]).unwrap();
    Pose {
        status,
        ..Pose::new(time_ns, world_from_rig)
    }
}

#[test]
fn times_must_rise_and_the_error_says_where() {
    let poses = vec![
        pose(-5, 0.0, Status::Tracked),
        pose(7, 0.0, Status::Tracked),
        pose(7, 0.0, Status::Tracked),
    ];
    let error = Trajectory::new(poses).unwrap_err();
    assert_eq!(
        error.to_string(),
        "checking a trajectory: pose 2 is at 7 ns, expected later than the one before, 7 ns"
    );

    let mut trajectory = Trajectory::new(vec![pose(10, 0.0, Status::Tracked)]).unwrap();
    assert!(trajectory.push(pose(9, 0.0, Status::Tracked)).is_err());
    assert_eq!(trajectory.len(), 1);
    trajectory.push(pose(11, 0.0, Status::Tracked)).unwrap();
    assert_eq!(trajectory.duration_ns(), 1);
    assert!(trajectory.at(11).is_some() && trajectory.at(12).is_none());
}

#[test]
fn a_velocity_must_be_finite() {
    let mut bad = pose(0, 0.0, Status::Tracked);
    bad.velocity_in_world = Some([0.0, f64::NAN, 0.0]);
    let error = Trajectory::new(vec![bad]).unwrap_err();
    assert!(matches!(error, TrajectoryError::Velocity { index: 0, .. }));
}

#[test]
fn an_empty_trajectory_has_no_spans_and_no_length() {
    let trajectory = Trajectory::new(Vec::new()).unwrap();
    assert!(trajectory.is_empty() && trajectory.spans().is_empty());
    assert_eq!(
        (trajectory.path_length_m(), trajectory.duration_ns()),
        (0.0, 0)
    );
}

#[test]
fn spans_hold_every_pose_once_and_lost_steps_have_no_length() {
    use Status::{DeadReckoned, Lost, Relocalised, Tracked};
    let statuses = [
        Tracked,
        Tracked,
        DeadReckoned,
        Lost,
        Lost,
        Relocalised,
        Relocalised,
        Tracked,
    ];
    let x = [0.0, 1.0, 3.0, 3.0, 3.0, 100.0, 104.0, 112.0];
    let poses = (0..8)
        .map(|i| pose(i as i64 * 10, x[i], statuses[i]))
        .collect();
    let trajectory = Trajectory::new(poses).unwrap();

    let spans = trajectory.spans();
    let counts: Vec<(Status, usize, usize)> =
        spans.iter().map(|s| (s.status, s.first, s.count)).collect();
    assert_eq!(
        counts,
        [
            (Tracked, 0, 2),
            (DeadReckoned, 2, 1),
            (Lost, 3, 2),
            (Relocalised, 5, 2),
            (Tracked, 7, 1)
        ]
    );
    assert_eq!((spans[2].from_ns, spans[2].to_ns), (30, 40));
    // 0 to 3 m before the loss, 100 to 112 m after it; the 97 m between were not walked as far as
    // anybody knows.
    assert_eq!(trajectory.path_length_m(), 15.0);
    assert_eq!(trajectory.usable().count(), 6);
}

#[test]
fn codes_and_names_are_those_of_the_format() {
    for (code, status) in Status::ALL.into_iter().enumerate() {
        assert_eq!(usize::from(status.code()), code);
        assert_eq!(Status::from_code(code as u8), Some(status));
        assert_eq!(serde_json::to_value(status).unwrap(), status.name());
    }
    assert_eq!(Status::from_code(4), None);
}
