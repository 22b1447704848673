use std::sync::Arc;

use cad_transforms::RigidTransform;

use super::*;
use crate::camera::queue::{self, CameraView, Capture, FrameQueue};
use crate::scene::SceneData;
use crate::testing::SyntheticScene;

fn scene() -> Arc<SceneData> {
    SyntheticScene::tilted_plane([0.0, 0.0]).unwrap().scene
}

fn view(x: f64, yaw: f64) -> CameraView {
    CameraView {
        sector: 0,
        world_from_camera: RigidTransform::from_rotation_vector([0.0, 0.0, yaw], [x, 0.0, 1.0])
            .unwrap(),
    }
}

/// Uniform numbers of a test.
fn draw(case: u64, index: u64, range: [f64; 2]) -> f64 {
    range[0] + (range[1] - range[0]) * counter_random::uniform(12, case, index)
}

#[test]
fn the_newest_frame_is_that_of_the_closed_form_in_1000_random_schedules() {
    let scene = scene();
    let mut superseded = 0;
    for case in 0..1000 {
        let interval = draw(case, 0, [0.02, 0.2]);
        let config = TimingConfig {
            interval_s: [interval, interval * draw(case, 1, [1.0, 2.0])],
            phase: [0.0, draw(case, 2, [0.0, 1.0])],
            latency_s: match case % 2 {
                0 => [draw(case, 3, [0.0, 0.3]); 2],
                _ => [0.0, draw(case, 3, [0.0, 0.3])],
            },
            redraw_s: draw(case, 4, [0.0, 1.0]) * (case % 3) as f64,
        };
        let schedule = CameraSchedule::new(&config, case, case / 7).unwrap();
        let (phase, interval) = (schedule.phase_ns, schedule.interval_ns);
        let mut queue = FrameQueue::new(schedule, &view(0.0, 0.0));
        let mut now = 0;
        for step in 0..60 {
            let duration = draw(case, 100 + step, [1e6, 1.5e8]) as i64;
            let after = view((now + duration) as f64 * 1e-9, 0.0);
            let old = queue.current.number;
            queue.advance(&scene, &after, duration);
            now += duration;
            // Independent of the queue: the largest index of all that are captured and delivered.
            let expected = if schedule.latency_ns[0] == schedule.latency_ns[1] {
                let delivered = now - phase - schedule.latency_ns[0];
                if delivered < 0 {
                    0
                } else {
                    delivered / interval + 1
                }
            } else {
                let captured = (0..).take_while(|k| phase + k * interval <= now);
                let is_delivered = |k: &i64| {
                    let time = phase + k * interval;
                    time + schedule.latency_ns(*k as u64, time) <= now
                };
                captured.filter(is_delivered).last().map_or(0, |k| k + 1)
            };
            assert_eq!(
                queue.current.number as i64, expected,
                "case {case}, step {step}"
            );
            superseded += queue.current.number.saturating_sub(old + 1);
            let time = if expected == 0 {
                0
            } else {
                phase + (expected - 1) * interval
            };
            assert_eq!(queue.current.time_ns, time);
            assert_eq!(queue.age_s(), (now - time) as f64 * 1e-9);
            // Captured where the camera was at that time.
            let x = queue.current.world_from_camera.translation_m()[0];
            assert!((x - time as f64 * 1e-9).abs() < 1e-12, "{x} {time}");
            assert!(queue.in_transit.len() <= queue::MAX_QUEUE);
            assert_eq!(queue.in_transit.capacity(), queue::MAX_QUEUE);
        }
    }
    assert!(superseded > 1000, "{superseded}");
}

#[test]
fn the_frame_of_the_reset_is_shown_until_another_is_delivered() {
    let scene = scene();
    let config = TimingConfig {
        phase: [0.5; 2],
        ..TimingConfig::regular(20.0, 0.12)
    };
    let schedule = CameraSchedule::new(&config, 1, 0).unwrap();
    let mut queue = FrameQueue::new(schedule, &view(7.0, 0.0));
    for (step, number) in [(1, 0), (2, 0), (3, 1), (4, 2)] {
        queue.advance(&scene, &view(1.0, 0.0), 50_000_000);
        assert_eq!(queue.current.number, number, "step {step}");
        let is_reset = queue.current.world_from_camera == view(7.0, 0.0).world_from_camera;
        assert_eq!(is_reset, number == 0);
    }
}

#[test]
fn without_an_interval_each_step_has_its_frame() {
    let scene = scene();
    let schedule = CameraSchedule::new(&TimingConfig::default(), 1, 0).unwrap();
    let mut queue = FrameQueue::new(schedule, &view(0.0, 0.0));
    for step in 1..5 {
        let after = view(f64::from(step), 0.0);
        queue.advance(&scene, &after, 100_000_000);
        assert_eq!((queue.current.number, queue.age_s()), (step as u64, 0.0));
        assert_eq!(queue.current.world_from_camera, after.world_from_camera);
        assert!((queue.current.velocity_m_s[0] - 10.0).abs() < 1e-9);
    }
}

#[test]
fn captures_between_steps_rotate_at_a_constant_rate() {
    let scene = scene();
    let schedule = CameraSchedule::new(&TimingConfig::regular(10.0, 0.0), 1, 0).unwrap();
    let mut queue = FrameQueue::new(schedule, &view(0.0, 0.0));
    queue.advance(&scene, &view(0.0, 0.4), 250_000_000);
    // At 0.2 of 0.25 s.
    let yaw = queue.current.world_from_camera.rotation_vector()[2];
    assert!((yaw - 0.32).abs() < 1e-12, "{yaw}");
    assert!((queue.current.rate_rad_s[2] - 1.6).abs() < 1e-12);
    let noise = queue.request(3).noise;
    assert_eq!((noise.frame, noise.camera), (3, 3));
}

#[test]
fn a_pose_before_a_border_is_carried_into_the_sector_behind_it() {
    let scene = SyntheticScene::corridor_loop().unwrap().scene;
    let before = CameraView {
        sector: 0,
        world_from_camera: RigidTransform::from_translation_m([11.0, 1.0, 1.4]).unwrap(),
    };
    let edge = scene.sectors[0]
        .edges
        .iter()
        .find(|edge| edge.to == 1)
        .unwrap();
    let carried = |x: f64| {
        let pose = RigidTransform::from_translation_m([x, 1.0, 1.4]).unwrap();
        edge.to_from_here.carry(&pose)
    };
    let after = CameraView {
        sector: 1,
        world_from_camera: carried(11.2),
    };
    let schedule = CameraSchedule::new(&TimingConfig::regular(20.0, 0.0), 1, 0).unwrap();
    let mut queue = FrameQueue::new(schedule, &before);
    queue.advance(&scene, &after, 80_000_000);
    assert_eq!((queue.current.sector, queue.current.number), (1, 2));
    let error = (queue.current.world_from_camera.inverse() * carried(11.125)).distance_m();
    assert!(error < 1e-9, "{error}");
}

#[test]
fn a_queue_is_plain_data_of_few_frames() {
    let scene = scene();
    let config = TimingConfig::gauss_gym();
    for seed in 0..50 {
        let schedule = CameraSchedule::new(&config, seed, 3).unwrap();
        let mut queue = FrameQueue::new(schedule, &view(0.0, 0.1));
        for _ in 0..40 {
            queue.advance(&scene, &view(0.3, 0.7), 40_000_000);
        }
        let mut restored = queue.clone();
        assert!(size_of::<Capture>() * (queue.in_transit.len() + 1) < 2048);
        for queue in [&mut queue, &mut restored] {
            queue.advance(&scene, &view(0.5, 0.6), 170_000_000);
        }
        assert_eq!(restored, queue);
    }
}

#[test]
fn draws_are_of_their_own_environment_and_episode() {
    let of =
        |seed, episode| CameraSchedule::new(&TimingConfig::gauss_gym(), seed, episode).unwrap();
    let times = [of(1, 0), of(2, 0), of(1, 1)].map(|s| (s.interval_ns, s.phase_ns));
    assert!(times[0] != times[1] && times[0] != times[2]);
    assert_eq!(of(1, 0), of(1, 0));
    for (interval, phase) in times {
        assert!((50_000_000..=150_000_000).contains(&interval) && (0..interval).contains(&phase));
    }
    // The latency holds for 3 s.
    let schedule = of(4, 0);
    let latencies: Vec<i64> = (0..100)
        .map(|k| schedule.latency_ns(k, schedule.capture_ns(k)))
        .collect();
    let changes = latencies
        .windows(2)
        .filter(|pair| pair[0] != pair[1])
        .count();
    let duration_ns = schedule.capture_ns(99);
    assert_eq!(changes as i64, duration_ns / 3_000_000_000);
}

#[test]
fn impossible_times_are_refused_by_name() {
    let with = |change: fn(&mut TimingConfig)| {
        let mut config = TimingConfig::gauss_gym();
        change(&mut config);
        CameraSchedule::new(&config, 0, 0).unwrap_err().to_string()
    };
    assert!(with(|c| c.latency_s = [0.3, 0.1]).contains("latency_s"));
    assert!(with(|c| c.latency_s = [0.0, 2.0]).contains("16 frames in transit"));
    assert!(with(|c| c.interval_s = [0.0, 0.1]).contains("interval_s"));
    assert!(with(|c| c.phase = [f64::NAN; 2]).contains("phase"));
    let late_steps = TimingConfig {
        latency_s: [0.0, 1.7],
        ..TimingConfig::default()
    };
    let error = late_steps.check_steps(0.1).unwrap_err().to_string();
    assert!(
        error.contains("camera.timing.latency_s / dt_s: found 17"),
        "{error}"
    );
    late_steps.check_steps(0.2).unwrap();
}

#[test]
fn numbers_and_times_follow_from_the_steps() {
    let scene = scene();
    let late_steps = TimingConfig {
        latency_s: [0.0, 0.3],
        ..TimingConfig::default()
    };
    let regular = TimingConfig::regular(10.0, 0.15);
    for config in [TimingConfig::gauss_gym(), late_steps, regular] {
        config.check_steps(0.05).unwrap();
        for seed in 0..20 {
            let schedule = CameraSchedule::draw(&config, seed, 1);
            let mut queue = FrameQueue::new(schedule, &view(0.0, 0.0));
            for step in 0..100 {
                let times = |queue: &FrameQueue| {
                    let all = std::iter::once(&queue.current).chain(&queue.in_transit);
                    let times = all.map(|f| [f.number as i64, f.time_ns, f.delivery_ns]);
                    (queue.now_ns, queue.next, times.collect::<Vec<_>>())
                };
                let counts = [step, queue.current.number];
                let other = FrameQueue::after_steps(schedule, &queue.camera, counts, 50_000_000);
                assert_eq!(times(&other.unwrap()), times(&queue), "{seed} {step}");
                queue.advance(&scene, &view(0.1 * step as f64, 0.0), 50_000_000);
            }
        }
    }
    // More frames in transit than there can be.
    let schedule = CameraSchedule::draw(&TimingConfig::gauss_gym(), 0, 0);
    for counts in [[1000, 1], [10, 1000]] {
        assert!(FrameQueue::after_steps(schedule, &view(0.0, 0.0), counts, 50_000_000).is_none());
    }
}

#[test]
fn times_beyond_the_last_nanosecond_end() {
    let schedule = CameraSchedule::draw(&TimingConfig::regular(10.0, 0.1), 0, 0);
    let mut queue = FrameQueue::new(schedule, &view(0.0, 0.0));
    queue.now_ns = i64::MAX - 5;
    queue.next = (i64::MAX / schedule.interval_ns) as u64;
    for _ in 0..3 {
        queue.advance(&scene(), &view(1.0, 0.0), 1_000_000_000);
    }
    assert_eq!(queue.now_ns, i64::MAX);
}
