//! What the ground between two contacts adds to the height of a hidden swing.
//!
//! Contract: the least lift by which the sole clears the ground and that is concave over the swing,
//! as a string over the edges of steps is: feet rise and sink once. It is bounded by what is
//! uncertain of the height, so that it changes nothing where frames show the foot. Where the ground
//! is not known it adds nothing.
//!
//! Source of the clearance: 2 cm of the toe on level ground (Moosabhoy and Gard, Gait Posture 24,
//! 2006) to some 4 cm over the edges of stairs (Hamel and others, Gait Posture 21, 2005).

use cad_transforms::RigidTransform;

use crate::contact::SoleEdges;
use crate::ground::GroundHeights;

/// Parts of a swing for which the lift is computed.
const PARTS: usize = 32;
/// Height of the lowest point of the sole above the ground, m.
const CLEARANCE_M: f64 = 0.03;
/// Shares of a swing after which it has this height, and before whose end it loses it.
const CLEARING: [f64; 2] = [0.25, 0.2];
/// Points of the sole that clear the ground, as shares of its length from the heel.
const SOLE_SHARES: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];
/// Height above the higher contact up to which something is ground that feet swing over, m.
const MAX_OBSTACLE_M: f64 = 0.3;
/// Largest lift in standard deviations of the height.
const MAX_SIGMAS: f64 = 2.0;

/// See the module.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SwingClearance {
    /// From toe off to heel strike, s.
    span_s: [f64; 2],
    lifts_m: [f64; PARTS + 1],
}

impl SwingClearance {
    /// Times for which poses of the foot are needed, from toe off to heel strike, s.
    pub(crate) fn times_s([off_s, strike_s]: [f64; 2]) -> [f64; PARTS + 1] {
        std::array::from_fn(|k| off_s + (strike_s - off_s) * k as f64 / PARTS as f64)
    }

    /// Of a foot that is at the poses `shown` at these times. `higher_m`: height of the higher one
    /// of its contacts.
    pub(crate) fn new(
        times_s: [f64; PARTS + 1],
        shown: impl Iterator<Item = RigidTransform>,
        sole: SoleEdges,
        ground: &GroundHeights,
        higher_m: f64,
    ) -> Self {
        let mut needed = [0.0_f64; PARTS + 1];
        // At its ends the foot is on the ground.
        let within = needed.iter_mut().zip(shown).enumerate().take(PARTS).skip(1);
        for (k, (needed, foot)) in within {
            let phase = k as f64 / PARTS as f64;
            let cleared = (phase / CLEARING[0]).min((1.0 - phase) / CLEARING[1]);
            let clearance_m = CLEARANCE_M * cleared.min(1.0);
            for share in SOLE_SHARES {
                let ahead_m = share * (sole.heel_m + sole.toe_m) - sole.heel_m;
                let [x, y, z] = foot.apply([ahead_m, 0.0, 0.0]);
                if let Some(height_m) = ground.below([x, y], higher_m + MAX_OBSTACLE_M) {
                    *needed = needed.max(height_m + clearance_m - z);
                }
            }
        }
        Self {
            span_s: [times_s[0], times_s[PARTS]],
            lifts_m: concave(&needed),
        }
    }

    /// Lift at a time, s, of a foot whose height has a standard deviation, m.
    pub(crate) fn lift_m(&self, time_s: f64, sigma_m: f64) -> f64 {
        let [off_s, strike_s] = self.span_s;
        let phase = ((time_s - off_s) / (strike_s - off_s).max(1e-3)).clamp(0.0, 1.0);
        let place = phase * PARTS as f64;
        let k = (place as usize).min(PARTS - 1);
        let share = place - k as f64;
        let lift_m = self.lifts_m[k] * (1.0 - share) + self.lifts_m[k + 1] * share;
        lift_m.min(MAX_SIGMAS * sigma_m)
    }
}

/// The least concave function that is nowhere below values at equal distances.
fn concave(values: &[f64; PARTS + 1]) -> [f64; PARTS + 1] {
    let mut corners: Vec<usize> = Vec::new();
    for k in 0..values.len() {
        while let [.., a, b] = corners[..] {
            let slope = (values[k] - values[a]) / (k - a) as f64;
            if values[b] > values[a] + slope * (b - a) as f64 {
                break;
            }
            corners.pop();
        }
        corners.push(k);
    }
    let mut hull = *values;
    for pair in corners.windows(2) {
        let (a, b) = (pair[0], pair[1]);
        for (k, value) in hull.iter_mut().enumerate().take(b).skip(a + 1) {
            let share = (k - a) as f64 / (b - a) as f64;
            *value = values[a] + (values[b] - values[a]) * share;
        }
    }
    hull
}

#[cfg(test)]
mod tests {
    use super::*;

    const SOLE: SoleEdges = SoleEdges {
        heel_m: 0.13,
        toe_m: 0.15,
    };

    /// Lifts of a level foot that moves by 0.6 m and up by a rise, at a phase; the ground has steps
    /// of 0.3 m.
    fn lift(rise_m: f64, phase: f64, sigma_m: f64) -> f64 {
        let step = |x: f64| rise_m * (x / 0.3).floor();
        let points = (-50..100).flat_map(|i| {
            (-10..10).map(move |j| [0.02 * f64::from(i) + 0.01, 0.02 * f64::from(j)])
        });
        let ground = GroundHeights::new(points.map(|[x, y]| [x, y, step(x)]));
        let times = SwingClearance::times_s([1.0, 1.4]);
        let shown = times.map(|t| {
            let along = (t - 1.0) / 0.4;
            let place = [0.14 + 0.6 * along, 0.0, 2.0 * rise_m * along + 0.02];
            RigidTransform::from_translation_m(place).unwrap()
        });
        let found = SwingClearance::new(times, shown.into_iter(), SOLE, &ground, 2.0 * rise_m);
        found.lift_m(1.0 + 0.4 * phase, sigma_m)
    }

    #[test]
    fn soles_clear_the_edges_of_steps() {
        // The toe passes the second edge above the first tread.
        let (phase, missing_m) = (0.1, 0.17 - 0.17 * 0.2 - 0.02);
        assert!(lift(0.17, phase, 0.2) > missing_m - 0.05);
        assert!(lift(0.17, 0.5, 0.2) > 0.1);
        assert!(lift(-0.17, 0.5, 0.2) > 0.05);
    }

    #[test]
    fn level_ground_and_the_ends_of_a_swing_need_hardly_any_lift() {
        assert!((0.005..0.015).contains(&lift(0.0, 0.5, 0.2)));
        for rise_m in [-0.17, 0.17] {
            assert!(lift(rise_m, 0.0, 0.2).abs() < 1e-9);
            assert!(lift(rise_m, 1.0, 0.2).abs() < 1e-9);
        }
    }

    #[test]
    fn nothing_is_lifted_that_frames_show() {
        assert!(lift(0.17, 0.5, 0.002) <= 0.004);
    }

    #[test]
    fn concave_functions_are_as_low_as_they_can_be() {
        let mut values = [0.0; PARTS + 1];
        (values[8], values[12], values[24]) = (0.1, 0.02, 0.08);
        let hull = concave(&values);
        assert_eq!(
            [hull[0], hull[8], hull[24], hull[PARTS]],
            [0.0, 0.1, 0.08, 0.0]
        );
        assert!((hull[4] - 0.05).abs() < 1e-12 && (hull[16] - 0.09).abs() < 1e-12);
    }
}
