//! Playback against a walk with known motion.

use std::f64::consts::FRAC_PI_2;

use cad_transforms::{RigidTransform, so3};

use super::*;
use crate::testing::SyntheticScene;

/// A quarter of a circle of 2 m in 2 s, poses at 20 per second, one lost.
fn quarter(lost: Option<usize>) -> Trajectory {
    let pose = |k: usize| {
        let angle = FRAC_PI_2 * k as f64 / 40.0;
        let turn = so3::from_yaw_pitch_roll(angle + FRAC_PI_2, 0.1, 0.0);
        let at_m = [2.0 * angle.cos(), 2.0 * angle.sin(), 1.4];
        let wxyz = [turn.w, turn.i, turn.j, turn.k];
        let pose = RigidTransform::from_wxyz(wxyz, at_m).expect("a pose");
        let mut pose = Pose::new(50_000_000 * k as i64, pose);
        if lost == Some(k) {
            pose.status = Status::Lost;
        }
        pose
    };
    Trajectory::new((0..=40).map(pose).collect()).expect("a trajectory")
}

#[test]
fn poses_and_velocities_between_those_of_the_trajectory_are_those_of_the_walk() {
    let playback = Playback::new(quarter(None), Vec::new());
    for k in 0..=2000 {
        let time_s = 0.001 * f64::from(k);
        let angle = FRAC_PI_2 * time_s / 2.0;
        let found = playback.at((1e6 * f64::from(k)) as i64).expect("a pose");
        let at_m = found.world_from_rig.translation_m();
        // The chord between two poses is 0.4 mm off the circle.
        assert!((at_m[0] - 2.0 * angle.cos()).abs() < 5e-4, "{k}: {at_m:?}");
        assert!((at_m[1] - 2.0 * angle.sin()).abs() < 5e-4, "{k}: {at_m:?}");
        let yaw = yaw_rad(&found.world_from_rig) - FRAC_PI_2;
        assert!((yaw - angle).abs() < 1e-9, "{k}: {yaw} {angle}");
        let speed = found.velocity_in_world[0].hypot(found.velocity_in_world[1]);
        assert!((speed - FRAC_PI_2).abs() < 0.005, "{k}: {speed}");
    }
    assert!(playback.at(-1).is_none() && playback.at(2_000_000_001).is_none());
}

#[test]
fn there_is_no_pose_next_to_a_lost_one() {
    let playback = Playback::new(quarter(Some(10)), Vec::new());
    assert!(playback.at(450_000_000).is_some() && playback.at(550_000_000).is_some());
    for time_ns in [450_000_001, 500_000_000, 549_999_999] {
        assert_eq!(playback.at(time_ns), None);
    }
    assert_eq!(
        Playback::new(Trajectory::default(), Vec::new()).range_ns(),
        None
    );
}

#[test]
fn the_wearer_walks_on_the_ground_with_a_foot_on_it() {
    let scene = SyntheticScene::stairs().expect("a scene");
    let sector = &scene.scene.sectors[0];
    let config = AgentConfig::default();
    let levels = sector.levels.as_ref().expect("levels").to_vec();
    let ground = Ground::new(levels, &config).expect("ground");
    let trajectory = sector.recording.trajectory.clone().expect("a trajectory");
    let playback = Playback::new(trajectory, sector.recording.contacts.clone());
    let [first_ns, last_ns] = playback.range_ns().expect("poses");
    let (mut on_ground, mut in_contact) = (0, 0);
    for k in 0..200 {
        let time_ns = first_ns + (last_ns - first_ns) * k / 200;
        let recorded = playback.at(time_ns).expect("a pose");
        for (foot, contact) in [Foot::Left, Foot::Right].into_iter().zip(recorded.contacts) {
            let Some(contact) = contact.map(|number| &playback.contacts()[number]) else {
                continue;
            };
            in_contact += 1;
            assert_eq!(contact.foot, foot);
            assert!((contact.events[0].time_ns..contact.events[3].time_ns).contains(&time_ns));
        }
        let Some(state) = playback.state(&ground, &config, time_ns) else {
            continue;
        };
        on_ground += 1;
        let at_m = recorded.world_from_rig.translation_m();
        assert_eq!(state.position_m[..2], at_m[..2]);
        let speed = recorded.velocity_in_world[0].hypot(recorded.velocity_in_world[1]);
        assert!((state.velocity[0].hypot(state.velocity[1]) - speed).abs() < 1e-9);
    }
    assert!(
        on_ground > 150 && in_contact > 100,
        "{on_ground} {in_contact}"
    );
}

#[test]
fn the_rig_is_on_the_agent_where_the_wearer_had_it() {
    let scene = SyntheticScene::room().expect("a scene");
    let sector = &scene.scene.sectors[0];
    let config = AgentConfig::default();
    let ground = Ground::new(sector.levels.as_ref().expect("levels").to_vec(), &config);
    let ground = ground.expect("ground");
    let tilt = so3::from_yaw_pitch_roll(0.0, 0.12, -0.05);
    let tilt = [tilt.w, tilt.i, tilt.j, tilt.k];
    let tilt = RigidTransform::from_wxyz(tilt, [0.0, 0.0, -0.15]).expect("a tilt");
    let trajectory = sector.recording.trajectory.as_ref().expect("a trajectory");
    let tilted = trajectory.poses().iter().map(|pose| Pose {
        world_from_rig: pose.world_from_rig * tilt,
        ..pose.clone()
    });
    let tilted = Trajectory::new(tilted.collect()).expect("a trajectory");
    let mount = Playback::new(tilted, Vec::new()).body_from_rig(&ground, &config);
    let difference = mount.expect("ground below") * tilt.inverse();
    // The rig of the synthetic walk is level, 1.4 m above the ground.
    let [x, y, z] = difference.translation_m();
    assert!(
        x.abs() < 1e-9 && y.abs() < 1e-9 && (z - 1.4).abs() < 1e-6,
        "{z}"
    );
    assert!(difference.angle_rad() < 1e-9);
    let empty = Playback::new(Trajectory::default(), Vec::new());
    assert_eq!(empty.body_from_rig(&ground, &config), None);
}
