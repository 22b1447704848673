//! Jumps of the poses of the rig, from feet at rest.
//!
//! Contract: a foot that is at rest before and after an interval in which no foot can step, at
//! another place but in the same direction, has not moved: the poses of the rig jump there, or the
//! camera moved on the rig. If the other foot is at rest throughout, the first one slid.

use std::ops::Range;

use nalgebra::Vector3;

use crate::config::{JumpConfig, StanceConfig};
use crate::contact::seconds;
use crate::poses::motion;
use crate::stance::{FootObservation, runs_at_rest};

/// A jump.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jump {
    /// Times of the frames before and after it, ns.
    pub times_ns: [i64; 2],
    /// Displacement in the world, m.
    pub shift_m: [f64; 3],
}

/// Jumps in the observations of both feet, in order of time.
pub fn jumps(
    feet: [&[FootObservation]; 2],
    stance: &StanceConfig,
    config: &JumpConfig,
) -> Vec<Jump> {
    let runs = feet.map(|own| runs_at_rest(own, stance));
    let mut found: Vec<Jump> = Vec::new();
    for side in 0..2 {
        let of_foot = runs[side].windows(2).filter_map(|pair| {
            let [a, b] = [pair[0].clone(), pair[1].clone()];
            jump(feet[side], a, b, config)
        });
        let other = 1 - side;
        let rests_throughout = |jump: &Jump| {
            let time_ns = |k: usize| feet[other][k].time_ns;
            runs[other].iter().any(|run| {
                time_ns(run.start) <= jump.times_ns[0] && jump.times_ns[1] <= time_ns(run.end - 1)
            })
        };
        found.extend(of_foot.filter(|jump| !rests_throughout(jump)));
    }
    found.sort_by_key(|jump| jump.times_ns);
    // Both feet may show the same one.
    found.dedup_by(|next, last| next.times_ns[0] < last.times_ns[1]);
    found
}

/// A jump between two runs of frames at rest.
fn jump(
    observations: &[FootObservation],
    a: Range<usize>,
    b: Range<usize>,
    config: &JumpConfig,
) -> Option<Jump> {
    let time_ns = |k: usize| observations[k].time_ns;
    let times_ns = [time_ns(a.end - 1), time_ns(b.start)];
    let rest_ns = [time_ns(a.start), time_ns(b.end - 1)];
    let rests = [times_ns[0] - rest_ns[0], rest_ns[1] - times_ns[1]];
    let is_short = seconds(times_ns[1] - times_ns[0]) <= config.max_interval_s;
    if !is_short || rests.iter().any(|rest| seconds(*rest) < config.min_rest_s) {
        return None;
    }
    let before = a.end.saturating_sub(config.frames).max(a.start)..a.end;
    let after = b.start..b.end.min(b.start + config.frames);
    let mean = |run: &Range<usize>| {
        let own = &observations[run.clone()];
        let sum = own.iter().map(|own| *own.world_from_foot.translation());
        sum.sum::<Vector3<f64>>() / own.len() as f64
    };
    let shift = mean(&after) - mean(&before);
    let last = &observations[a.end - 1].world_from_foot;
    let next = &observations[b.start].world_from_foot;
    let turn = motion(last, next).fixed_rows::<3>(3).norm();
    let sigma = |k: usize| {
        let sigmas = observations[k].covariance.sigmas();
        [sigmas[..3].iter(), sigmas[3..].iter()].map(|own| own.fold(0.0, |a: f64, b| a.max(*b)))
    };
    let [from, to] = [sigma(a.end - 1), sigma(b.start)];
    let is_displaced = shift.norm() > config.min_shift_m + 2.0 * from[0].hypot(to[0]);
    let is_turned = turn > config.max_turn_rad + 2.0 * from[1].hypot(to[1]);
    (is_displaced && !is_turned).then_some(Jump {
        times_ns,
        shift_m: shift.into(),
    })
}

#[cfg(test)]
mod tests {
    use cad_transforms::{Covariance, RigidTransform};

    use super::*;
    use crate::config::GaitConfig;
    use crate::test_noise::Noise;

    /// Two seconds of both feet at rest, 15 Hz, displaced by these from 1 s on, m.
    fn feet(shifts_m: [f64; 2], seed: u64) -> [Vec<FootObservation>; 2] {
        let mut noise = Noise::new(seed);
        shifts_m.map(|shift_m| {
            let frame = |n: i64| {
                let y = if n >= 15 { shift_m } else { 0.0 };
                let at = [0.0, y, 0.0].map(|v| v + 1e-3 * noise.next());
                FootObservation {
                    time_ns: n * 66_666_667,
                    world_from_foot: RigidTransform::from_translation_m(at).unwrap(),
                    covariance: Covariance::from_sigmas([2e-3; 3], [0.01; 3]).unwrap(),
                }
            };
            (0..30).map(frame).collect()
        })
    }

    fn found(shifts_m: [f64; 2], seed: u64) -> Vec<Jump> {
        let [left, right] = feet(shifts_m, seed);
        let stance = GaitConfig::default().stance;
        jumps([&left, &right], &stance, &JumpConfig::default())
    }

    #[test]
    fn a_jump_displaces_both_feet() {
        for seed in 0..10 {
            let found = found([0.05; 2], seed);
            assert_eq!(found.len(), 1, "seed {seed}");
            assert_eq!(found[0].times_ns, [14, 15].map(|n| n * 66_666_667));
            assert!((found[0].shift_m[1] - 0.05).abs() < 4e-3, "{found:?}");
        }
    }

    #[test]
    fn a_foot_that_slides_beside_one_at_rest_is_none() {
        assert_eq!(found([0.05, 0.0], 1), []);
        assert_eq!(found([0.0; 2], 2), []);
    }
}
