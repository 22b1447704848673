//! Error of a camera's clock, from feet at rest while the rig moves.
//!
//! Contract: a time stamp that is late by an interval moves a foot at rest by that interval times
//! the velocity with which the rig carries it. That velocity changes during a stance, and so does
//! the place at which the foot seems to be; the ratio of both changes is the interval. Errors of a
//! pose that do not change during a stance cancel. Soles roll ahead while they bear, as if a clock
//! were a little late and poses a little far apart: what is usual of that is subtracted.

use crate::config::ClockConfig;
use crate::tag_placement::Estimate;

/// A frame of a foot at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RestFrame {
    /// Where a point of the foot seems to be in the world, m.
    pub place: [f64; 3],
    /// Velocity of a point there that is fixed to the rig, in the world, m/s.
    pub velocity: [f64; 3],
    /// Position of the rig in the world, m.
    pub rig: [f64; 3],
    /// Standard deviation of the place, m.
    pub sigma_m: f64,
}

/// By how much the time stamps of a camera are late, s, with a standard deviation from the scatter
/// of the stances; `None` of too few stances, or of a rig that hardly moves in them.
///
/// ```
/// use feet::ClockConfig;
/// use feet::checks::{RestFrame, clock_error};
///
/// // Ten stances during which the rig becomes faster; frames are 8 ms late, and soles roll.
/// let config = ClockConfig::default();
/// let frame = |k: i32| {
///     let speed = 1.0 + 0.1 * f64::from(k);
///     RestFrame {
///         place: [2.0 + (8e-3 + config.roll_s[0]) * speed, 0.0, 0.0],
///         velocity: [speed, 0.0, 0.0],
///         rig: [0.0; 3],
///         sigma_m: 1e-3,
///     }
/// };
/// let stances = vec![(0..6).map(frame).collect::<Vec<_>>(); 10];
/// let late = clock_error(&stances, &config).expect("ten stances");
/// assert!((late.value - 8e-3).abs() < 1e-6);
/// ```
pub fn clock_error(stances: &[Vec<RestFrame>], config: &ClockConfig) -> Option<Estimate> {
    let sigmas = [config.max_sigma_s, config.roll_s[1]];
    let of_motion = ratio(stances, |own| own.velocity, sigmas, config)?;
    Some(of_motion.minus(config.roll_s[0]))
}

/// By how much feet at rest on level ground move with the rig, as a ratio. They do where its
/// poses are too far apart from each other.
pub fn pose_drift(stances: &[Vec<RestFrame>], config: &ClockConfig) -> Option<Estimate> {
    let sigmas = [config.min_drift, config.roll_drift[1]];
    let of_motion = ratio(stances, |own| own.rig, sigmas, config)?;
    Some(of_motion.minus(config.roll_drift[0]))
}

/// Ratio of changes of places to changes of something else. `sigmas` are the largest standard
/// deviation by places alone, and that which all stances share.
fn ratio(
    stances: &[Vec<RestFrame>],
    of: fn(&RestFrame) -> [f64; 3],
    [max_sigma, shared_sigma]: [f64; 2],
    config: &ClockConfig,
) -> Option<Estimate> {
    let parts = stances.iter().filter_map(|own| sums(own, of, config));
    let parts: Vec<[f64; 2]> = parts.collect();
    let count = parts.len() as f64;
    if count < config.min_stances {
        return None;
    }
    let information: f64 = parts.iter().map(|own| own[1]).sum();
    if information < max_sigma.powi(-2) {
        return None;
    }
    let value = parts.iter().map(|own| own[0]).sum::<f64>() / information;
    let squares = parts.iter().map(|own| (own[0] - value * own[1]).powi(2));
    let scatter = (squares.sum::<f64>() * count / (count - 1.0)).sqrt() / information;
    Some(Estimate {
        value,
        sigma: scatter.max(information.powf(-0.5)).hypot(shared_sigma),
    })
}

/// Of a stance: products of changes of place and of something else, and squares of changes of that,
/// each over the variance of a place.
fn sums(
    frames: &[RestFrame],
    other: fn(&RestFrame) -> [f64; 3],
    config: &ClockConfig,
) -> Option<[f64; 2]> {
    if frames.len() < config.min_frames {
        return None;
    }
    let weight = |own: &RestFrame| own.sigma_m.hypot(config.place_sigma_m).powi(-2);
    let all: f64 = frames.iter().map(weight).sum();
    let mean = |of: fn(&RestFrame) -> [f64; 3], k: usize| {
        frames
            .iter()
            .map(|own| weight(own) * of(own)[k])
            .sum::<f64>()
            / all
    };
    let mut sums = [0.0; 2];
    for k in 0..3 {
        let place = mean(|own| own.place, k);
        let middle = mean(other, k);
        for own in frames {
            let change = other(own)[k] - middle;
            sums[0] += weight(own) * change * (own.place[k] - place);
            sums[1] += weight(own) * change * change;
        }
    }
    Some(sums)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_noise::Noise;

    /// Stances of a person who walks: the rig is slower in their middle; places have errors of 2 mm
    /// that neighboring frames share in part, and creep by some millimetres.
    fn walk(seed: u64, late_s: f64, count: usize) -> Vec<Vec<RestFrame>> {
        let mut noise = Noise::new(seed);
        let late_s = late_s + ClockConfig::default().roll_s[0];
        let stance = |_| {
            let offset = 0.01 * noise.next();
            let creep = 2e-3 * noise.next();
            let frame = |k: i32| {
                let phase = f64::from(k) / 7.0;
                let forward = 1.2 + 0.3 * libm::cos(std::f64::consts::TAU * phase);
                let up = 0.3 * libm::sin(std::f64::consts::TAU * phase);
                let velocity = [forward, 0.05 * noise.next(), up];
                let mut error = || 2e-3 * noise.next();
                let place = [
                    offset + late_s * velocity[0] + creep * phase + error(),
                    late_s * velocity[1] + error(),
                    late_s * velocity[2] + error(),
                ];
                RestFrame {
                    place,
                    velocity,
                    rig: [1.2 * 0.066 * f64::from(k), 0.0, 0.0],
                    sigma_m: 1e-3,
                }
            };
            (0..8).map(frame).collect()
        };
        (0..count).map(stance).collect()
    }

    #[test]
    fn late_clocks_are_found_within_their_sigmas() {
        let config = ClockConfig::default();
        let mut beyond = 0;
        for seed in 0..40 {
            let late_s = 1e-3 * (seed as f64 - 20.0);
            let found = clock_error(&walk(seed, late_s, 30), &config).expect("thirty stances");
            assert!((found.value - late_s).abs() < 2e-3, "{seed}: {found:?}");
            assert!(found.sigma < 1.5e-3, "{seed}: {found:?}");
            beyond += usize::from((found.value - late_s).abs() > 2.0 * found.sigma);
        }
        assert!(beyond <= 4, "{beyond} of 40");
    }

    #[test]
    fn poses_that_drift_are_found() {
        let config = ClockConfig::default();
        for seed in 0..10 {
            let mut walk = walk(seed, 0.0, 30);
            let sound = pose_drift(&walk, &config).expect("thirty stances");
            assert!(sound.value.abs() < config.min_drift, "{seed}: {sound:?}");
            for own in walk.iter_mut().flatten() {
                own.place[0] += 0.02 * own.rig[0];
            }
            let found = pose_drift(&walk, &config).expect("thirty stances");
            assert!((found.value - 0.02).abs() < 0.005, "{seed}: {found:?}");
        }
    }

    #[test]
    fn a_rig_that_rests_or_few_stances_say_nothing() {
        let config = ClockConfig::default();
        assert_eq!(clock_error(&walk(1, 0.01, 3), &config), None);
        let mut standing = walk(2, 0.01, 30);
        for own in standing.iter_mut().flatten() {
            own.velocity = [0.0; 3];
        }
        assert_eq!(clock_error(&standing, &config), None);
    }
}
