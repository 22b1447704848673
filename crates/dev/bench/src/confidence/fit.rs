//! Fit of the measure's constants.

use rayon::prelude::*;
use splats::{IMAGE_CHANNELS, ImageMeasureConfig, MeasureConfig};

use super::samples::Sample;

/// Factors by which a constant of pixels changes, and rounds of the search.
const FACTORS: [f32; 6] = [0.5, 0.8, 0.95, 1.05, 1.25, 2.0];
const ROUNDS: usize = 12;
/// Errors of the predicted PSNR count up to these, dB.
const PSNR_RANGE_DB: [f64; 2] = [8.0, 28.0];

/// Steps of the logistic regression, their rate, and the weight of the squares of its weights,
/// which are per standard deviation.
const STEPS: usize = 4000;
const RATE: f64 = 0.02;
const PENALTY: f64 = 3.0;
/// Log odds by which the least certain bad sample is above the limit.
const MARGIN: f64 = 1.0;

/// Constants of pixels by the predicted PSNR, with a search along one after the other from the
/// default on; those of images by logistic regression, with a constant that flags every bad sample.
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
    let means: Vec<[f32; IMAGE_CHANNELS]> = samples.iter().map(|s| s.channels.means()).collect();
    let is_bad: Vec<bool> = samples.iter().map(|s| s.errors.is_bad()).collect();
    config.image = logistic(&means, &is_bad);
    config
}

fn constants(of: &mut MeasureConfig) -> [&mut f32; 8] {
    [
        &mut of.uncovered,
        &mut of.angle,
        &mut of.few,
        &mut of.magnification,
        &mut of.space,
        &mut of.spread,
        &mut of.unknown_error,
        &mut of.error_gain,
    ]
}

/// Mean squared error of the predicted PSNR.
fn objective(samples: &[Sample], config: &MeasureConfig) -> f64 {
    let [low, high] = PSNR_RANGE_DB;
    let squares = samples.par_iter().map(|sample| {
        let predicted = f64::from(sample.channels.confidence(config).psnr_db);
        let error = predicted.clamp(low, high) - sample.errors.psnr_db.clamp(low, high);
        error * error
    });
    // In a fixed order.
    let squares: Vec<f64> = squares.collect();
    squares.iter().sum::<f64>() / samples.len() as f64
}

/// Logistic regression by gradient descent on means in standard deviations.
fn logistic(means: &[[f32; IMAGE_CHANNELS]], is_bad: &[bool]) -> ImageMeasureConfig {
    let count = means.len() as f64;
    let column = |k: usize| means.iter().map(move |of| f64::from(of[k]));
    let center: [f64; IMAGE_CHANNELS] = std::array::from_fn(|k| column(k).sum::<f64>() / count);
    let scale: [f64; IMAGE_CHANNELS] = std::array::from_fn(|k| {
        let squares = column(k).map(|v| (v - center[k]) * (v - center[k]));
        (squares.sum::<f64>() / count).sqrt() + 1e-6
    });
    let rows: Vec<[f64; IMAGE_CHANNELS]> = means
        .iter()
        .map(|of| std::array::from_fn(|k| (f64::from(of[k]) - center[k]) / scale[k]))
        .collect();
    let odds = |row: &[f64; IMAGE_CHANNELS], constant: f64, weights: &[f64; IMAGE_CHANNELS]| {
        let terms = row.iter().zip(weights).map(|(a, b)| a * b);
        constant + terms.sum::<f64>()
    };
    let (mut constant, mut weights) = (0.0, [0.0; IMAGE_CHANNELS]);
    for _ in 0..STEPS {
        let mut gradient = weights.map(|weight| PENALTY * weight);
        let mut of_constant = 0.0;
        for (row, is_bad) in rows.iter().zip(is_bad) {
            let share = 1.0 / (1.0 + libm::exp(-odds(row, constant, &weights)));
            let residual = share - f64::from(u8::from(*is_bad));
            of_constant += residual;
            gradient
                .iter_mut()
                .zip(row)
                .for_each(|(g, v)| *g += residual * v);
        }
        // Large sets of samples have large gradients.
        let rate = RATE * 200.0 / count.max(200.0);
        constant -= rate * of_constant;
        weights
            .iter_mut()
            .zip(gradient)
            .for_each(|(w, g)| *w -= rate * g);
    }
    let bad = rows.iter().zip(is_bad).filter(|(_, is_bad)| **is_bad);
    let least = bad.map(|(row, _)| odds(row, constant, &weights));
    let least = least.fold(f64::INFINITY, f64::min);
    let limit = if least.is_finite() {
        least - MARGIN
    } else {
        0.0
    };
    let plain: [f64; IMAGE_CHANNELS] = std::array::from_fn(|k| weights[k] / scale[k]);
    let moved: f64 = plain.iter().zip(center).map(|(w, c)| w * c).sum();
    let constant = constant - limit - moved;
    ImageMeasureConfig::from_weights(constant as f32, plain.map(|w| w as f32))
}

#[cfg(test)]
mod tests {
    use super::super::rules::counts;
    use super::super::rules::tests::sample;
    use super::*;

    #[test]
    fn every_bad_sample_of_the_fit_is_flagged() {
        let mut samples = Vec::new();
        for k in 0..20_u8 {
            let alpha = 0.5 + 0.025 * f32::from(k);
            let psnr_db = if k < 8 { 16.0 } else { 22.0 };
            samples.push(sample(psnr_db, 0.02, [0.1, 0.0], alpha));
        }
        let config = fit(&samples);
        let flagged: Vec<bool> = samples
            .iter()
            .map(|sample| sample.channels.confidence(&config).is_outside)
            .collect();
        let found = counts(&samples, &flagged);
        assert_eq!((found.bad_flagged, found.bad_unflagged), (8, 0));
        assert!(found.good_unflagged >= 6, "{found:?}");
        assert!(config.image.transparency > 0.0);
    }
}
