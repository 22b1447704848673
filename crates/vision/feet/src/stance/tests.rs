use super::*;
use crate::GaitConfig;
use crate::test_noise::Noise;

const NOISE_M: f64 = 0.005;
const NOISE_RAD: f64 = 0.02;

/// Poses at 15 Hz with noise: heading, height and pitch at a time.
fn observed(
    seconds: f64,
    seed: u64,
    pose: impl Fn(f64) -> Option<([f64; 3], [f64; 3])>,
) -> Vec<FootObservation> {
    let mut draw = Noise::new(seed);
    let covariance = Covariance::from_sigmas([NOISE_M; 3], [NOISE_RAD; 3]).unwrap();
    let times = (0..(seconds * 15.0) as i64).map(|n| n as f64 / 15.0);
    let frames = times.filter_map(|t| Some((t, pose(t)?)));
    frames
        .map(|(t, (position, rotation))| {
            let truth = RigidTransform::from_rotation_vector(rotation, position).unwrap();
            let mut noise = |sigma: f64| [0, 1, 2].map(|_| sigma * draw.next());
            let (shift, turn) = (noise(NOISE_M), noise(NOISE_RAD));
            let error = RigidTransform::from_rotation_vector(turn, shift).unwrap();
            FootObservation {
                time_ns: (t * 1e9) as i64,
                world_from_foot: truth * error,
                covariance,
            }
        })
        .collect()
}

/// Steps of 1.4 m each 1.1 s: at rest for 0.4 s, then hidden for 0.45 s, then in swing.
fn walk(t: f64) -> Option<([f64; 3], [f64; 3])> {
    let (step, phase) = ((t / 1.1).floor(), t % 1.1);
    let (x, pitch) = match phase {
        0.0..0.4 => (0.0, 0.0),
        0.4..0.85 => return None,
        _ => {
            let left = (1.1 - phase) / 0.25;
            (1.4 * (1.0 - 0.6 * left * left), -0.4 * left.min(0.6))
        }
    };
    Some(([1.4 * step + x, 0.1, 0.0], [0.0, pitch, 0.02]))
}

fn config() -> StanceConfig {
    GaitConfig::default().stance
}

#[test]
fn every_step_of_a_walk_is_one_stance() {
    for seed in 0..20 {
        let found = stances(&observed(11.0, seed, walk), &config());
        assert_eq!(found.len(), 10, "{seed}: {found:?}");
        for (k, stance) in found.iter().enumerate() {
            let [x, y, z] = stance.world_from_foot.translation_m();
            let error = (x - 1.4 * k as f64).hypot(y - 0.1).hypot(z);
            assert!(error < 0.01, "{seed} {k}: {error}");
            let [from, to] = stance.times_ns.map(|ns| 1e-9 * ns as f64 - 1.1 * k as f64);
            assert!((-0.05..0.14).contains(&from), "{seed} {k}: {from}");
            assert!((0.2..0.41).contains(&to), "{seed} {k}: {to}");
        }
    }
}

#[test]
fn covariance_of_a_stance_is_that_of_its_errors() {
    let mut squares = Vector6::<f64>::zeros();
    let mut sigmas = Vector6::<f64>::zeros();
    let mut count = 0.0;
    for seed in 0..40 {
        for (k, stance) in stances(&observed(11.0, 100 + seed, walk), &config())
            .iter()
            .enumerate()
        {
            let truth =
                RigidTransform::from_rotation_vector([0.0, 0.0, 0.02], [1.4 * k as f64, 0.1, 0.0])
                    .unwrap();
            let error = motion(&truth, &stance.world_from_foot);
            squares += error.component_mul(&error);
            sigmas += stance.covariance.matrix().diagonal();
            count += 1.0;
        }
    }
    let shared = config().shared_sigma;
    for (k, shared) in [0, 0, 1, 2, 2, 3]
        .map(|k: usize| shared[k])
        .iter()
        .enumerate()
    {
        let random = (sigmas[k] / count - shared * shared).sqrt();
        let rms = (squares[k] / count).sqrt();
        assert!((0.7..1.4).contains(&(rms / random)), "{k}: {rms} {random}");
    }
}

#[test]
fn a_foot_that_slides_has_two_stances() {
    let slide = |t: f64| {
        let x = if t < 1.0 { 0.0 } else { 0.05 };
        Some(([x, 0.0, 0.0], [0.0; 3]))
    };
    let found = stances(&observed(2.0, 1, slide), &config());
    assert_eq!(found.len(), 2, "{found:?}");
    let between = motion(&found[0].world_from_foot, &found[1].world_from_foot);
    assert!((between[0] - 0.05).abs() < 0.01, "{between}");
}

#[test]
fn standing_for_minutes_is_one_stance() {
    let sway = |t: f64| Some(([0.001 * (3.0 * t).sin(), 0.0, 0.0], [0.0; 3]));
    let found = stances(&observed(180.0, 2, sway), &config());
    assert_eq!(found.len(), 1, "{}", found.len());
    assert!(found[0].covariance.sigmas()[0] < 0.004);
}

#[test]
fn one_stance_goes_on_while_a_leg_hides_the_foot() {
    let hidden = |t: f64| (!(0.5..0.9).contains(&t)).then_some(([0.0; 3], [0.0; 3]));
    let found = stances(&observed(1.5, 3, hidden), &config());
    assert_eq!(found.len(), 1, "{found:?}");
}

#[test]
fn frames_with_a_wrong_tilt_about_their_tag_divide_no_stance() {
    let foot_from_tag = RigidTransform::from_translation_m([0.06, 0.0, 0.09]).unwrap();
    let of_tag = Covariance::from_sigmas([0.001; 3], [0.03, 0.03, 0.005]).unwrap();
    let covariance = of_tag.moved(&foot_from_tag);
    let frames = (0..8).map(|n| {
        let tilt = match n {
            1 => -0.3,
            2 => 0.25,
            _ => 0.0,
        };
        let turn = RigidTransform::from_rotation_vector([0.0, tilt, 0.0], [0.0; 3]).unwrap();
        FootObservation {
            time_ns: n * 66_666_667,
            world_from_foot: foot_from_tag * turn * foot_from_tag.inverse(),
            covariance,
        }
    });
    let frames: Vec<FootObservation> = frames.collect();
    let found = stances(&frames, &config());
    assert_eq!(found.len(), 1, "{found:?}");
    assert_eq!(found[0].observations, 0..8);
    let error = found[0].world_from_foot.translation().norm();
    assert!(error < 0.006, "{error}");
    // A foot that rolls about its toe moves the tag.
    let roll = frames.iter().enumerate().map(|(n, own)| {
        let toe = RigidTransform::from_translation_m([0.15, 0.0, 0.0]).unwrap();
        let turn = RigidTransform::from_rotation_vector([0.0, 0.1 * n as f64, 0.0], [0.0; 3]);
        FootObservation {
            world_from_foot: toe * turn.unwrap() * toe.inverse(),
            ..*own
        }
    });
    let found = stances(&roll.collect::<Vec<_>>(), &config());
    assert!(found.is_empty(), "{found:?}");
}

#[test]
fn a_foot_that_steps_on_the_spot_has_a_stance_for_each_step() {
    let on_the_spot = |t: f64| {
        let phase = t % 1.2;
        let swing = ((phase - 0.7) / 0.5).max(0.0);
        Some((
            [0.0, 0.0, 0.05 * (std::f64::consts::PI * swing).sin()],
            [0.0; 3],
        ))
    };
    for seed in 0..10 {
        let found = stances(&observed(6.0, seed, on_the_spot), &config());
        assert_eq!(found.len(), 5, "{seed}: {found:?}");
        for stance in &found {
            assert!(stance.world_from_foot.translation().z.abs() < 0.01);
        }
    }
}

/// A fit tells where the middle of a tag is across its rays to a hundredth of a millimeter, and
/// along them to a third of one.
#[test]
fn frames_of_a_foot_that_lifts_do_not_displace_its_stance() {
    let foot_from_tag = RigidTransform::from_translation_m([0.06, 0.0, 0.09]).unwrap();
    let of_tag = Covariance::from_sigmas([1e-5, 1e-5, 5e-4], [0.02, 0.02, 0.008]).unwrap();
    let frames = (0..26).map(|n| {
        // The last one is seen in another direction, in which others say little.
        let ray = match n {
            25 => [0.5, 0.0, 0.0],
            _ => [0.0; 3],
        };
        let ray = RigidTransform::from_rotation_vector(ray, [0.0; 3]);
        let ray = foot_from_tag * ray.unwrap();
        let covariance = of_tag.moved(&ray);
        let lifted = f64::from((n - 20_i32).max(0));
        let turn = [-0.035 * lifted, 0.035 * lifted, 0.0];
        let at = match n {
            25 => [0.007, 0.0, 0.022],
            _ => [0.001 * lifted, 0.0005 * lifted, 0.005 * lifted],
        };
        FootObservation {
            time_ns: i64::from(n) * 33_333_333,
            world_from_foot: RigidTransform::from_rotation_vector(turn, at).unwrap(),
            covariance,
        }
    });
    let frames: Vec<FootObservation> = frames.collect();
    let error = motion(&RigidTransform::identity(), &mean(&frames, &config()).0);
    let [distance, angle] = sizes(&error);
    assert!(distance < 0.003 && angle < 0.02, "{error}");
    let found = stances(&frames, &config());
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(found[0].observations.end >= 20, "{found:?}");
}
