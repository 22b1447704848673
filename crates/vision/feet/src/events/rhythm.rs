//! When a foot strikes by the rhythm of the steps around it.
//!
//! Contract: feet that alternate strike about midway between the strikes of the other foot, one
//! side always somewhat earlier than the other. Steps up to `REACH` away count, each by how well
//! its own time is known; those that contradict the rhythm, as at a stumble, count less. The foot's
//! own strike does not count.

use nalgebra::{DMatrix, DVector, Vector3};

/// Deviation of a strike from the middle between those of the other foot, as a share of the time
/// between these: of one step, and of all steps of a side.
const OF_STEP: f64 = 0.035;
const OF_SIDE: f64 = 0.025;
/// Growth of the former where the steps before and after differ in length, by their difference as a
/// share of their sum: people who begin to walk, turn or stop.
const IRREGULAR: f64 = 4.0;
/// Steps before and after one that tell its time.
const REACH: usize = 6;
/// Longest time from a strike to the next one of the other foot, s.
const MAX_STEP_S: f64 = 1.0;
/// Deviation from the rhythm, in standard deviations, from which on a step counts less.
const REGULAR: f64 = 1.5;
const ROUNDS: usize = 4;
/// Largest standard deviation with which others say something, s.
const MAX_SIGMA_S: f64 = 0.12;

/// A step of a foot: which one, about when it stands, and the time of its strike as known by
/// itself, with its standard deviation, s.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    pub(super) side: usize,
    pub(super) index: usize,
    pub(super) stands_s: f64,
    /// Where the foot stands in the world, m.
    pub(super) place: Vector3<f64>,
    pub(super) strike: [f64; 2],
    /// Whether there is a time before it in which no frame shows a foot: steps may be missing.
    pub(super) is_after_unseen: bool,
}

/// Means and standard deviations of the strikes of both feet by the other ones, s.
pub(super) fn rhythm(steps: &[Vec<Step>; 2]) -> [Vec<Option<[f64; 2]>>; 2] {
    let mut all: Vec<Step> = steps.iter().flatten().copied().collect();
    all.sort_by(|a, b| a.stands_s.total_cmp(&b.stands_s));
    let mut found = steps.each_ref().map(|own| vec![None; own.len()]);
    let goes_on = |a: &Step, b: &Step| {
        let goes_on = a.side != b.side && !b.is_after_unseen;
        goes_on && b.strike[0] - a.strike[0] < MAX_STEP_S + a.strike[1] + b.strike[1]
    };
    for chain in all.chunk_by(goes_on) {
        for (k, own) in chain.iter().enumerate() {
            let window = k.saturating_sub(REACH)..chain.len().min(k + REACH + 1);
            let first = window.start;
            found[own.side][own.index] = by_others(&chain[window], k - first);
        }
    }
    found
}

/// The strike of a step by the other ones around it.
fn by_others(steps: &[Step], own: usize) -> Option<[f64; 2]> {
    let count = steps.len();
    if count < 3 {
        return None;
    }
    let first_s = steps[0].strike[0];
    let stride_s = 2.0 * (steps[count - 1].strike[0] - first_s) / (count - 1) as f64;
    let [of_step, of_side] = [OF_STEP, OF_SIDE].map(|share| share * stride_s.max(0.4));
    // Strikes, and by how much those of the first side are late.
    let mut information = DMatrix::<f64>::zeros(count + 1, count + 1);
    let mut gradient = DVector::<f64>::zeros(count + 1);
    information[(count, count)] = of_side.powi(-2);
    for (k, step) in steps.iter().enumerate().filter(|(k, _)| *k != own) {
        let weight = step.strike[1].powi(-2);
        information[(k, k)] += weight;
        gradient[k] += weight * (step.strike[0] - first_s);
    }
    let late = |k: usize| match steps[k].side == steps[0].side {
        true => 1.0,
        false => -1.0,
    };
    let row = |k: usize| [(k - 1, -0.5), (k, 1.0), (k + 1, -0.5), (count, -late(k))];
    let spread = |k: usize| {
        let length = |k: usize| (steps[k].place - steps[k - 1].place).norm();
        let (before, after) = (length(k), length(k + 1));
        let change = (after - before).abs() / (before + after).max(0.2);
        of_step * (1.0 + IRREGULAR * change)
    };
    let spreads: Vec<f64> = (1..count - 1).map(spread).collect();
    let mut weights: Vec<f64> = spreads.iter().map(|own| own.powi(-2)).collect();
    let mut solution = None;
    for _ in 0..ROUNDS {
        let mut whole = information.clone();
        for k in 1..count - 1 {
            for (i, a) in row(k) {
                for (j, b) in row(k) {
                    whole[(i, j)] += weights[k - 1] * a * b;
                }
            }
        }
        let covariance = whole.try_inverse()?;
        let times = &covariance * &gradient;
        for k in 1..count - 1 {
            let deviation: f64 = row(k).iter().map(|(i, a)| a * times[*i]).sum();
            let spread = spreads[k - 1];
            let far = deviation / (REGULAR * spread);
            weights[k - 1] = spread.powi(-2) / (1.0 + far * far);
        }
        solution = Some([first_s + times[own], covariance[(own, own)].max(0.0).sqrt()]);
    }
    solution.filter(|[_, sigma_s]| *sigma_s < MAX_SIGMA_S)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_noise::Noise;

    /// Steps of 0.55 s, of which those in `known` are well known; the right foot is late.
    fn walk(known: impl Fn(usize) -> bool, late_s: f64, seed: u64) -> (Vec<f64>, [Vec<Step>; 2]) {
        let mut noise = Noise::new(seed);
        let mut steps = [Vec::new(), Vec::new()];
        let mut truth = Vec::new();
        for k in 0..14_usize {
            let side = k % 2;
            let time_s = 5.0 + 0.55 * k as f64 + late_s * side as f64 + 0.015 * noise.next();
            let sigma_s = if known(k) { 0.01 } else { 0.15 };
            let index = steps[side].len();
            steps[side].push(Step {
                side,
                index,
                stands_s: time_s + 0.3,
                place: Vector3::new(0.7 * k as f64, 0.1, 0.0),
                strike: [time_s + sigma_s * noise.next(), sigma_s],
                is_after_unseen: false,
            });
            truth.push(time_s);
        }
        (truth, steps)
    }

    #[test]
    fn hidden_strikes_follow_from_known_ones_with_honest_sigmas() {
        let (mut sum, mut count) = (0.0, 0.0);
        for seed in 0..60 {
            let (truth, steps) = walk(|k| matches!(k % 5, 0 | 1), 0.04, seed);
            let found = rhythm(&steps);
            for (k, time_s) in truth.iter().enumerate().take(12).skip(2) {
                let [mean_s, sigma_s] = found[k % 2][k / 2].expect("between known ones");
                let error = mean_s - time_s;
                assert!(error.abs() < 0.15, "{seed} {k}: {error} {sigma_s}");
                assert!(sigma_s < 0.1, "{seed} {k}: {sigma_s}");
                sum += (error / sigma_s).powi(2);
                count += 1.0;
            }
        }
        let nees = sum / count;
        assert!((0.1..1.3).contains(&nees), "{nees}");
    }

    #[test]
    fn a_pause_and_a_missing_step_divide_the_rhythm() {
        let (_, steps) = walk(|_| true, 0.0, 1);
        let mut late = steps.clone();
        for step in late.iter_mut().flatten().filter(|own| own.index >= 3) {
            step.stands_s += 3.0;
            step.strike[0] += 3.0;
        }
        let found = rhythm(&late);
        let before = rhythm(&steps.each_ref().map(|own| own[..3].to_vec()));
        assert_eq!(found[0][..3], before[0][..]);
        let alone = [steps[0].clone(), Vec::new()];
        assert!(rhythm(&alone)[0].iter().all(Option::is_none));
    }
}
