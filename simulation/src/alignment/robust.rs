//! Fits in spite of outliers: least median of squares over triples (Rousseeuw 1984), then least
//! squares over inliers; and what is refused.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::association::{Pair, Pairs};
use super::fit::{Fit, closed_form, residual};
use super::{AlignmentConfig, AlignmentModel, mean, refuse};
use crate::error::SimulationError;
use crate::scene::Similarity;

/// Median length of a residual of standard deviation 1 in three dimensions.
const MEDIAN_OF_CHI_3: f64 = 1.538_172;
/// Most refits with changed inliers.
const MAX_REFITS: usize = 20;
/// A mirrored fit has to be better by this factor to be the right one.
const MIRROR_RATIO: f64 = 0.5;
/// Smallest standard deviation of a residual, m: inliers of exact numbers are found too.
const MIN_SIGMA_M: f64 = 1e-9;

/// Robust fits of one model.
pub(super) struct Robust<'a> {
    model: AlignmentModel,
    config: &'a AlignmentConfig,
}

impl<'a> Robust<'a> {
    pub(super) fn new(model: AlignmentModel, config: &'a AlignmentConfig) -> Self {
        Self { model, config }
    }

    /// Median residual of the best triple, m.
    pub(super) fn median(&self, pairs: &Pairs) -> Result<f64, SimulationError> {
        self.best_of_triples(pairs).map(|(median, _)| median)
    }

    /// The fit of all inliers.
    pub(super) fn fit(&self, pairs: &Pairs) -> Result<Fit, SimulationError> {
        let (median, mut transform) = self.best_of_triples(pairs)?;
        let mut sigma_m = median / MEDIAN_OF_CHI_3;
        let mut inliers: Vec<bool> = Vec::new();
        for _ in 0..MAX_REFITS {
            let limit = self.config.inlier_sigmas * sigma_m.max(MIN_SIGMA_M);
            let is_inlier = |pair: &Pair| residual(&transform, pair).norm() <= limit;
            let of_now: Vec<bool> = pairs.all.iter().map(is_inlier).collect();
            if of_now == inliers {
                break;
            }
            inliers = of_now;
            let of_inliers = pairs.all.iter().zip(&inliers);
            let of_inliers = of_inliers
                .filter(|(_, is_inlier)| **is_inlier)
                .map(|(pair, _)| pair);
            let fitted = closed_form(of_inliers, self.model);
            transform = fitted.ok_or_else(|| self.too_few(pairs.all.len()))?;
            sigma_m = median_residual(&transform, &pairs.all) / MEDIAN_OF_CHI_3;
        }
        let count = inliers.iter().filter(|is_inlier| **is_inlier).count();
        let min = self.config.min_inlier_share * pairs.all.len() as f64;
        if count < self.config.min_inliers || (count as f64) < min {
            let found = format!("{count} of {} pairs that agree", pairs.all.len());
            let (least, share) = (self.config.min_inliers, self.config.min_inlier_share);
            return Err(refuse(
                found,
                format!("at least {least} and a share of {share}"),
            ));
        }
        Ok(Fit { transform, inliers })
    }

    /// Refuses what does not determine a rotation.
    pub(super) fn check(&self, pairs: &Pairs, found: &Fit) -> Result<(), SimulationError> {
        let rms = |transform: &Similarity, inliers: &[bool]| {
            let all = pairs
                .all
                .iter()
                .zip(inliers)
                .filter(|(_, is_inlier)| **is_inlier);
            let squares = all.map(|(pair, _)| residual(transform, pair).norm_squared());
            let (sum, count) = squares.fold((0.0, 0.0), |(sum, n), square| (sum + square, n + 1.0));
            (sum / f64::max(count, 1.0)).sqrt()
        };
        let residual_m = rms(&found.transform, &found.inliers);
        let [along, across] = self.spread(pairs, found);
        let least = (self.config.min_spread_ratio * along)
            .max(self.config.min_spread_residuals * residual_m);
        if across < least {
            let found =
                format!("a straight path, {along:.3} m along and {across:.3} m across (1 sigma)");
            let expected = format!("{least:.3} m across, for the rotation about it");
            return Err(refuse(found, expected));
        }
        let mirrored = pairs.mirrored();
        let (of_mirrored, _) = self.best_of_triples(&mirrored)?;
        let of_this = median_residual(&found.transform, &pairs.all);
        if of_mirrored.max(MIN_SIGMA_M) < MIRROR_RATIO * of_this {
            let found = format!(
                "mirrored positions: a median residual of {of_this:.4} m, {of_mirrored:.4} m inverted"
            );
            return Err(refuse(found, "axes of the same handedness".to_owned()));
        }
        Ok(())
    }

    /// Refuses paths whose poses turn against those of the reference. On level ground a mirrored
    /// path is also one upside down, which positions alone do not show.
    pub(super) fn check_rotations(
        &self,
        pairs: &Pairs,
        found: &Fit,
    ) -> Result<(), SimulationError> {
        // The rotation between both bodies is constant.
        let align = found.transform.rotation();
        let bodies: Vec<UnitQuaternion<f64>> = pairs
            .rotations
            .iter()
            .zip(&found.inliers)
            .filter(|(_, is_inlier)| **is_inlier)
            .map(|([estimate, reference], _)| (align * estimate).inverse() * reference)
            .collect();
        // The one with the least median angle to all others is typical of them.
        let step = bodies.len().div_ceil(64).max(1);
        let median_angle = |of: &UnitQuaternion<f64>| {
            median(
                bodies
                    .iter()
                    .step_by(step)
                    .map(|body| of.angle_to(body))
                    .collect(),
            )
        };
        let candidates = bodies.iter().step_by(step);
        let typical = candidates.map(|of| (median_angle(of), of.angle()));
        let Some((angle, of_body)) = typical.min_by(|a, b| a.0.total_cmp(&b.0)) else {
            return Ok(());
        };
        let found = if angle > self.config.max_rotation_rad {
            format!(
                "poses that turn by {:.1} degrees (median) against it",
                angle.to_degrees()
            )
        } else if of_body > self.config.max_body_rotation_rad {
            format!(
                "a body that is rotated by {:.1} degrees",
                of_body.to_degrees()
            )
        } else {
            return Ok(());
        };
        let limits = [
            self.config.max_rotation_rad,
            self.config.max_body_rotation_rad,
        ];
        let [turn, body] = limits.map(f64::to_degrees);
        let expected = format!("at most {turn:.0} and {body:.0} degrees, of poses not mirrored");
        Err(refuse(found, expected))
    }

    pub(super) fn too_few(&self, count: usize) -> SimulationError {
        let least = self.config.min_inliers;
        refuse(
            format!("{count} pairs of positions"),
            format!("{least} different ones or more"),
        )
    }

    /// The transform of three pairs with the least median residual of all, and that, m.
    fn best_of_triples(&self, pairs: &Pairs) -> Result<(f64, Similarity), SimulationError> {
        let count = pairs.all.len();
        if count < self.config.min_inliers.max(3) {
            return Err(self.too_few(count));
        }
        let mut best: Option<(f64, Similarity)> = None;
        for attempt in 0..self.config.tries as u64 {
            // One of each third: neighbors are no better than one.
            let triple = [0, 1, 2].map(|k| {
                let first = k * count / 3;
                let size = ((k + 1) * count / 3 - first) as u64;
                let bits = counter_random::bits(self.config.seed, k as u64, attempt);
                &pairs.all[first + (bits % size) as usize]
            });
            let Some(transform) = closed_form(triple.into_iter(), self.model) else {
                continue;
            };
            let median = median_residual(&transform, &pairs.all);
            if best.is_none_or(|(of_best, _)| median < of_best) {
                best = Some((median, transform));
            }
        }
        best.ok_or_else(|| self.too_few(count))
    }

    /// Standard deviations of inliers in the reference along their first and second axis, m.
    fn spread(&self, pairs: &Pairs, found: &Fit) -> [f64; 2] {
        let inliers = || {
            let all = pairs.all.iter().zip(&found.inliers);
            all.filter(|(_, is_inlier)| **is_inlier)
                .map(|(pair, _)| pair.reference)
        };
        let center = mean(inliers());
        let products =
            |sum: Matrix3<f64>, x: Vector3<f64>| sum + (x - center) * (x - center).transpose();
        let sum = inliers().fold(Matrix3::zeros(), products);
        let mut values: Vec<f64> = sum.symmetric_eigenvalues().iter().copied().collect();
        values.sort_by(|a, b| b.total_cmp(a));
        let count = inliers().count().max(1) as f64;
        [values[0], values[1]].map(|value| (value.max(0.0) / count).sqrt())
    }
}

fn median_residual(transform: &Similarity, pairs: &[Pair]) -> f64 {
    median(
        pairs
            .iter()
            .map(|pair| residual(transform, pair).norm())
            .collect(),
    )
}

fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() {
        return f64::INFINITY;
    }
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}
