//! Fit of the measure's constants.

use rayon::prelude::*;
use splats::MeasureConfig;

use super::rules::{BAD_DEPTH_ERROR, BAD_PSNR_DB, Counts, counts};
use super::samples::Sample;

/// Factors by which a constant changes, and rounds of the search.
const FACTORS: [f32; 6] = [0.5, 0.8, 0.95, 1.05, 1.25, 2.0];
const ROUNDS: usize = 12;
/// Errors of the prediction count up to these: PSNR in dB, depth in octaves.
const PSNR_RANGE_DB: [f64; 2] = [8.0, 28.0];
const DEPTH_RANGE: [f64; 2] = [0.01, 1.0];
/// Octaves of depth that count as much as one dB.
const DB_PER_OCTAVE: f64 = 1.0;

/// Prediction of a sample: PSNR (dB) and relative error of depth.
type Predicted = [f64; 2];

/// Fits by a search along one constant after the other, from the default on. Limits are those that
/// flag every bad sample and the fewest good ones.
pub(crate) fn fit(samples: &[Sample]) -> MeasureConfig {
    let mut config = MeasureConfig::default();
    let mut best = objective(samples, &config);
    for _ in 0..ROUNDS {
        let before = best;
        for k in 0..constants(&mut config).len() {
            let from = *constants(&mut config)[k];
            for factor in FACTORS {
                let mut other = config;
                *constants(&mut other)[k] = from.max(0.02) * factor;
                let found = objective(samples, &other);
                if found < best {
                    (config, best) = (other, found);
                }
            }
        }
        if before - best < 1e-4 {
            break;
        }
    }
    let predicted = predictions(samples, &config);
    let (limits, _) = limits(samples, &predicted);
    [config.min_psnr_db, config.max_depth_error] = limits.map(|limit| limit as f32);
    config
}

fn constants(of: &mut MeasureConfig) -> [&mut f32; 9] {
    [
        &mut of.uncovered,
        &mut of.angle,
        &mut of.few,
        &mut of.magnification,
        &mut of.space,
        &mut of.spread,
        &mut of.unknown_error,
        &mut of.error_gain,
        &mut of.unknown_depth_error,
    ]
}

fn predictions(samples: &[Sample], config: &MeasureConfig) -> Vec<Predicted> {
    let of = |sample: &Sample| {
        let confidence = sample.channels.confidence(config);
        [confidence.psnr_db, confidence.depth_error].map(f64::from)
    };
    samples.par_iter().map(of).collect()
}

/// Mean squared error of the prediction.
fn objective(samples: &[Sample], config: &MeasureConfig) -> f64 {
    let predicted = predictions(samples, config);
    let squares = samples
        .iter()
        .zip(&predicted)
        .map(|(sample, [psnr, depth])| {
            let [low, high] = PSNR_RANGE_DB;
            let of_psnr = psnr.clamp(low, high) - sample.errors.psnr_db.clamp(low, high);
            let octaves = |depth: f64| libm::log2(depth.clamp(DEPTH_RANGE[0], DEPTH_RANGE[1]));
            let of_depth = DB_PER_OCTAVE * (octaves(*depth) - octaves(sample.errors.depth_error));
            of_psnr * of_psnr + of_depth * of_depth
        });
    squares.sum::<f64>() / samples.len() as f64
}

/// Limits of PSNR and depth that flag every bad sample, with the fewest good ones.
fn limits(samples: &[Sample], predicted: &[Predicted]) -> ([f64; 2], Counts) {
    let flagged = |[psnr, depth]: [f64; 2]| -> Vec<bool> {
        let of = predicted.iter();
        of.map(|of| of[0] < psnr || of[1] > depth).collect()
    };
    let mut best: Option<([f64; 2], Counts)> = None;
    let bad: Vec<Predicted> = samples
        .iter()
        .zip(predicted)
        .filter(|(sample, _)| sample.errors.is_bad())
        .map(|(_, predicted)| *predicted)
        .collect();
    // Just above the prediction of each bad sample, so that PSNR flags it; depth has to flag those
    // with a higher one.
    let candidates = bad.iter().map(|of| of[0] + 1e-3).chain([0.0]);
    for psnr in candidates {
        let rest = bad.iter().filter(|of| of[0] >= psnr).map(|of| of[1]);
        let depth = rest.fold(f64::INFINITY, f64::min) - 1e-4;
        let depth = if depth.is_finite() { depth } else { 1.0 };
        let found = counts(samples, &flagged([psnr, depth]));
        let is_better = |(_, best): &([f64; 2], Counts)| found.good_flagged < best.good_flagged;
        if best.as_ref().is_none_or(is_better) {
            best = Some(([psnr, depth], found));
        }
    }
    best.unwrap_or(([BAD_PSNR_DB, BAD_DEPTH_ERROR], Counts::default()))
}

#[cfg(test)]
mod tests {
    use super::super::rules::tests::sample;
    use super::*;

    #[test]
    fn both_limits_together_flag_every_bad_sample() {
        let samples = [
            sample(25.0, 0.02, [0.1, 0.0], 1.0),
            sample(17.0, 0.02, [1.0, 0.0], 1.0),
            sample(22.0, 0.30, [0.3, 0.0], 1.0),
            sample(24.0, 0.05, [0.3, 0.0], 1.0),
        ];
        // The first bad one has a low PSNR, the second one a high error of depth.
        let predicted = [[24.0, 0.03], [16.0, 0.03], [23.0, 0.2], [22.0, 0.06]];
        let ([psnr, depth], found) = limits(&samples, &predicted);
        assert!((16.0..22.0).contains(&psnr) && (0.06..0.2).contains(&depth));
        assert_eq!((found.bad_unflagged, found.good_flagged), (0, 0));
        assert_eq!(found.bad_flagged, 2);
    }
}
