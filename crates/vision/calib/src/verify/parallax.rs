//! Distances by the motion of the left eye, which show the yaw of the right one.
//!
//! A yaw of the right eye adds the same disparity to all points, "at infinity" too: distances by
//! stereo are then wrong in a way that no motion of the camera explains. For each track segment the
//! motion of the left eye is estimated from its features and their distances by stereo; a change
//! of the stereo calibration changes these distances, and the motion with them. The motion is
//! eliminated (Schur complement), and what remains of each feature's residual depends on the
//! calibration alone. The scale of the motion is not needed.
//!
//! Contract: a segment whose features move by little between its ends, apart from rotation, or
//! whose motion cannot be estimated, has no observations. Features that move themselves are
//! rejected.

use cad_transforms::so3;
use nalgebra::{Matrix2, SMatrix, UnitQuaternion, Vector2, Vector3};

use super::camera::Camera;
use super::config::{CameraImuConfig, Config, MotionConfig, ParallaxConfig, ReadoutConfig};
use super::gyro::IntegratedGyro;
use super::motion::{
    LinearFeature, MOTION_PARAMETERS, RotationEstimate, SegmentFeature, Solution, Start, solve,
};
use super::pair::{STEREO_PARAMETERS, StereoPair};
use super::robust::{combine, median, tukey};
use super::segment::{Attitude, ConstantRate, GyroAttitude, segment_features};
use super::tracks::TrackSegment;

/// Residual of a feature with its motion eliminated.
pub(super) struct ParallaxResidual {
    /// Burst.
    pub(super) group: usize,
    /// Left pixel.
    pub(super) pixel: [f64; 2],
    pub(super) error: Vector2<f64>,
    /// Jacobian of the prediction with respect to the unknowns of the stereo pair.
    pub(super) by: SMatrix<f64, 2, STEREO_PARAMETERS>,
    pub(super) weight: Matrix2<f64>,
}

/// Estimates the motion of all segments of a camera, again for each change of the calibration.
pub(super) struct Parallax<'a> {
    camera: &'a Camera<'a>,
    config: &'a ParallaxConfig,
    motion: &'a MotionConfig,
    gyro: Option<(UnitQuaternion<f64>, IntegratedGyro<'a>)>,
    readout: &'a ReadoutConfig,
    line_s: f64,
    line_sigma_s: f64,
    /// Rotation of each segment by the previous estimation.
    rotations: Vec<Vec<Option<UnitQuaternion<f64>>>>,
}

impl<'a> Parallax<'a> {
    pub(super) fn new(camera: &'a Camera<'a>, config: &'a Config) -> Self {
        let CameraImuConfig { max_gap_s, .. } = config.camera_imu;
        let imu = camera.nominal.imu.as_ref().zip(camera.gyro);
        let gyro = imu.map(|(imu, gyro)| {
            let gyro = gyro.integrate(Vector3::repeat(1.0), Vector3::zeros(), max_gap_s);
            (*imu.imu_from_left.rotation(), gyro)
        });
        let rows = f64::from(camera.nominal.left.height);
        let segments = camera.bursts.iter().map(|b| vec![None; b.segments.len()]);
        Self {
            camera,
            config: &config.parallax,
            motion: &config.motion,
            gyro,
            readout: &config.camera_imu.readout,
            line_s: camera.line_s.unwrap_or(0.0),
            // A nominal line time gets a tiny sigma, so that nothing is divided by zero.
            line_sigma_s: match camera.line_s {
                Some(_) => 1e-9,
                None => config.camera_imu.readout.sigma_s / rows,
            },
            rotations: segments.collect(),
        }
    }

    /// Common offset of all inverse distances that explains the motion best, 1/m, about 0 with this
    /// prior sigma; a start for [`Parallax::residuals`]. A line time that is not nominal is
    /// estimated with it.
    pub(super) fn offset(&mut self, pair: &StereoPair, sigma: f64) -> f64 {
        let solutions = self.solve(pair, sigma);
        let all = |of: fn(&RotationEstimate) -> [f64; 2]| -> Vec<[f64; 2]> {
            solutions.iter().map(|(_, _, s)| of(&s.estimate)).collect()
        };
        if self.camera.line_s.is_none() {
            let before = [0.0, self.line_sigma_s];
            let [correction, sigma] = combine(&all(|e| e.line_s), before);
            let line_s = self.line_s + correction;
            let is_seen = line_s.abs() > self.readout.min_significance_sigma * sigma;
            self.line_s = if is_seen { line_s } else { 0.0 };
            let rows = f64::from(self.camera.nominal.left.height);
            self.line_sigma_s = sigma.max(self.readout.estimated_sigma_s / rows);
        }
        combine(&all(|e| e.offset), [0.0, sigma])[0]
    }

    /// Residuals of all segments, and the number of segments.
    pub(super) fn residuals(&mut self, pair: &StereoPair) -> (Vec<ParallaxResidual>, usize) {
        let solutions = self.solve(pair, 1e-9);
        let mut residuals = Vec::new();
        let mut segments = 0;
        for (group, features, solution) in &solutions {
            let found = eliminate(*group, features, solution, self.motion, self.config);
            segments += usize::from(!found.is_empty());
            residuals.extend(found);
        }
        (residuals, segments)
    }

    /// Motions of all segments. `offset_sigma` is the prior sigma of the common offset, 1/m.
    fn solve(
        &mut self,
        pair: &StereoPair,
        offset_sigma: f64,
    ) -> Vec<(usize, Vec<SegmentFeature>, Solution)> {
        let mut solutions = Vec::new();
        for (group, burst) in self.camera.bursts.iter().enumerate() {
            for (k, segment) in burst.segments.iter().enumerate() {
                let before = self.rotations[group][k];
                let Some((features, start)) = self.start(segment, pair, before, offset_sigma)
                else {
                    continue;
                };
                if let Some(solution) = solve(&features, &start, self.motion) {
                    self.rotations[group][k] = Some(solution.state.rotation);
                    solutions.push((group, features, solution));
                }
            }
        }
        solutions
    }

    fn start(
        &self,
        segment: &TrackSegment,
        pair: &StereoPair,
        before: Option<UnitQuaternion<f64>>,
        offset_sigma: f64,
    ) -> Option<(Vec<SegmentFeature>, Start)> {
        let [from_ns, to_ns] = [segment.from_ns, segment.to_ns].map(|t| t as f64);
        let by_gyro = self
            .gyro
            .as_ref()
            .map(|(imu_from_left, gyro)| GyroAttitude {
                imu_from_left: *imu_from_left,
                late_ns: 0.0,
                gyro,
            });
        let seconds = (to_ns - from_ns) * 1e-9;
        let constant =
            ConstantRate(before.map_or_else(Vector3::zeros, |r| -so3::log(&r) / seconds));
        let attitude: &dyn Attitude = match &by_gyro {
            Some(gyro) if gyro.to_from(to_ns, from_ns).is_some() => gyro,
            _ => &constant,
        };
        let is_predicted = before.is_some() || self.gyro.is_some();
        let start = Start {
            rotation: match before {
                Some(rotation) => rotation,
                None => attitude.to_from(to_ns, from_ns)?,
            },
            error_px: match is_predicted {
                true => self.config.initial_error_px[0],
                false => self.config.initial_error_px[1],
            },
            offset: [0.0, offset_sigma],
            line_sigma_s: self.line_sigma_s,
            baseline_m: pair.baseline_m(),
        };
        let features = segment_features(segment, pair, self.line_s, attitude, self.motion);
        Some((features, start))
    }
}

/// Eliminates the motion from the residuals of a segment; empty where there is little parallax.
fn eliminate(
    group: usize,
    features: &[SegmentFeature],
    solution: &Solution,
    motion: &MotionConfig,
    config: &ParallaxConfig,
) -> Vec<ParallaxResidual> {
    let mut kept: Vec<(&SegmentFeature, LinearFeature, Matrix2<f64>)> = Vec::new();
    for (feature, per_metre) in features.iter().zip(&solution.per_metre) {
        let mut near = *per_metre;
        let Some(linear) = solution.state.linearize(feature, &mut near, motion) else {
            continue;
        };
        let weight = tukey(linear.size / solution.scale) / solution.scale.powi(2);
        if weight > 0.0 {
            let weight = linear.weight * weight;
            kept.push((feature, linear, weight));
        }
    }
    let parallax = |(feature, linear, _): &(&SegmentFeature, LinearFeature, Matrix2<f64>)| {
        linear.by_per_metre.norm() * feature.per_metre.abs() * feature.px_per_rad
    };
    if median(&mut kept.iter().map(parallax).collect::<Vec<_>>()) < config.min_parallax_px {
        return Vec::new();
    }
    let by_pair = |feature: &SegmentFeature, linear: &LinearFeature| {
        linear.by_per_metre * feature.per_metre_by
    };
    let mut mixed = SMatrix::<f64, MOTION_PARAMETERS, STEREO_PARAMETERS>::zeros();
    for (feature, linear, weight) in &kept {
        mixed += linear.by_state.transpose() * weight * by_pair(feature, linear);
    }
    let information = solution.information / solution.scale.powi(2);
    let Some(information) = information.cholesky() else {
        return Vec::new();
    };
    let state_by_pair = information.solve(&mixed);
    let residual = |(feature, linear, weight): &(&SegmentFeature, LinearFeature, Matrix2<f64>)| {
        ParallaxResidual {
            group,
            pixel: feature.pixel,
            error: linear.error,
            by: by_pair(feature, linear) - linear.by_state * state_by_pair,
            weight: *weight,
        }
    };
    kept.iter().map(residual).collect()
}
