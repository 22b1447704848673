//! Camera against its own gyroscope: rotation between the two, and time offset of the images.
//!
//! With `imu_from_left = nominal exp(w)`, the rotation of a track segment is `imu_from_left⁻¹ G
//! imu_from_left`, where `G` is the gyroscope's rotation between the image times minus
//! `time_offset`. Estimated are `w` (in the left optical frame), the time offset, the bias and a
//! scale of each axis. Rotation about a single axis leaves `w` about that axis open; a constant
//! rate leaves the time offset open; both appear as large variances.

use cad_transforms::so3;
use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};

use serde::Serialize;

use super::camera;
use super::config::{CameraImuConfig, Config, MotionConfig};
use super::gyro::{Gyro, IntegratedGyro};
use super::motion::{RotationEstimate, Start, solve};
use super::pair::StereoPair;
use super::robust::{ClusterSums, combine, median, sigmas_of, tukey};
use super::segment::{Attitude, GyroAttitude, segment_features};
use super::stereo::StereoAlignment;
use super::tracks::Burst;

/// Result; see the module.
#[derive(Clone, Debug, Serialize)]
pub struct CameraImu {
    /// `w`, rad.
    pub rotation_rad: [f64; 3],
    /// Standard deviation about each axis, rad.
    pub sigma_rad: [f64; 3],
    /// Its covariance, rad².
    #[serde(skip)]
    pub(super) covariance: Matrix3<f64>,
    /// Time offset, s: positive if images are stamped later than the gyroscope's samples.
    pub time_offset_s: f64,
    /// Its standard deviation, s.
    pub time_offset_sigma_s: f64,
    /// Gyroscope bias, rad/s.
    pub bias_rad_s: [f64; 3],
    /// Line time: from the exposure of a row to that of the next, nominal or estimated, s.
    pub line_s: f64,
    /// Number of segments used.
    pub segments: usize,
    /// Number of segments available.
    pub of: usize,
    /// Rotations of segments as rates about the axes of the left optical frame, for a plot: middle
    /// of the segment (s since the first one), rate by the images, rate by the gyroscope with
    /// nominal extrinsics (estimated bias), rad/s.
    #[serde(skip)]
    pub rates: Vec<(f64, [f64; 3], [f64; 3])>,
    /// Additional yaw of the right eye implied by the distances, beyond that of
    /// [`super::StereoAlignment`], rad, and its standard deviation.
    pub yaw_rad: [f64; 2],
}

/// Estimated parameters.
#[derive(Clone, Copy)]
struct State {
    /// `imu_from_left`.
    imu_from_left: UnitQuaternion<f64>,
    bias: Vector3<f64>,
    time_offset_s: f64,
    scale: Vector3<f64>,
}

/// A segment with its rotation.
struct SegmentRotation {
    group: usize,
    times_ns: [f64; 2],
    rotation: RotationEstimate,
}

struct Camera<'a> {
    config: &'a CameraImuConfig,
    motion: &'a MotionConfig,
    pair: StereoPair,
    line_s: f64,
    nominal: UnitQuaternion<f64>,
    gyro: &'a Gyro,
    bursts: &'a [Burst],
}

/// Runs the estimation; `None` without enough data. `gyro` is that of the camera.
pub(super) fn estimate(
    of: &camera::Camera<'_>,
    eyes: &StereoAlignment,
    gyro: &Gyro,
    config: &Config,
) -> Option<CameraImu> {
    let (nominal, line_s, bursts) = (of.nominal, of.line_s, of.bursts);
    let motion = &config.motion;
    let config = &config.camera_imu;
    let mut camera = Camera {
        config,
        motion,
        pair: eyes.pair.clone(),
        line_s: line_s.unwrap_or(0.0),
        nominal: *nominal.imu.as_ref()?.imu_from_left.rotation(),
        gyro,
        bursts,
    };
    let mut state = State {
        imu_from_left: camera.nominal,
        bias: Vector3::zeros(),
        time_offset_s: 0.0,
        scale: Vector3::repeat(1.0),
    };
    let baseline = nominal.right_from_left.distance_m();
    let mut offset = [0.0, config.yaw_sigma_rad / baseline];
    let rows = f64::from(nominal.left.height);
    // A nominal line time gets a tiny sigma, so that nothing is divided by zero.
    let mut line_sigma_s = if line_s.is_some() {
        1e-9
    } else {
        config.readout.sigma_s / rows
    };
    let mut unknown_s = 0.0;
    let mut last = None;
    for (round, error_px) in config.initial_error_px.into_iter().enumerate() {
        let rotations = camera.rotations(&state, error_px, offset, line_sigma_s);
        if rotations.len() < config.min_segments {
            return None;
        }
        if round < 2 {
            let offsets: Vec<[f64; 2]> = rotations.iter().map(|k| k.rotation.offset).collect();
            offset = combine(&offsets, [0.0, config.yaw_sigma_rad / baseline]);
            if line_s.is_none() {
                let so_far = camera.line_s;
                let lines: Vec<[f64; 2]> = (rotations.iter().map(|k| k.rotation.line_s))
                    .map(|[line_s, variance]| [so_far + line_s, variance])
                    .collect();
                let [line_s, sigma] = combine(&lines, [so_far, line_sigma_s]);
                let is_seen = line_s.abs() > config.readout.min_significance_sigma * sigma;
                camera.line_s = if is_seen { line_s } else { 0.0 };
                let left = if is_seen { 0.0 } else { line_s };
                unknown_s = rows * (sigma * sigma + left * left).sqrt();
                line_sigma_s = config.readout.estimated_sigma_s / rows;
            }
            if round == 0 {
                continue;
            }
        }
        let found = camera.align(&mut state, &rotations)?;
        last = Some((rotations, found));
    }
    let (rotations, (covariance, segments)) = last?;
    let rotation = so3::log(&(camera.nominal.inverse() * state.imu_from_left));
    let (late, turn) = (
        config.readout.time_error_ratio * unknown_s,
        config.readout.rotation_error_rad_per_s * unknown_s,
    );
    let of_turn =
        covariance.fixed_view::<3, 3>(0, 0).into_owned() + Matrix3::identity() * (turn * turn);
    let nominal_state = State {
        imu_from_left: camera.nominal,
        time_offset_s: 0.0,
        ..state
    };
    Some(CameraImu {
        rotation_rad: rotation.into(),
        sigma_rad: sigmas_of(&of_turn),
        covariance: of_turn,
        time_offset_s: state.time_offset_s,
        time_offset_sigma_s: (covariance[(6, 6)] + late * late).sqrt(),
        bias_rad_s: state.bias.into(),
        line_s: camera.line_s,
        segments,
        of: bursts.iter().map(|b| b.segments.len()).sum(),
        rates: camera.rates(&nominal_state, &rotations),
        yaw_rad: offset.map(|o| o * baseline),
    })
}

impl Camera<'_> {
    fn integrated(&self, state: &State) -> IntegratedGyro<'_> {
        self.gyro
            .integrate(state.scale, state.bias, self.config.max_gap_s)
    }

    /// Rotations of all segments with enough features.
    fn rotations(
        &self,
        state: &State,
        error_px: f64,
        offset: [f64; 2],
        line_sigma_s: f64,
    ) -> Vec<SegmentRotation> {
        let gyro = self.integrated(state);
        let mut rotations = Vec::new();
        for (group, burst) in self.bursts.iter().enumerate() {
            for of in &burst.segments {
                let times_ns = [of.from_ns, of.to_ns].map(|t| t as f64);
                let Some(turn) = predicted(state, &gyro, times_ns) else {
                    continue;
                };
                let attitude = state.attitude(&gyro);
                let seen = segment_features(of, &self.pair, self.line_s, &attitude, self.motion);
                let start = Start {
                    rotation: turn,
                    error_px,
                    offset,
                    line_sigma_s,
                    baseline_m: self.pair.baseline_m(),
                };
                rotations.extend(solve(&seen, &start, self.motion).map(|solution| {
                    SegmentRotation {
                        group,
                        times_ns,
                        rotation: solution.estimate,
                    }
                }));
            }
        }
        rotations
    }

    /// Aligns the state with the measured rotations. Returns the covariance and the number of
    /// segments used.
    fn align(
        &self,
        state: &mut State,
        rotations: &[SegmentRotation],
    ) -> Option<(SMatrix<f64, 10, 10>, usize)> {
        let config = self.config;
        let (w, bias) = (config.rotation_sigma_rad, config.bias_sigma_rad_s);
        let (late, scale) = (config.offset_sigma_s, config.scale_sigma);
        let sigmas =
            SVector::<f64, 10>::from([w, w, w, bias, bias, bias, late, scale, scale, scale]);
        // Noise varies from sample to sample like a changing rate, and would appear to determine
        // the time offset at rest.
        let noise = 2.0 * self.gyro.noise().powi(2);
        let mut is_offset_observable = true;
        let mut last = None;
        for _ in 0..config.rounds {
            let mut towards = SVector::<f64, 10>::zeros();
            let w = so3::log(&(self.nominal.inverse() * state.imu_from_left));
            towards.fixed_rows_mut::<3>(0).copy_from(&-w);
            towards.fixed_rows_mut::<3>(3).copy_from(&-state.bias);
            towards[6] = -state.time_offset_s;
            let off = Vector3::repeat(1.0) - state.scale;
            towards.fixed_rows_mut::<3>(7).copy_from(&off);
            let mut sum = ClusterSums::<10>::new(&[self.bursts.len()], &sigmas, &towards);
            let gyro = self.integrated(state);
            let compared = |segment: &SegmentRotation| {
                let (error, by) = residual(state, &gyro, segment)?;
                let least = config.rotation_sigma_floor_rad;
                let floor = Matrix3::identity() * (least * least);
                let weight = (segment.rotation.covariance + floor).try_inverse()?;
                let size = (error.transpose() * weight * error)[0].sqrt();
                Some((segment.group, error, by, weight, size))
            };
            let compared: Vec<_> = rotations.iter().filter_map(compared).collect();
            let mut sizes: Vec<f64> = compared.iter().map(|c| c.4).collect();
            // The median norm of a three-dimensional standard normal vector is 1.538.
            let scale = (median(&mut sizes) / 1.538).max(config.min_scale);
            let mut used = 0;
            let (mut changes, mut by_noise) = (0.0, 0.0);
            for (group, error, by, weight, size) in compared {
                let kept = tukey(size / scale);
                if kept > 0.0 {
                    used += 1;
                    let weight = weight * kept / (scale * scale);
                    changes += (by.column(6).transpose() * weight * by.column(6))[0];
                    by_noise += noise * weight.trace();
                    sum.add(&[group], &error, &by, &weight);
                }
            }
            if used < config.min_segments || used * 2 < rotations.len() {
                return None;
            }
            let step = sum.step()?;
            let turn = so3::exp(step.fixed_rows::<3>(0).into_owned());
            state.imu_from_left *= turn;
            state.bias += step.fixed_rows::<3>(3);
            is_offset_observable = changes * config.max_noise_ratio > by_noise;
            state.time_offset_s = if is_offset_observable {
                state.time_offset_s + step[6]
            } else {
                0.0
            };
            state.scale += step.fixed_rows::<3>(7);
            last = Some((sum, used));
        }
        let (sum, used) = last?;
        let (covariance, larger) = sum.covariance(&[0, 1, 2, 6])?;
        let mut covariance = covariance * larger;
        if !is_offset_observable {
            covariance[(6, 6)] = config.offset_sigma_s * config.offset_sigma_s;
        }
        Some((covariance, used))
    }

    fn rates(
        &self,
        nominal_state: &State,
        rotations: &[SegmentRotation],
    ) -> Vec<(f64, [f64; 3], [f64; 3])> {
        let gyro = self.integrated(nominal_state);
        let first = rotations.first().map_or(0.0, |k| k.times_ns[0]);
        let rate = |segment: &SegmentRotation| {
            let [from, to] = segment.times_ns;
            let seconds = (to - from) * 1e-9;
            let expected = predicted(nominal_state, &gyro, segment.times_ns)?;
            let rate = |turn: &UnitQuaternion<f64>| (-so3::log(turn) / seconds).into();
            let middle = (0.5 * (from + to) - first) * 1e-9;
            Some((middle, rate(&segment.rotation.rotation), rate(&expected)))
        };
        rotations.iter().filter_map(rate).collect()
    }
}

/// `later_from_first` of the left optical frame between two image times, predicted by the
/// gyroscope.
fn predicted(
    state: &State,
    gyro: &IntegratedGyro<'_>,
    [from_ns, to_ns]: [f64; 2],
) -> Option<UnitQuaternion<f64>> {
    state.attitude(gyro).to_from(to_ns, from_ns)
}

impl State {
    fn attitude<'a>(&self, gyro: &'a IntegratedGyro<'a>) -> GyroAttitude<'a> {
        GyroAttitude {
            imu_from_left: self.imu_from_left,
            late_ns: self.time_offset_s * 1e9,
            gyro,
        }
    }
}

/// Residual of a segment's rotation, and the Jacobian of the predicted rotation.
fn residual(
    state: &State,
    gyro: &IntegratedGyro<'_>,
    segment: &SegmentRotation,
) -> Option<(Vector3<f64>, SMatrix<f64, 3, 10>)> {
    let [from, to] = segment.times_ns.map(|t| t - state.time_offset_s * 1e9);
    let turn = gyro.to_from(to, from)?;
    let left_from_imu = state.imu_from_left.inverse();
    let expected = left_from_imu * turn * state.imu_from_left;
    let error = so3::log(&(segment.rotation.rotation * expected.inverse()));
    let left_from_imu = left_from_imu.to_rotation_matrix();
    let left_from_imu = left_from_imu.matrix();
    let half = so3::exp(so3::log(&turn) * 0.5);
    let half = half.to_rotation_matrix();
    let seconds = (to - from) * 1e-9;
    let mut by = SMatrix::<f64, 3, 10>::zeros();
    let by_w = expected.to_rotation_matrix().into_inner() - Matrix3::identity();
    by.fixed_columns_mut::<3>(0).copy_from(&by_w);
    let by_angle = -left_from_imu * half.matrix();
    by.fixed_columns_mut::<3>(3)
        .copy_from(&(by_angle * -seconds));
    let by_late = left_from_imu * (gyro.rate(to)? - turn * gyro.rate(from)?);
    by.set_column(6, &by_late);
    let sum = gyro.sum(from, to)?;
    by.fixed_columns_mut::<3>(7)
        .copy_from(&(by_angle * Matrix3::from_diagonal(&sum)));
    Some((error, by))
}
