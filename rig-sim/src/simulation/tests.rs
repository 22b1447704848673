use super::*;
use crate::camera::Shutter;
use crate::lens::Lens;
use crate::scene::surface::Class;

fn settings() -> Settings {
    Settings {
        kind: Kind::Pavement,
        time: Time::Day,
        seed: 3,
        seconds: 8.0,
        rate_hz: 10.0,
        width: 160,
        height: 90,
        quality: Quality::FAST,
    }
}

fn example() -> Rig {
    Rig::parse(include_str!("../../../cad-transforms/rigs/example.toml")).unwrap()
}

#[test]
fn what_cannot_be_simulated_is_refused_with_a_reason() {
    type Change = fn(&mut Settings);
    let cases: [(Change, &str); 9] = [
        (|s| s.seconds = 0.0, "length of the walk is 0,"),
        (|s| s.seconds = -1.0, "length of the walk is -1,"),
        (|s| s.seconds = f64::NAN, "length of the walk is NaN,"),
        (|s| s.seconds = 1e9, "at most 3600 s"),
        (|s| s.seconds = 0.09, "at least one period of 0.1 s"),
        (|s| s.rate_hz = 0.0, "rate of the cameras is 0,"),
        (|s| s.rate_hz = f64::INFINITY, "at most 100 Hz"),
        (
            |s| s.width = 161,
            "width of an eye is 161, expected an even number",
        ),
        (
            |s| s.height = 14,
            "height is 14, expected an even number of pixels from 16",
        ),
    ];
    for (change, expected) in cases {
        let mut wrong = settings();
        change(&mut wrong);
        let message = Simulation::new(&wrong, &example()).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn frames_lie_in_the_middle_of_whole_periods() {
    let thirds = Settings {
        seconds: 1.0,
        rate_hz: 3.0,
        ..settings()
    };
    let times: Vec<i64> = (0..thirds.frame_count())
        .map(|n| thirds.frame_ns(n))
        .collect();
    assert_eq!(times, [166_666_667, 500_000_000, 833_333_333]);
    for tenths in 1..200 {
        let whole = Settings {
            seconds: f64::from(tenths) * 0.1,
            ..settings()
        };
        assert_eq!(whole.frame_count(), tenths as u64, "{tenths}");
    }
}

#[test]
fn a_camera_gives_the_same_frames_again() {
    let short = Settings {
        seconds: 0.5,
        width: 32,
        height: 18,
        ..settings()
    };
    let simulation = Arc::new(Simulation::new(&short, &example()).unwrap());
    let frames: Vec<StereoFrame> = simulation.pictures(0).collect();
    assert_eq!(frames.len(), 5);
    assert_eq!(frames, simulation.pictures(0).collect::<Vec<_>>());
    let numbers: Vec<u64> = frames.iter().map(|f| f.number).collect();
    assert_eq!(numbers, [0, 1, 2, 3, 4]);
    // The eyes look from two places and have noise of their own.
    assert_ne!(frames[0].grey(0), frames[0].grey(1));
    assert_eq!(frames[0].grey(0).len(), 32 * 18);
}

/// The rasteriser against its slow twin: the depth of a pixel is that of its own ray, away from edges,
/// which the rasteriser places to 0.1 px.
#[test]
fn true_depth_is_that_of_ray_casting() {
    let simulation = Arc::new(Simulation::new(&settings(), &example()).unwrap());
    let (width, height) = (160, 90);
    for (camera, sim_camera) in simulation.cameras().iter().enumerate() {
        let mut pictures = simulation.pictures(camera);
        let (mut compared, mut looked) = (0, 0);
        for (eye, time_ns) in [(0, 2_000_000_000), (1, 4_700_000_000), (0, 7_300_000_000)] {
            let truth = pictures.truth(eye, time_ns);
            let lens = Lens::new(&sim_camera.models[eye]);
            for k in 0..300 {
                let pick = |stream, size| (random::bits(9, stream, k) % size) as usize;
                let (u, v) = (pick(0, width), pick(1, height));
                let pixel = v * width as usize + u;
                // Rays are cast at what stands, not at the wearer.
                if truth.class[pixel] == Class::Person {
                    continue;
                }
                let row_s = match sim_camera.shutter {
                    Shutter::Global => 0.0,
                    Shutter::Rolling { line_s } => line_s * (v as f64 - 0.5 * (height - 1) as f64),
                };
                let rig = simulation.walker.rig(seconds(time_ns) + row_s);
                let (origin, rotation) = sim_camera.world_from_eye(eye, &rig, None);
                let inverse_depth = |du: f64, dv: f64| {
                    let (x, y) = lens.unproject(u as f64 + du, v as f64 + dv);
                    // 1 long along the optical axis, so that the distance is the depth.
                    let direction = rotation * Vector3::new(x, y, 1.0);
                    let hit = simulation.scene.first_hit(&origin, &direction);
                    hit.map_or(0.0, |hit| 1.0 / hit.distance)
                };
                looked += 1;
                // Linear on the picture within a plane, and 0 for the sky.
                let expected = inverse_depth(0.0, 0.0);
                let bent = |du: f64, dv: f64| {
                    let sum = inverse_depth(du, dv) + inverse_depth(-du, -dv);
                    (0.5 * sum - expected).abs() > 1e-4 * expected
                };
                if bent(0.25, 0.0) || bent(0.0, 0.25) {
                    continue;
                }
                let found = 1.0 / f64::from(truth.depth[pixel]);
                assert!(
                    (found - expected).abs() <= 1e-3 * expected,
                    "{} {u} {v}: {} m, by its ray {} m",
                    sim_camera.name,
                    1.0 / found,
                    1.0 / expected
                );
                compared += 1;
            }
        }
        assert!(
            compared > 300 && 4 * compared > 3 * looked,
            "{}: {compared} of {looked}",
            sim_camera.name
        );
    }
}

#[test]
fn the_wearer_sees_his_shoes_and_the_shoulders_do_not() {
    let simulation = Arc::new(Simulation::new(&settings(), &example()).unwrap());
    for (camera, sim_camera) in simulation.cameras().iter().enumerate() {
        let truth = simulation.pictures(camera).truth(0, 4_000_000_000);
        let own = truth.class.iter().filter(|&&class| class == Class::Person);
        let share = own.count() as f64 / truth.class.len() as f64;
        match sim_camera.name == "feet" {
            true => assert!((0.02..0.5).contains(&share), "{share}"),
            false => assert_eq!(share, 0.0, "{}", sim_camera.name),
        }
    }
}
