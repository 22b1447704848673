//! Support of a view by recorded ones: its PSNR, predicted from distance and angle.

use serde::{Deserialize, Serialize};

use super::Deviation;
use crate::SimulationError;

/// PSNR of a view that was not used for the reconstruction.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SupportSample {
    /// Distance to the nearest recorded camera, m.
    pub distance_m: f64,
    /// Angle to its optical axis, rad.
    pub angle_rad: f64,
    /// PSNR of the view, dB.
    pub psnr_db: f64,
}

/// Predicted PSNR as a function of the deviation from recorded views: a level from which two
/// piecewise linear losses are subtracted, one of the distance and one of the angle. Neither
/// decreases, so a view farther away is never predicted to be better. Beyond the samples a loss
/// grows in proportion to the distance or angle.
///
/// ```
/// use simulation::{Deviation, SupportMap, SupportSample};
///
/// // 30 dB at the recorded views, 4 dB less per meter, 10 dB less per radian.
/// let samples: Vec<SupportSample> = (0..100)
///     .map(|i| {
///         let (distance_m, angle_rad) = (f64::from(i % 10) * 0.3, f64::from(i / 10) * 0.05);
///         let psnr_db = 30.0 - 4.0 * distance_m - 10.0 * angle_rad;
///         SupportSample { distance_m, angle_rad, psnr_db }
///     })
///     .collect();
/// let support = SupportMap::fit(&samples)?;
/// let deviation = Deviation { distance_m: 1.0, angle_rad: 0.2, index: 0 };
/// assert!((support.support_db(&deviation) - 24.0).abs() < 0.01);
/// # Ok::<(), simulation::SimulationError>(())
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SupportMap {
    /// PSNR at recorded views, dB.
    level_db: f64,
    distance: Loss,
    angle: Loss,
}

/// Piecewise linear, non-decreasing, 0 at 0.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Loss {
    /// Beginnings of the pieces, ascending; the first is 0.
    knots: Vec<f64>,
    /// Slope of each piece, dB per m or rad, not negative.
    slopes: Vec<f64>,
    /// Greatest value of a sample.
    longest: f64,
}

/// Pieces of each loss at most. More follow the noise of a few hundred samples.
const PIECES: usize = 6;
/// Least length of a piece, m or rad. Shorter ones would follow the scatter of samples that are
/// close together.
const MIN_PIECE: f64 = 0.1;
/// Samples at least.
const MIN_SAMPLES: usize = 8;
/// Rounds of coordinate descent at most.
const MAX_ROUNDS: usize = 20_000;
/// Largest change of a prediction by the last round, dB.
const TOLERANCE_DB: f64 = 1e-7;

impl SupportMap {
    /// Fits the least sum of squared errors under the condition that no slope is negative, by
    /// coordinate descent (a convex problem with one minimum).
    ///
    /// # Errors
    /// [`SimulationError::Setting`] for fewer than 8 samples and for values that are not finite or
    /// whose distance or angle is negative.
    pub fn fit(samples: &[SupportSample]) -> Result<Self, SimulationError> {
        check(samples)?;
        let mut distance = Loss::with_knots(samples.iter().map(|sample| sample.distance_m));
        let mut angle = Loss::with_knots(samples.iter().map(|sample| sample.angle_rad));
        let columns: Vec<Vec<f64>> = (0..distance.knots.len())
            .map(|piece| basis(samples, &distance, piece, |sample| sample.distance_m))
            .chain(
                (0..angle.knots.len())
                    .map(|piece| basis(samples, &angle, piece, |sample| sample.angle_rad)),
            )
            .collect();
        let (level_db, slopes) = non_negative_slopes(samples, &columns);
        let (of_distance, of_angle) = slopes.split_at(distance.knots.len());
        distance.slopes.copy_from_slice(of_distance);
        angle.slopes.copy_from_slice(of_angle);
        Ok(Self {
            level_db,
            distance,
            angle,
        })
    }

    /// Refuses a map that was not made by [`Self::fit`], such as one from a configuration file.
    pub(crate) fn check(&self) -> Result<(), SimulationError> {
        let is_valid = |loss: &Loss| {
            let is_ascending = loss.knots.is_sorted_by(|a, b| a < b);
            let numbers = loss.slopes.iter().chain([&loss.longest]);
            loss.knots.first() == Some(&0.0)
                && is_ascending
                && loss.knots.len() == loss.slopes.len()
                && numbers
                    .chain(&loss.knots)
                    .all(|v| v.is_finite() && *v >= 0.0)
        };
        if self.level_db.is_finite() && is_valid(&self.distance) && is_valid(&self.angle) {
            return Ok(());
        }
        Err(SimulationError::Setting {
            name: "support".to_owned(),
            found: "knots and slopes of another form".to_owned(),
            expected: "ascending knots from 0 with a slope of at least 0 each".to_owned(),
        })
    }

    /// Predicted PSNR, dB.
    pub fn support_db(&self, deviation: &Deviation) -> f64 {
        self.level_db - self.distance.at(deviation.distance_m) - self.angle.at(deviation.angle_rad)
    }

    /// Mean absolute error of the prediction, dB; NaN without samples.
    pub fn mean_error_db(&self, samples: &[SupportSample]) -> f64 {
        let errors = samples.iter().map(|sample| {
            let deviation = Deviation {
                distance_m: sample.distance_m,
                angle_rad: sample.angle_rad,
                index: 0,
            };
            (self.support_db(&deviation) - sample.psnr_db).abs()
        });
        errors.sum::<f64>() / samples.len() as f64
    }
}

impl Loss {
    /// Knots with equal numbers of samples between them, but for the least length; slopes of 0.
    fn with_knots(values: impl Iterator<Item = f64>) -> Self {
        let mut sorted: Vec<f64> = values.collect();
        sorted.sort_by(f64::total_cmp);
        let longest = sorted[sorted.len() - 1];
        let mut knots = vec![0.0];
        for piece in 1..PIECES {
            let value = sorted[piece * sorted.len() / PIECES];
            // The last piece has samples beyond its knot.
            if value >= knots[knots.len() - 1] + MIN_PIECE && value + MIN_PIECE <= longest {
                knots.push(value);
            }
        }
        Self {
            slopes: vec![0.0; knots.len()],
            knots,
            longest,
        }
    }

    fn at(&self, value: f64) -> f64 {
        let within = value.min(self.longest);
        let pieces = 0..self.knots.len();
        let loss: f64 = pieces
            .map(|piece| self.slopes[piece] * self.share(piece, within))
            .sum();
        match value > within && within > 0.0 {
            true => loss * value / within,
            false => loss,
        }
    }

    /// Length of the piece up to a value.
    fn share(&self, piece: usize, value: f64) -> f64 {
        let end = self.knots.get(piece + 1).copied().unwrap_or(f64::INFINITY);
        (value.min(end) - self.knots[piece]).max(0.0)
    }
}

fn basis(
    samples: &[SupportSample],
    loss: &Loss,
    piece: usize,
    value: impl Fn(&SupportSample) -> f64,
) -> Vec<f64> {
    let share = |sample| loss.share(piece, value(sample));
    samples.iter().map(share).collect()
}

/// The level, and a slope of at least 0 for each column.
fn non_negative_slopes(samples: &[SupportSample], columns: &[Vec<f64>]) -> (f64, Vec<f64>) {
    let count = samples.len() as f64;
    let mut level = samples.iter().map(|sample| sample.psnr_db).sum::<f64>() / count;
    let mut slopes = vec![0.0_f64; columns.len()];
    let mut residuals: Vec<f64> = samples.iter().map(|s| s.psnr_db - level).collect();
    for _ in 0..MAX_ROUNDS {
        let mean = residuals.iter().sum::<f64>() / count;
        level += mean;
        residuals.iter_mut().for_each(|residual| *residual -= mean);
        let mut largest_db = mean.abs();
        for (column, slope) in columns.iter().zip(&mut slopes) {
            let norm: f64 = column.iter().map(|v| v * v).sum();
            if norm == 0.0 {
                continue;
            }
            // The prediction is the level minus the losses.
            let dot: f64 = column.iter().zip(&residuals).map(|(v, r)| v * r).sum();
            let next = (*slope - dot / norm).max(0.0);
            let change = next - *slope;
            *slope = next;
            for (residual, value) in residuals.iter_mut().zip(column) {
                *residual += change * value;
            }
            let longest = column.iter().copied().fold(0.0, f64::max);
            largest_db = f64::max(largest_db, change.abs() * longest);
        }
        if largest_db < TOLERANCE_DB {
            break;
        }
    }
    (level, slopes)
}

fn check(samples: &[SupportSample]) -> Result<(), SimulationError> {
    let setting = |found: String, expected: &str| SimulationError::Setting {
        name: "support samples".to_owned(),
        found,
        expected: expected.to_owned(),
    };
    if samples.len() < MIN_SAMPLES {
        return Err(setting(samples.len().to_string(), "at least 8"));
    }
    let is_valid = |sample: &SupportSample| {
        let is_length = |v: f64| v.is_finite() && v >= 0.0;
        is_length(sample.distance_m) && is_length(sample.angle_rad) && sample.psnr_db.is_finite()
    };
    match samples.iter().position(|sample| !is_valid(sample)) {
        None => Ok(()),
        Some(at) => Err(setting(
            format!("{:?} at index {at}", samples[at]),
            "finite numbers, distance and angle of at least 0",
        )),
    }
}
