//! Alignment of poses to a reference: rigid (Kabsch 1976) or with scale (Umeyama 1991).
//!
//! Contract: outliers up to a third are rejected, the clock offset is estimated where trajectories
//! are aligned, and the result has a residual and a covariance. What the positions do not determine
//! is refused: straight paths leave a rotation open, mirrored sets have no rotation at all.

mod association;
mod fit;
mod robust;

use estimator_config::config;
use nalgebra::{SMatrix, Vector3};
use scene_bundle::Trajectory;

use crate::error::SimulationError;
use crate::scene::Similarity;

use self::association::{Pairs, associate};
use self::robust::Robust;

config! {
    /// How poses are aligned.
    pub struct AlignmentConfig {
        /// Largest time between reference poses that are interpolated, s. More lets straight lines
        /// replace turns.
        pub max_gap_s: f64 = 0.25,
        /// Largest offset of the clocks, s. 0 trusts the clocks.
        pub max_clock_offset_s: f64 = 0.2,
        /// Step of the search for it, s: at 1.5 m/s a few centimetres.
        pub clock_step_s: f64 = 0.02,
        /// Triples that are tried for each clock offset. With a third of outliers 96 contain one
        /// without any but for 1e-14; more of them are well spread.
        pub tries: usize = 96,
        /// Seed of the triples.
        pub seed: u64 = 1,
        /// Residuals beyond this multiple of their standard deviation are outliers. A residual in
        /// three dimensions is beyond 4 by chance in 1 of 880.
        pub inlier_sigmas: f64 = 4.0,
        /// Fewest inliers.
        pub min_inliers: usize = 8,
        /// Smallest share of inliers.
        pub min_inlier_share: f64 = 0.5,
        /// Smallest standard deviation of positions across a path, as a share of that along it.
        pub min_spread_ratio: f64 = 0.02,
        /// And in multiples of the residual: less is noise.
        pub min_spread_residuals: f64 = 5.0,
        /// Largest median rotation between poses of the reference and aligned ones, after a
        /// constant rotation between both bodies, rad. Mirrored positions of right-handed poses
        /// exceed it.
        pub max_rotation_rad: f64 = 0.35,
        /// Largest constant rotation between both bodies, rad. On level ground a mirrored path is
        /// also one of a body upside down, by pi. OpenCV's axes and those of REP-103 differ by
        /// 2.1; set it to pi for bodies that really are upside down.
        pub max_body_rotation_rad: f64 = 2.8,
    }
}

/// Whether a scale is estimated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AlignmentModel {
    /// Rotation and translation, SE(3): both are metric.
    Rigid,
    /// And scale, Sim(3): structure from motion without a metric sensor.
    Similarity,
}

/// Result of an alignment.
#[derive(Clone, Debug, PartialEq)]
pub struct Alignment {
    /// Takes points of the estimate to the reference.
    pub reference_from_estimate: Similarity,
    /// Time of the reference's clock minus that of the estimate's, ns.
    pub clock_offset_ns: i64,
    /// Root mean square distance of inliers, m.
    pub residual_m: f64,
    /// 95 % of the distances of all pairs are below, m, outliers included.
    pub p95_m: f64,
    /// For each pair whether it is an inlier.
    pub inliers: Vec<bool>,
    /// Mean of the inliers in the reference, m.
    pub center_m: [f64; 3],
    /// Covariance of a small rotation about the axes of the reference through the center, rad, the
    /// translation, m, the logarithm of the scale and the clock offset, s; 0 for what was not
    /// estimated.
    pub covariance: SMatrix<f64, 8, 8>,
}

impl Alignment {
    /// Number of inliers.
    pub fn inlier_count(&self) -> usize {
        self.inliers.iter().filter(|is_inlier| **is_inlier).count()
    }
}

/// Aligns positions pair by pair.
///
/// ```
/// use simulation::{AlignmentConfig, AlignmentModel, align_points};
///
/// let estimate: Vec<[f64; 3]> = (0..20)
///     .map(|i| f64::from(i))
///     .map(|i| [i, 0.2 * i * i, (3.0 * i).rem_euclid(5.0)])
///     .collect();
/// // Half as large, and displaced.
/// let reference: Vec<[f64; 3]> =
///     estimate.iter().map(|[x, y, z]| [0.5 * x + 1.0, 0.5 * y, 0.5 * z]).collect();
/// let model = AlignmentModel::Similarity;
/// let alignment = align_points(&estimate, &reference, model, &AlignmentConfig::default())?;
/// assert!((alignment.reference_from_estimate.scale() - 0.5).abs() < 1e-9);
/// assert!(alignment.residual_m < 1e-9);
/// # Ok::<(), simulation::SimulationError>(())
/// ```
///
/// # Errors
/// [`SimulationError::Setting`] for lists of different lengths and numbers that are not finite,
/// [`SimulationError::Scene`] for too few inliers, straight and mirrored sets.
pub fn align_points(
    estimate: &[[f64; 3]],
    reference: &[[f64; 3]],
    model: AlignmentModel,
    config: &AlignmentConfig,
) -> Result<Alignment, SimulationError> {
    let finite = |points: &[[f64; 3]]| points.as_flattened().iter().all(|v| v.is_finite());
    if estimate.len() != reference.len() || !finite(estimate) || !finite(reference) {
        return Err(SimulationError::Setting {
            name: "positions to align".to_owned(),
            found: format!("{} and {}", estimate.len(), reference.len()),
            expected: "finite numbers, the same count of both".to_owned(),
        });
    }
    let pairs = Pairs::of_points(estimate, reference);
    let robust = Robust::new(model, config);
    let found = robust.fit(&pairs)?;
    robust.check(&pairs, &found)?;
    fit::result(&pairs, &found, model, false, 0.0)
}

/// Aligns a trajectory to a reference with another clock. Poses of the reference are interpolated
/// at the times of the estimate; lost poses of both are left out.
///
/// # Errors
/// [`SimulationError::Scene`] for too few poses at common times, few inliers, straight and
/// mirrored paths, clocks further apart than the search.
pub fn align_trajectories(
    estimate: &Trajectory,
    reference: &Trajectory,
    model: AlignmentModel,
    config: &AlignmentConfig,
) -> Result<Alignment, SimulationError> {
    let robust = Robust::new(model, config);
    let steps = match config.clock_step_s > 0.0 {
        true => (config.max_clock_offset_s / config.clock_step_s)
            .floor()
            .clamp(0.0, 1e4) as i32,
        false => 0,
    };
    // The best of all offsets, by the median residual.
    let mut best: Option<(f64, f64)> = None;
    let mut refused = None;
    for step in -steps..=steps {
        let offset_s = f64::from(step) * config.clock_step_s;
        let pairs = associate(estimate, reference, offset_s, config.max_gap_s);
        match robust.median(&pairs) {
            Ok(median) if best.is_none_or(|(of_best, _)| median < of_best) => {
                best = Some((median, offset_s));
            }
            Ok(_) => {}
            Err(error) => refused = Some(error),
        }
    }
    let Some((_, mut offset_s)) = best else {
        return Err(refused.unwrap_or_else(|| robust.too_few(0)));
    };
    let with_clock = steps > 0;
    let mut pairs = associate(estimate, reference, offset_s, config.max_gap_s);
    let mut found = robust.fit(&pairs)?;
    robust.check(&pairs, &found)?;
    if with_clock {
        // Gauss-Newton with the clock as one of the unknowns.
        let mut step_s = 0.0_f64;
        for _ in 0..MAX_CLOCK_ITERATIONS {
            step_s = fit::clock_step_s(&pairs, &found, model)?;
            offset_s += step_s;
            if offset_s.abs() > config.max_clock_offset_s + config.clock_step_s {
                let found = format!("clocks {offset_s} s apart");
                let expected = format!("at most {} s", config.max_clock_offset_s);
                return Err(refuse(found, expected));
            }
            pairs = associate(estimate, reference, offset_s, config.max_gap_s);
            found = robust.fit(&pairs)?;
            if step_s.abs() < MIN_CLOCK_STEP_S {
                break;
            }
        }
        if step_s.abs() > MAX_LAST_STEP_S {
            let found = format!("a clock offset that still changes by {step_s} s");
            return Err(refuse(found, format!("at most {MAX_LAST_STEP_S} s")));
        }
        // Of other pairs than before, with other inliers.
        robust.check(&pairs, &found)?;
    }
    robust.check_rotations(&pairs, &found)?;
    fit::result(&pairs, &found, model, with_clock, offset_s)
}

/// Most iterations of the clock offset, and the step below which it is known, s.
const MAX_CLOCK_ITERATIONS: usize = 20;
const MIN_CLOCK_STEP_S: f64 = 1e-7;
/// Largest last step of a clock offset that is determined, s: at 1.5 m/s 0.15 mm. Inliers that
/// change to and fro leave smaller ones.
const MAX_LAST_STEP_S: f64 = 1e-4;

fn refuse(found: String, expected: String) -> SimulationError {
    SimulationError::Scene {
        place: "aligning poses to a reference".to_owned(),
        found,
        expected,
    }
}

/// Mean of points.
fn mean(points: impl Iterator<Item = Vector3<f64>>) -> Vector3<f64> {
    let (sum, count) = points.fold((Vector3::zeros(), 0.0), |(sum, n), x| (sum + x, n + 1.0));
    sum / f64::max(count, 1.0)
}

#[cfg(test)]
mod tests;
