//! Exam 6.13: a range that changes leaves all other draws as they are.

use super::*;
use crate::camera::TimingConfig;
use crate::episode::RandomizationConfig;
use crate::world::episode::Target;

/// What an episode draws, each as bits: start, goal, speeds, mount, times of frames, latencies, and
/// the key of noise, exposure and lens of its images.
fn draws(randomization: RandomizationConfig, change: fn(&mut WorldConfig)) -> [Vec<u64>; 7] {
    let mut config = config(50, Task::PointGoal);
    config.randomization = randomization;
    config.timing = TimingConfig::gauss_gym();
    change(&mut config);
    let mut world = World::new(room(), config).unwrap();
    let mut draws: [Vec<u64>; 7] = Default::default();
    for _ in 0..20 {
        world.reset(None, None).unwrap();
        for i in 0..50 {
            let state = &world.states()[i];
            let episode = &world.environments.episode[i];
            let parameters = &episode.parameters;
            draws[0].extend(state.position_m.map(f64::to_bits));
            draws[0].push(state.yaw_rad.to_bits());
            let Target::Goal { index, .. } = episode.target else {
                panic!("{:?}", episode.target);
            };
            draws[1].push(u64::from(index));
            draws[2].extend([parameters.speed_scale, parameters.yaw_rate_scale].map(f64::to_bits));
            draws[3].extend(parameters.mount.map(f64::to_bits));
            let schedule = world.environments.queue[i].as_ref().unwrap().schedule;
            draws[4].extend([schedule.phase_ns, schedule.interval_ns].map(|ns| ns as u64));
            draws[5].extend((0..5).map(|k| schedule.latency_ns(k, 0) as u64));
            let key = world.frame_request(i).noise;
            draws[6].extend([key.seed, key.episode, key.frame]);
        }
    }
    draws
}

#[test]
fn streams_are_independent() {
    let base = RandomizationConfig {
        speed_scale: [0.8, 1.2],
        yaw_rate_scale: [0.8, 1.2],
        mount_m: 0.02,
        mount_rad: 0.03,
        ..RandomizationConfig::default()
    };
    let nothing = |_: &mut WorldConfig| {};
    let expected = draws(base, nothing);
    let faster = RandomizationConfig {
        speed_scale: [0.5, 2.0],
        ..base
    };
    let mounted = RandomizationConfig {
        mount_m: 0.05,
        mount_rad: 0.0,
        ..base
    };
    let late = |config: &mut WorldConfig| config.timing.latency_s = [0.0, 0.5];
    let slow = |config: &mut WorldConfig| config.timing.interval_s = [0.1, 0.2];
    for (changed, found) in [
        (2, draws(faster, nothing)),
        (3, draws(mounted, nothing)),
        (4, draws(base, slow)),
        (5, draws(base, late)),
    ] {
        for stream in 0..7 {
            assert_eq!(
                found[stream] == expected[stream],
                stream != changed,
                "{changed} {stream}"
            );
        }
    }
    // Whether a start is near enough to recorded cameras depends on its yaw: without that limit.
    let far = |config: &mut WorldConfig| config.end.max_deviation_m = 100.0;
    let expected = draws(base, far);
    let found = draws(base, |config| {
        config.end.max_deviation_m = 100.0;
        config.randomization.start_yaw_rad = [0.0, 1.0];
    });
    assert!(found[0] != expected[0] && found[1..] == expected[1..]);
    // A start without a goal in range is drawn again: here every start has several.
    let many = |config: &mut WorldConfig| {
        config.end.max_deviation_m = 100.0;
        config.task.goals = 40;
        config.task.goal_distance_m = [0.5, 20.0];
    };
    let expected = draws(base, many);
    let found = draws(base, |config| {
        config.end.max_deviation_m = 100.0;
        config.task.goals = 40;
        config.task.goal_distance_m = [0.5, 4.0];
    });
    for stream in 0..7 {
        assert_eq!(found[stream] == expected[stream], stream != 1, "{stream}");
    }
}

#[test]
fn commands_have_a_draw_for_each_range() {
    let task = |command_m_s, command_rad_s| TaskConfig {
        command_m_s,
        command_rad_s,
        ..TaskConfig::default()
    };
    let commands = |task: TaskConfig| {
        let numbers = (0..200).map(|k| task.command(k, 3, 5.0 * k as f64));
        numbers
            .map(|command| command.map(f64::to_bits))
            .collect::<Vec<_>>()
    };
    let base = commands(task([-0.5, 1.5], [-1.0, 1.0]));
    let faster = commands(task([0.0, 3.0], [-1.0, 1.0]));
    let turning = commands(task([-0.5, 1.5], [-2.0, 0.5]));
    assert!(
        base.iter()
            .zip(&faster)
            .all(|(a, b)| a[0] != b[0] && a[1] == b[1])
    );
    assert!(
        base.iter()
            .zip(&turning)
            .all(|(a, b)| a[0] == b[0] && a[1] != b[1])
    );
}

#[test]
fn draws_fill_their_ranges() {
    let randomization = RandomizationConfig {
        speed_scale: [0.8, 1.2],
        mount_m: 0.02,
        ..RandomizationConfig::default()
    };
    let drawn: Vec<_> = (0..2000)
        .map(|number| randomization.draw(1, number))
        .collect();
    let range = |of: &dyn Fn(usize) -> f64| {
        (0..2000)
            .map(of)
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| {
                [low.min(v), high.max(v)]
            })
    };
    for ([low, high], expected) in [
        (range(&|i| drawn[i].speed_scale), [0.8, 1.2]),
        (range(&|i| drawn[i].mount[1]), [-0.02, 0.02]),
        (range(&|i| drawn[i].mount[4]), [0.0, 0.0]),
        (range(&|i| drawn[i].yaw_rate_scale), [1.0, 1.0]),
    ] {
        let width = expected[1] - expected[0];
        assert!(low >= expected[0] && high <= expected[1]);
        assert!(high - low >= 0.99 * width, "{low} {high}");
    }
}

#[test]
fn scaled_speeds_and_mounts_are_applied() {
    let with = |speed_scale: [f64; 2], mount_m: f64| {
        let mut config = config(1, Task::Velocity);
        config.randomization.speed_scale = speed_scale;
        config.randomization.mount_m = mount_m;
        let mut world = World::new(room(), config).unwrap();
        world.reset(None, None).unwrap();
        for _ in 0..3 {
            world.step(&[0.3, 0.0]).unwrap();
        }
        world
    };
    let [slow, fast] = [with([1.0; 2], 0.0), with([1.5; 2], 0.0)];
    let ratio = fast.result().path_length_m[0] / slow.result().path_length_m[0];
    assert!(ratio > 1.2, "{ratio}");
    let mounted = with([1.0; 2], 0.02);
    assert_eq!(mounted.states(), slow.states());
    let [a, b] = [&mounted, &slow].map(|world| world.world_from_camera(0).1.translation_m());
    let distance = (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt();
    assert!(distance > 1e-4 && distance < 0.035, "{distance}");
}
