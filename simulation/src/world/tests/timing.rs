//! Frames that are late and have a rate of their own.

use super::*;
use crate::camera::{CameraConfig, TimingConfig};

fn world(scene: &Arc<SceneData>, timing: TimingConfig) -> World {
    let mut config = config(12, Task::PointGoal);
    config.timing = timing;
    config.randomization.mount_m = 0.02;
    config.randomization.mount_rad = 0.03;
    let mut world = World::new(scene.clone(), config).unwrap();
    world.reset(None, None).unwrap();
    world
}

/// A frame of each step, so much late, s.
fn late(latency_s: f64) -> TimingConfig {
    TimingConfig {
        latency_s: [latency_s; 2],
        ..TimingConfig::default()
    }
}

/// Largest difference of two poses, in positions, m, and components of quaternions.
fn difference(a: &FrameRequest, b: &FrameRequest) -> f64 {
    let numbers = |request: &FrameRequest| {
        let pose = request.world_from_camera;
        let [x, y, z] = pose.translation_m();
        let [w, i, j, k] = pose.rotation_wxyz();
        [x, y, z, w, i, j, k]
    };
    let (a, b) = (numbers(a), numbers(b));
    (0..7).map(|k| (a[k] - b[k]).abs()).fold(0.0, f64::max)
}

#[test]
fn without_a_timing_nothing_changes_and_there_is_no_queue() {
    let mut timed = world(&room(), TimingConfig::gauss_gym());
    let mut plain = world(&room(), TimingConfig::default());
    for _ in 0..120 {
        step_and_reset(&mut timed);
        step_and_reset(&mut plain);
        for index in 0..12 {
            assert!(plain.environments.queue[index].is_none());
            let frame = plain.frame_request(index);
            let (sector, pose) = plain.world_from_camera(index);
            assert_eq!((frame.sector, frame.world_from_camera), (sector, pose));
            // On level ground the camera turns as the agent does.
            let rate = frame.rate_rad_s.map(|v| v * v).iter().sum::<f64>().sqrt();
            let turn = plain.states()[index].velocity[2].abs();
            assert!((rate - turn).abs() < 1e-6, "{rate} {turn}");
            let (seed, episode) = plain.random_key(index);
            let frame_number = u64::from(plain.result().steps[index]);
            let noise = frame.noise;
            assert_eq!(
                (noise.seed, noise.episode, noise.frame),
                (seed, episode, frame_number)
            );
            // The camera's timing changes no motion, reward or end.
            assert_eq!(timed.states()[index], plain.states()[index]);
        }
        assert_eq!(timed.result().rewards, plain.result().rewards);
        assert_eq!(timed.result().end_reasons, plain.result().end_reasons);
        assert_eq!(timed.observations(), plain.observations());
        assert_eq!(plain.result().frame_age_s, [0.0; 12]);
    }
    assert!(timed.result().frame_age_s.iter().any(|age| *age > 0.1));
}

#[test]
fn frames_two_steps_late_are_those_of_two_steps_before() {
    let scenes = [room(), SyntheticScene::corridor_loop().unwrap().scene];
    for scene in &scenes {
        let mut plain = world(scene, TimingConfig::default());
        let mut delayed = world(scene, late(0.2));
        let (mut history, mut compared) = (Vec::new(), 0);
        for _ in 0..200 {
            let frames: Vec<_> = (0..12).map(|index| plain.frame_request(index)).collect();
            for (index, frame) in frames.iter().enumerate() {
                let steps = plain.result().steps[index] as usize;
                let back = steps.min(2);
                let expected = match back {
                    0 => frame,
                    _ => {
                        let before: &Vec<FrameRequest> = &history[history.len() - back];
                        &before[index]
                    }
                };
                let found = delayed.frame_request(index);
                assert_eq!(
                    (found.sector, found.noise),
                    (expected.sector, expected.noise)
                );
                assert!(
                    difference(&found, expected) < 1e-15,
                    "{found:?} {expected:?}"
                );
                let age_s = delayed.result().frame_age_s[index];
                assert!((age_s - 0.1 * back as f32).abs() < 1e-6, "{age_s} {back}");
                compared += usize::from(back == 2);
            }
            history.push(frames);
            step_and_reset(&mut plain);
            step_and_reset(&mut delayed);
        }
        assert!(compared > 1000, "{compared}");
    }
}

#[test]
fn a_reset_shows_its_own_frame_and_drops_those_in_transit() {
    let mut world = world(&room(), TimingConfig::gauss_gym());
    let mut dropped = 0;
    for _ in 0..150 {
        let ended = |world: &World| -> Vec<bool> { (0..12).map(|i| world.has_ended(i)).collect() };
        let actions = actions(&world);
        world.step(&actions).unwrap();
        let mask = ended(&world);
        for index in (0..12).filter(|index| mask[*index]) {
            let queue = world.environments.queue[index].as_ref().unwrap();
            dropped += queue.in_transit.len();
            // The final frame is that which the episode ended with.
            assert_eq!(
                frame_bits(&world.frame_request(index)),
                frame_bits(&queue.request(0))
            );
        }
        if !mask.contains(&true) {
            continue;
        }
        world.reset(Some(&mask), None).unwrap();
        for index in (0..12).filter(|index| mask[*index]) {
            let queue = world.environments.queue[index].as_ref().unwrap();
            assert!(queue.in_transit.is_empty());
            let frame = world.frame_request(index);
            let (sector, pose) = world.world_from_camera(index);
            let now = FrameRequest::new(sector, pose);
            assert_eq!((frame.sector, frame.noise.frame), (sector, 0));
            assert_eq!(frame.noise.episode, world.random_key(index).1);
            assert!(difference(&frame, &now) < 1e-15);
            assert_eq!(world.result().frame_age_s[index], 0.0);
        }
    }
    assert!(dropped > 10, "{dropped}");
}

#[test]
fn ages_of_gauss_gym_are_within_its_ranges() {
    let mut world = world(&room(), TimingConfig::gauss_gym());
    let (mut least, mut most) = (f32::INFINITY, 0.0_f32);
    for _ in 0..300 {
        step_and_reset(&mut world);
        for index in 0..12 {
            // Before that the frame of the reset is shown.
            if world.frame_request(index).noise.frame > 0 {
                let age_s = world.result().frame_age_s[index];
                (least, most) = (least.min(age_s), most.max(age_s));
            }
        }
    }
    // A latency, and up to an interval until the next frame.
    assert!((0.12..0.16).contains(&least), "{least}");
    assert!((0.35..0.45).contains(&most), "{most}");
}

#[test]
fn an_agent_that_is_placed_is_captured_in_motion() {
    let mut config = config(1, Task::Velocity);
    config.timing = TimingConfig::regular(20.0, 0.0);
    let mut world = World::new(room(), config).unwrap();
    world.reset(None, None).unwrap();
    let mut state = world.states()[0];
    for _ in 0..4 {
        let before = state.position_m;
        state.position_m[0] += 0.01;
        world.place(0, 0, &state).unwrap();
        world.step(&[0.0, 0.0]).unwrap();
        // Captured at the end of the step, at the speed of physics outside of the world.
        let frame = world.frame_request(0);
        let speed = frame.velocity_m_s.map(|v| v * v).iter().sum::<f64>().sqrt();
        let moved = world.states()[0].position_m[0] - before[0];
        assert!(
            (speed - moved / 0.1).abs() < 1e-6 && moved > 0.009,
            "{speed} {moved}"
        );
    }
}

/// The queue advances with steps alone: a played pose would be seen with the image of another.
#[test]
fn a_recorded_pose_is_not_played_beside_a_timing() {
    let mut config = config(1, Task::Velocity);
    config.timing = late(0.3);
    let mut world = World::new(room(), config).unwrap();
    world.reset(None, None).unwrap();
    let before = world.states()[0];
    let error = world.play(0, 0).unwrap_err();
    assert!(error.to_string().contains("play"), "{error}");
    assert_eq!(world.states()[0], before);
}

#[test]
fn mount_and_timing_are_those_of_a_camera() {
    let mut camera = CameraConfig::pinhole([32, 24], 1.5).unwrap();
    camera.timing = late(0.3);
    camera.body_from_camera = RigidTransform::from_translation_m([0.1, 0.0, 0.4]).unwrap();
    let mut config = config(1, Task::Velocity);
    config.set_camera(&camera);
    let mut world = World::new(room(), config).unwrap();
    world.reset(None, None).unwrap();
    for _ in 0..5 {
        world.step(&[0.2, 0.0]).unwrap();
    }
    assert_eq!(world.frame_request(0).noise.frame, 2);
    let height_m = world.world_from_camera(0).1.translation_m()[2];
    let ground_m = world.states()[0].position_m[2];
    assert!(
        (height_m - ground_m - 0.4).abs() < 1e-9,
        "{height_m} {ground_m}"
    );
}

#[test]
fn the_frame_of_a_step_has_the_motion_of_its_camera() {
    let plane = SyntheticScene::tilted_plane([0.2, -0.1]).unwrap().scene;
    for drive in [Drive::Differential, Drive::Holonomic, Drive::Free] {
        let mut config = config(1, Task::Velocity);
        config.drive = drive;
        config.dt_s = 1e-3;
        config.agent.max_acceleration_m_s2 = 1e6;
        config.agent.max_yaw_acceleration_rad_s2 = 1e6;
        let mut camera = CameraConfig::pinhole([32, 24], 1.5).unwrap();
        let turned = RigidTransform::from_rotation_vector([0.1, 0.2, 0.3], [0.3, 0.2, 1.1]);
        camera.body_from_camera = turned.unwrap() * RigidTransform::body_from_optical();
        config.set_camera(&camera);
        let mut world = World::new(plane.clone(), config).unwrap();
        world.reset(None, None).unwrap();
        let at_rest = world.frame_request(0);
        assert_eq!(
            (at_rest.velocity_m_s, at_rest.rate_rad_s),
            ([0.0; 3], [0.0; 3])
        );
        let action: &[f64] = match drive {
            Drive::Free => &[0.5, 0.3, 0.0, 0.0, 0.0, 0.4],
            Drive::Holonomic => &[0.5, 0.3, 0.4],
            _ => &[0.5, 0.4],
        };
        world.step(action).unwrap();
        let before = world.frame_request(0);
        world.step(action).unwrap();
        let after = world.frame_request(0);
        let motion = before.world_from_camera.inverse() * after.world_from_camera;
        let speeds = motion.translation_m().map(|v| v / 1e-3);
        let rates = motion.rotation_vector().map(|v| v / 1e-3);
        for k in 0..3 {
            let [velocity, rate] = [before.velocity_m_s[k], before.rate_rad_s[k]];
            assert!(
                (velocity - speeds[k]).abs() < 0.02,
                "{drive:?} {k} {velocity} {speeds:?}"
            );
            assert!(
                (rate - rates[k]).abs() < 0.02,
                "{drive:?} {k} {rate} {rates:?}"
            );
        }
        let speed = before
            .velocity_m_s
            .map(|v| v * v)
            .iter()
            .sum::<f64>()
            .sqrt();
        assert!(speed > 0.5, "{speed}");
    }
}
