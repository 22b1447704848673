//! Heel strikes by the motion of the trunk that the rig is on.
//!
//! Contract: the trunk is lowest while both feet bear, and a strike jolts it. How its height
//! accelerates around a strike is learned from the wearer's own strikes that frames show well, and
//! tells the time of those that they do not. Without enough of them it tells nothing.
//!
//! That events of walking show in the acceleration of the trunk: Zijlstra, Hof, "Assessment of
//! spatio-temporal gait parameters from trunk accelerations during human walking", Gait Posture 18,
//! 2003; initial contacts are found well by it, final contacts are not: Trojaniello, Cereatti,
//! Della Croce, "Accuracy, sensitivity and robustness of five different methods for the estimation
//! of gait temporal parameters using a single inertial sensor mounted on the lower trunk", Gait
//! Posture 40, 2014.

use super::times::{STEP_S, moments, weights};

/// Time between the heights of a second difference, s: about a fifth of a step.
const DIFFERENCE_S: f64 = 0.09;
/// Second differences around a strike: their number and the time between them, s.
const SAMPLES: usize = 21;
const SAMPLE_S: f64 = 0.025;
/// Samples for which errors are common: half of a period of the difference.
const COMMON: f64 = 4.0;
/// Longest time between two heights, s.
const MAX_GAP_S: f64 = 0.15;
/// Minimum number of strikes that are typical of a wearer.
const MIN_STRIKES: usize = 5;
/// Error of a second difference at least, m: of the poses of the rig.
const SIGMA_M: f64 = 0.002;
/// Range about an expected time in which a strike of the same foot is searched, s: the other foot
/// strikes half a second from it.
const REACH_S: f64 = 0.24;
/// Error of a time besides those, s.
const MODEL_SIGMA_S: f64 = 0.01;
/// Correlation with the typical motion, and mean squared difference from it relative to that of
/// typical strikes, of a motion that is one of a strike: not that of a person who begins to walk.
const MIN_CORRELATION: f64 = 0.8;
const MAX_RATIO: f64 = 4.0;

/// Height of the rig at ordered times.
#[derive(Clone, Debug, Default)]
pub struct RigHeights {
    /// Times, s, and heights, m.
    heights: Vec<[f64; 2]>,
}

impl RigHeights {
    /// Heights at ordered times: s, from the same zero as those of observations, and m. Without
    /// any, strikes follow from feet alone.
    pub fn new(heights: Vec<[f64; 2]>) -> Self {
        Self { heights }
    }

    /// Height at a time: a cubic through the two heights before and after it.
    fn at(&self, time_s: f64) -> Option<f64> {
        let next = self.heights.partition_point(|own| own[0] <= time_s);
        let around = self.heights.get(next.checked_sub(2)?..next + 2)?;
        let is_dense = around.windows(2).all(|of| of[1][0] - of[0][0] < MAX_GAP_S);
        let of = |k: usize| {
            let others = (0..4).filter(|other| *other != k);
            let shares =
                others.map(|other| (time_s - around[other][0]) / (around[k][0] - around[other][0]));
            around[k][1] * shares.product::<f64>()
        };
        is_dense.then(|| (0..4).map(of).sum())
    }

    /// Second differences of the height around a time.
    fn around(&self, time_s: f64) -> Option<[f64; SAMPLES]> {
        let mut differences = [0.0; SAMPLES];
        for (k, difference) in differences.iter_mut().enumerate() {
            let t = time_s + SAMPLE_S * (k as f64 - 0.5 * (SAMPLES as f64 - 1.0));
            let [before, at, after] = [t - DIFFERENCE_S, t, t + DIFFERENCE_S].map(|t| self.at(t));
            *difference = before? - 2.0 * at? + after?;
        }
        Some(differences)
    }
}

/// How the trunk of a wearer moves around a strike.
pub(super) struct TrunkHabit<'a> {
    heights: &'a RigHeights,
    mean: [f64; SAMPLES],
    variance: f64,
}

impl<'a> TrunkHabit<'a> {
    /// From times of strikes, s; `None` if they are too few.
    pub(super) fn learned(
        heights: &'a RigHeights,
        strikes_s: impl Iterator<Item = f64>,
    ) -> Option<Self> {
        let motions: Vec<[f64; SAMPLES]> = strikes_s.filter_map(|t| heights.around(t)).collect();
        if motions.len() < MIN_STRIKES {
            return None;
        }
        // Of a strike that is wrong the median is not.
        let mean = std::array::from_fn(|k| {
            let mut values: Vec<f64> = motions.iter().map(|own| own[k]).collect();
            values.sort_by(f64::total_cmp);
            values[values.len() / 2]
        });
        let mut squares: Vec<f64> = motions.iter().map(|own| distance(own, &mean)).collect();
        squares.sort_by(f64::total_cmp);
        let variance = squares[squares.len() / 2] / SAMPLES as f64 + SIGMA_M * SIGMA_M;
        Some(Self {
            heights,
            mean,
            variance,
        })
    }

    /// Mean and standard deviation of a strike that is expected at a time, s; `None` where the
    /// trunk does not move as it does around strikes.
    pub(super) fn strike(&self, expected_s: f64) -> Option<[f64; 2]> {
        let count = (REACH_S / STEP_S) as i32;
        let times: Vec<f64> = (-count..=count)
            .map(|n| expected_s + STEP_S * f64::from(n))
            .collect();
        let motions: Vec<Option<[f64; SAMPLES]>> =
            times.iter().map(|t| self.heights.around(*t)).collect();
        let log = |motion: &Option<[f64; SAMPLES]>| {
            let square = motion.map_or(f64::INFINITY, |own| distance(&own, &self.mean));
            -0.5 * square / self.variance / COMMON
        };
        let logs: Vec<f64> = motions.iter().map(log).collect();
        let weights = weights(&logs)?;
        let likeliest = (0..weights.len()).max_by(|a, b| weights[*a].total_cmp(&weights[*b]))?;
        let motion = motions[likeliest]?;
        let correlation = correlation(&motion, &self.mean);
        let ratio = distance(&motion, &self.mean) / SAMPLES as f64 / self.variance;
        let [mean, sigma] = moments(|k| times[k], &weights);
        (correlation > MIN_CORRELATION && ratio < MAX_RATIO)
            .then_some([mean, sigma.hypot(MODEL_SIGMA_S)])
    }
}

fn distance(a: &[f64; SAMPLES], b: &[f64; SAMPLES]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b) * (a - b)).sum()
}

fn correlation(a: &[f64; SAMPLES], b: &[f64; SAMPLES]) -> f64 {
    let product = |a: &[f64; SAMPLES], b: &[f64; SAMPLES]| -> f64 {
        a.iter().zip(b).map(|(a, b)| a * b).sum()
    };
    product(a, b) / (product(a, a) * product(b, b)).sqrt().max(1e-12)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A trunk that moves by 2 cm, lowest 60 ms after each strike, on a slope; steps of 0.5 s that
    /// vary by a tenth.
    #[test]
    fn strikes_follow_from_the_motion_of_the_trunk() {
        let mut strikes = vec![0.3];
        for k in 0..40 {
            let step_s = 0.5 * (1.0 + 0.1 * libm::sin(1.7 * f64::from(k)));
            strikes.push(strikes[k as usize] + step_s);
        }
        let height = |t: f64| {
            let t = t - 0.06;
            let next = strikes
                .partition_point(|own| *own <= t)
                .clamp(1, strikes.len() - 1);
            let phase = (t - strikes[next - 1]) / (strikes[next] - strikes[next - 1]);
            0.05 * t - 0.02 * libm::cos(std::f64::consts::TAU * phase)
        };
        let times = (0..310).map(|n| f64::from(n) / 15.0);
        let heights = RigHeights::new(times.map(|t| [t, 1.2 + height(t)]).collect());
        let learned = strikes[2..12].iter().copied();
        let habit = TrunkHabit::learned(&heights, learned).expect("ten strikes");
        for (k, &strike_s) in strikes[14..36].iter().enumerate() {
            let wrong_s = 0.12 * libm::sin(2.3 * k as f64);
            let [time_s, sigma_s] = habit.strike(strike_s + wrong_s).expect("a strike");
            let error_s = time_s - strike_s;
            assert!(
                error_s.abs() < 0.02 && error_s.abs() < 3.0 * sigma_s,
                "{k} {error_s} {sigma_s}"
            );
            assert!(sigma_s < 0.03, "{k} {sigma_s}");
        }
    }

    #[test]
    fn a_trunk_at_rest_tells_nothing() {
        let level = RigHeights::new((0..200).map(|n| [f64::from(n) / 15.0, 1.2]).collect());
        let strikes = (0..8).map(|k| 1.0 + 0.5 * f64::from(k));
        let habit = TrunkHabit::learned(&level, strikes).expect("eight strikes");
        assert_eq!(habit.strike(6.0), None);
        let none = RigHeights::default();
        assert!(TrunkHabit::learned(&none, [1.0; 9].into_iter()).is_none());
    }
}
