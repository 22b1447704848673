//! Rotation of a camera in one track segment, from its two eyes.
//!
//! Stereo matches give features an inverse distance. With `x` the ray of a feature at the start and
//! `r` its inverse distance, it is observed at the end along `exp(w) R x + s (r + c) t`; `R` is the
//! initial rotation, `t` the translation, `c` a common offset of the inverse distances (caused by a
//! yaw of the right eye too small to be observed in rows; without it, it would appear as a
//! rotation). For a rolling shutter `s` is the ratio of the exposure intervals of the rows, and a
//! change of speed during the segment adds a term to `t` that differs from row to row. The
//! uncertainty of the distance makes an observation less certain along its epipolar line only. The
//! translation is initialized by RANSAC over samples of two features; outliers are rejected.

use cad_transforms::so3;
use nalgebra::{
    Matrix2, Matrix2x3, Matrix3, RowSVector, SMatrix, SVector, UnitQuaternion, Vector2, Vector3,
};

use super::config::MotionConfig;
use super::pair::STEREO_PARAMETERS;
use super::robust::{median, tukey};

/// Number of parameters of a segment's motion.
pub(super) const MOTION_PARAMETERS: usize = 11;

/// A feature at both ends of a segment.
#[derive(Clone, Copy, Debug)]
pub(super) struct SegmentFeature {
    /// Left pixel at the start.
    pub(super) pixel: [f64; 2],
    /// Ray at the start, transferred to the exposure of the middle row.
    pub(super) ray: Vector3<f64>,
    /// Inverse distance, 1/m, and its standard deviation.
    pub(super) per_metre: f64,
    pub(super) sigma_per_metre: f64,
    /// Derivative of the inverse distance with respect to the unknowns of the stereo pair.
    pub(super) per_metre_by: RowSVector<f64, STEREO_PARAMETERS>,
    /// Ray at the end.
    pub(super) later: Vector3<f64>,
    /// Pixels per radian at the end.
    pub(super) px_per_rad: f64,
    /// Interval between the two exposures of the feature over that of the middle row.
    pub(super) motion_ratio: f64,
    /// Mean exposure offset of its two rows against the middle row, s.
    pub(super) after_s: f64,
    /// Derivatives of all these with respect to the line time.
    pub(super) by_line: ByLine,
}

/// Derivatives with respect to the line time.
#[derive(Clone, Copy, Debug)]
pub(super) struct ByLine {
    pub(super) ray: Vector3<f64>,
    pub(super) later: Vector3<f64>,
    pub(super) motion_ratio: f64,
    pub(super) after_s: f64,
}

/// Initial values and priors.
#[derive(Clone, Copy, Debug)]
pub(super) struct Start {
    /// `later_from_first`.
    pub(super) rotation: UnitQuaternion<f64>,
    /// Pixel error that its uncertainty may cause, px.
    pub(super) error_px: f64,
    /// Offset of inverse distances, 1/m, and its standard deviation.
    pub(super) offset: [f64; 2],
    /// Prior sigma of the line time, s.
    pub(super) line_sigma_s: f64,
    /// Distance of the two eyes, m.
    pub(super) baseline_m: f64,
}

/// Result for one segment.
#[derive(Clone, Copy, Debug)]
pub(super) struct RotationEstimate {
    /// `later_from_first`.
    pub(super) rotation: UnitQuaternion<f64>,
    /// Covariance of a small rotation applied after it, rad².
    pub(super) covariance: Matrix3<f64>,
    /// Offset of inverse distances, 1/m, and its variance.
    pub(super) offset: [f64; 2],
    /// Correction of the line time, s, and its variance.
    pub(super) line_s: [f64; 2],
}

/// Two directions normal to a ray, as rows.
fn across(ray: &Vector3<f64>) -> Matrix2x3<f64> {
    let aside = if ray.x.abs() < 0.6 {
        Vector3::x()
    } else {
        Vector3::y()
    };
    let first = ray.cross(&aside).normalize();
    Matrix2x3::from_rows(&[first.transpose(), ray.cross(&first).transpose()])
}

/// State of a segment.
#[derive(Clone, Copy, Debug)]
pub(super) struct MotionState {
    /// `later_from_first`.
    pub(super) rotation: UnitQuaternion<f64>,
    /// Translation, m.
    translation: Vector3<f64>,
    /// Common offset of the inverse distances, 1/m.
    offset: f64,
    /// Change of speed, m/s.
    speed_change: Vector3<f64>,
    /// Correction of the line time, s.
    line_s: f64,
}

/// Solution of one segment.
#[derive(Clone, Debug)]
pub(super) struct Solution {
    pub(super) estimate: RotationEstimate,
    pub(super) state: MotionState,
    /// Inverse distance of each feature, 1/m, from stereo and motion together.
    pub(super) per_metre: Vec<f64>,
    /// Scale of the residuals in standard deviations.
    pub(super) scale: f64,
    /// Inverse of the covariance of the state.
    pub(super) information: SMatrix<f64, MOTION_PARAMETERS, MOTION_PARAMETERS>,
}

/// Residual of a feature, linearized.
pub(super) struct LinearFeature {
    pub(super) error: Vector2<f64>,
    pub(super) weight: Matrix2<f64>,
    /// Jacobian of the predicted direction with respect to the state: rotation, translation,
    /// offset, change of speed, line time.
    pub(super) by_state: SMatrix<f64, 2, MOTION_PARAMETERS>,
    /// The same with respect to the inverse distance by stereo.
    pub(super) by_per_metre: Vector2<f64>,
    /// Norm of the residual in standard deviations.
    pub(super) size: f64,
}

impl MotionState {
    fn add(&mut self, step: &SVector<f64, MOTION_PARAMETERS>) {
        self.rotation = so3::exp(step.fixed_rows::<3>(0).into_owned()) * self.rotation;
        self.translation += step.fixed_rows::<3>(3);
        self.offset += step[6];
        self.speed_change += step.fixed_rows::<3>(7);
        self.line_s += step[10];
    }

    /// Residual of a feature. `near` is its inverse distance, which is refined. `None` if it is
    /// far from the prediction.
    pub(super) fn linearize(
        &self,
        s: &SegmentFeature,
        near: &mut f64,
        config: &MotionConfig,
    ) -> Option<LinearFeature> {
        let basis = across(&s.later);
        let line = self.line_s;
        let rotated = self.rotation * (s.ray + s.by_line.ray * line);
        let (motion_ratio, after_s) = (
            s.motion_ratio + s.by_line.motion_ratio * line,
            s.after_s + s.by_line.after_s * line,
        );
        let moved = self.translation * motion_ratio + self.speed_change * after_s;
        let later = s.by_line.later * line;
        let seen_at = |near: f64| {
            let point = rotated + moved * (near + self.offset);
            let length = point.norm();
            let unit = point / length;
            let by_point = basis * (Matrix3::identity() - unit * unit.transpose()) / length;
            (unit, by_point)
        };
        let (unit, by_point) = seen_at(*near);
        if unit.dot(&s.later) < 0.5 {
            return None;
        }
        let corner = config.corner_sigma_px / s.px_per_rad;
        // Both the match and the observed parallax determine the distance. Using the match
        // alone would bias translations towards zero, as regression on a noisy variable does.
        let by_near = by_point * moved;
        let [seen_weight, nominal_weight] =
            [corner, s.sigma_per_metre].map(|sigma| 1.0 / (sigma * sigma));
        let pull = by_near.dot(&(basis * (later - unit))) * seen_weight
            + (s.per_metre - *near) * nominal_weight;
        *near += pull / (by_near.norm_squared() * seen_weight + nominal_weight);
        let (unit, by_point) = seen_at(*near);
        let by_near = by_point * moved;
        let error: Vector2<f64> = basis * (later - unit) - by_near * (s.per_metre - *near);
        let along = by_near * s.sigma_per_metre;
        let variance = Matrix2::identity() * (corner * corner) + along * along.transpose();
        let weight = variance.try_inverse()?;
        let distance = *near + self.offset;
        let mut by = SMatrix::<f64, 2, MOTION_PARAMETERS>::zeros();
        by.fixed_columns_mut::<3>(0)
            .copy_from(&(-by_point * rotated.cross_matrix()));
        by.fixed_columns_mut::<3>(3)
            .copy_from(&(by_point * (motion_ratio * distance)));
        by.set_column(6, &by_near);
        by.fixed_columns_mut::<3>(7)
            .copy_from(&(by_point * (after_s * distance)));
        let moved_by_line =
            self.translation * s.by_line.motion_ratio + self.speed_change * s.by_line.after_s;
        let point_by_line = self.rotation * s.by_line.ray + moved_by_line * distance;
        by.set_column(10, &(by_point * point_by_line - basis * s.by_line.later));
        Some(LinearFeature {
            error,
            weight,
            by_state: by,
            by_per_metre: by_near,
            size: (error.transpose() * weight * error)[0].sqrt(),
        })
    }
}

/// Estimates the motion of a segment; `None` with too few inliers.
pub(super) fn solve(
    seen: &[SegmentFeature],
    start: &Start,
    config: &MotionConfig,
) -> Option<Solution> {
    if seen.len() < config.min_inliers {
        return None;
    }
    let [expected, sigma] = start.offset;
    let mut state = MotionState {
        rotation: start.rotation,
        translation: first_translation(seen, start, config),
        offset: expected,
        speed_change: Vector3::zeros(),
        line_s: 0.0,
    };
    let mut nearness: Vec<f64> = seen.iter().map(|s| s.per_metre).collect();
    let mut scale = (start.error_px / config.corner_sigma_px / 2.0).max(1.0);
    let speed_change = config.speed_change_sigma_m_s;
    let mut last = None;
    for round in 0..config.rounds {
        let mut information = SMatrix::<f64, MOTION_PARAMETERS, MOTION_PARAMETERS>::zeros();
        let mut gradient = SVector::<f64, MOTION_PARAMETERS>::zeros();
        information[(6, 6)] = 1.0 / (sigma * sigma);
        gradient[6] = (expected - state.offset) / (sigma * sigma);
        let line_weight = 1.0 / (start.line_sigma_s * start.line_sigma_s);
        information[(10, 10)] = line_weight;
        gradient[10] = -state.line_s * line_weight;
        for k in 7..10 {
            information[(k, k)] = 1.0 / (speed_change * speed_change);
            gradient[k] = -state.speed_change[k - 7] / (speed_change * speed_change);
        }
        let mut sizes = Vec::with_capacity(seen.len());
        let mut agree = 0;
        for (s, near) in seen.iter().zip(&mut nearness) {
            let Some(feature) = state.linearize(s, near, config) else {
                continue;
            };
            sizes.push(feature.size);
            let kept = tukey(feature.size / scale);
            if kept == 0.0 {
                continue;
            }
            agree += usize::from(feature.size < config.inlier_sigma * scale);
            let weighted = feature.by_state.transpose() * feature.weight * kept;
            information += weighted * feature.by_state;
            gradient += weighted * feature.error;
        }
        // A weak prior of the translation, so that a camera at rest, or one that observes
        // only far points, has a solution.
        for k in 3..6 {
            information[(k, k)] += config.translation_information;
        }
        let step = information.cholesky()?.solve(&gradient);
        if round + 1 == config.rounds {
            last = Some((information, agree));
            break;
        }
        state.add(&step);
        // The median norm of a two-dimensional standard normal vector is 1.177.
        let spread = median(&mut sizes) / 1.177;
        scale = spread.max(config.min_scale).min(scale.max(1.0));
    }
    let (information, agree) = last?;
    if agree < config.min_inliers || (agree as f64) < config.min_inlier_ratio * seen.len() as f64 {
        return None;
    }
    let covariance = information.cholesky()?.inverse() * (scale * scale);
    Some(Solution {
        estimate: RotationEstimate {
            rotation: state.rotation,
            covariance: covariance.fixed_view::<3, 3>(0, 0).into_owned(),
            offset: [state.offset, covariance[(6, 6)]],
            line_s: [state.line_s, covariance[(10, 10)]],
        },
        state,
        per_metre: nearness,
        scale,
        information,
    })
}

/// Translation with most inliers under the predicted rotation, m.
fn first_translation(
    seen: &[SegmentFeature],
    start: &Start,
    config: &MotionConfig,
) -> Vector3<f64> {
    let bases: Vec<Matrix2x3<f64>> = seen.iter().map(|s| across(&s.later)).collect();
    let rotated: Vec<Vector3<f64>> = seen.iter().map(|s| start.rotation * s.ray).collect();
    let cost = |shift: &Vector3<f64>| -> f64 {
        let of = |i: usize| {
            let s = &seen[i];
            let point = rotated[i] + shift * (s.motion_ratio * s.per_metre);
            let error = bases[i] * point / point.norm();
            let blur = (bases[i] * shift).norm() * s.sigma_per_metre;
            let allowed = start.error_px / s.px_per_rad + 2.0 * blur;
            let facing = point.dot(&s.later) > 0.0;
            if facing {
                (error.norm_squared() / (allowed * allowed)).min(1.0)
            } else {
                1.0
            }
        };
        (0..seen.len()).map(of).sum()
    };
    let mut best = (cost(&Vector3::zeros()), Vector3::zeros());
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut draw = || {
        // An LCG by Knuth; its high bits are good enough for sampling.
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % seen.len()
    };
    for _ in 0..config.ransac_samples {
        let pair = [draw(), draw()];
        if pair[0] == pair[1] {
            continue;
        }
        let (mut a, mut b) = (Matrix3::identity() * 1e-9, Vector3::zeros());
        for i in pair {
            let by = bases[i] * (seen[i].motion_ratio * seen[i].per_metre);
            a += by.transpose() * by;
            b -= by.transpose() * (bases[i] * rotated[i]);
        }
        let Some(shift) = a.cholesky().map(|c| c.solve(&b)) else {
            continue;
        };
        if shift.norm() > config.max_translation_baselines * start.baseline_m {
            continue;
        }
        let cost = cost(&shift);
        if cost < best.0 {
            best = (cost, shift);
        }
    }
    best.1
}
