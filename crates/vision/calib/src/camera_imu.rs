//! Camera–IMU calibration from a recording of a board: extrinsics and time offset.
//!
//! Contract: [`estimate`] takes corners of a board with known lenses and the IMU samples, and
//! returns `imu_from_left`, the time offset, gravity, biases and the nuisance parameters estimated
//! with them, each with a sigma. It needs no initial values: rotation and offset come from angular
//! rates, gravity and lever arm from a linear fit, at any angle. [`Priors`] count as measurements
//! with their sigma, so that parameters which the recording does not determine keep them;
//! [`CameraImu::unobservable`] lists these directions. [`CameraImu::gates`] lists the checks of the
//! result. A result with a failed gate must not be used.
//!
//! The time offset is that of Kalibr: `t_imu = t_camera + offset`, where `t_camera` is mid-exposure
//! and `t_imu` the timestamp of the IMU sample. The delay of the IMU's own filter is part of it.
//! The line time of a rolling shutter must be known ([`Cameras::with_rolling_shutter`]).
//!
//! Frames without a board, IMU gaps and saturated values interrupt the chain of states; the
//! remaining parts are used. Corners and whole views that do not fit are down-weighted or rejected
//! (robust loss).
//!
//! Method and reasons: docs/decisions/0006-camera-imu.md. Same input, same bytes.

use cad_transforms::RigidTransform;
use nalgebra::{Matrix3, SMatrix, Vector3};

use crate::camera::CameraModel;
use crate::lens::Lens;
use crate::stereo::{Eye, ImuNoise};

mod chain;
mod estimate;
mod gates;
mod initialization;
mod observability;
mod preintegrate;
mod problem;
pub mod simulate;
mod so3;
#[cfg(test)]
mod tests;
mod track;
mod view;

pub use estimate::estimate;
pub use estimate::reference::{FormulationResult, Formulations};
pub use gates::{Gate, UnobservableDirection, Verdict};

/// Assumed magnitude of gravity, m/s² (standard gravity; on earth between 9.764 and 9.834).
pub const GRAVITY: f64 = 9.806_65;

/// A corner of the board in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner {
    /// Position on the board, m.
    pub x_in_target: [f64; 3],
    /// Position in the image, pixels; integer values at pixel centres.
    pub pixel: [f64; 2],
    /// Standard deviation per axis, pixels.
    pub sigma_px: f64,
    /// The eye of the observation.
    pub eye: Eye,
}

/// All corners observed by a camera at one instant, in one eye or both.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TargetObservation {
    /// Mid-exposure, ns of the camera's clock.
    pub time_ns: i64,
    /// Empty if no board was detected.
    pub corners: Vec<Corner>,
}

/// One sample of an IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// Timestamp, ns of the IMU's clock.
    pub time_ns: i64,
    /// Angular rate, rad/s.
    pub gyro: [f64; 3],
    /// Specific force, m/s²: `R (a - g)`, so that a sensor at rest measures 9.8 upwards.
    pub accel: [f64; 3],
}

/// The lens of a camera, or two that are rigidly connected.
#[derive(Clone, Debug)]
pub struct Cameras {
    left: Lens,
    right: Option<Right>,
    /// Line time: from one row to the next, s.
    line_s: f64,
}

#[derive(Clone, Debug)]
struct Right {
    lens: Lens,
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
}

impl Cameras {
    /// The left camera, and the right one with `right_from_left` if it is used.
    pub fn new(left: &CameraModel, right: Option<(&CameraModel, &RigidTransform)>) -> Self {
        Self {
            left: Lens::new(left),
            right: right.map(|(model, right_from_left)| Right {
                lens: Lens::new(model),
                rotation: *right_from_left.rotation().to_rotation_matrix().matrix(),
                translation: *right_from_left.translation(),
            }),
            line_s: 0.0,
        }
    }

    /// The same with a rolling shutter: rows are exposed one after the other, `line_s` seconds from
    /// each to the next below; timestamps are those of the middle row.
    #[must_use]
    pub fn with_rolling_shutter(mut self, line_s: f64) -> Self {
        self.line_s = line_s;
        self
    }
}

/// Input of the estimation.
#[derive(Clone, Debug)]
pub struct Recording {
    /// The lenses.
    pub cameras: Cameras,
    /// Target observations, in order of time.
    pub observations: Vec<TargetObservation>,
    /// IMU samples, in order of time.
    pub imu: Vec<ImuSample>,
    /// Noise densities and bias random walks.
    pub noise: ImuNoise,
    /// Measurement range of gyroscope and accelerometer, rad/s and m/s²; infinite if unknown.
    pub range: [f64; 2],
}

/// Priors: nominal values with their standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Priors {
    /// Nominal extrinsics; `None` if unknown.
    pub imu_from_left: Option<RigidTransform>,
    /// Per axis, rad.
    pub rotation_sigma_rad: f64,
    /// Per axis, m. Without nominal extrinsics, the largest distance between IMU and camera.
    pub translation_sigma_m: f64,
    /// IMU time minus camera time, s.
    pub time_offset_s: f64,
    /// Its standard deviation, s. The search covers three of them to both sides.
    pub time_offset_sigma_s: f64,
    /// Relative drift of the two clocks.
    pub time_drift_sigma: f64,
    /// Turn-on biases, rad/s and m/s².
    pub bias_sigma: [f64; 2],
    /// Scale error of the sensor axes, and cross-axis sensitivity.
    pub scale_and_skew_sigma: [f64; 2],
    /// Size of the board over its nominal size.
    pub board_scale_sigma: f64,
}

impl Default for Priors {
    /// Priors that hold for any camera with a small IMU.
    fn default() -> Self {
        Self {
            imu_from_left: None,
            rotation_sigma_rad: 1.0,
            translation_sigma_m: 0.3,
            time_offset_s: 0.0,
            time_offset_sigma_s: 0.1,
            time_drift_sigma: 1e-4,
            bias_sigma: [0.05, 0.5],
            scale_and_skew_sigma: [5e-3, 1e-3],
            board_scale_sigma: 2e-3,
        }
    }
}

/// Standard deviations of the estimates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sigmas {
    /// Rotations about the axes of the left optical frame, rad.
    pub rotation_rad: [f64; 3],
    /// m.
    pub translation_m: [f64; 3],
    /// s.
    pub time_offset_s: f64,
    /// Seconds per second.
    pub time_drift: f64,
    /// Direction of gravity, two rotations, rad.
    pub gravity_rad: [f64; 2],
    /// rad/s.
    pub gyro_bias: [f64; 3],
    /// m/s².
    pub accel_bias: [f64; 3],
    /// Relative to the nominal size.
    pub board_scale: f64,
}

/// Noise estimate of one kind of measurement (variance component).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Estimated over nominal standard deviation. The result is computed with the estimate.
    pub ratio_to_nominal: f64,
    /// Redundancy: number of measurements minus the degrees of freedom they determine.
    pub redundancy: f64,
}

/// Noise estimates of all kinds of measurements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseEstimates {
    /// Corners about the pose that fits their view best.
    pub corners: Noise,
    /// Those poses about the motion, given the estimated corner noise. Above 1: errors common to
    /// all corners of a view.
    pub poses: Noise,
    /// White noise of the gyroscope.
    pub gyro: Noise,
    /// White noise of the accelerometer.
    pub accel: Noise,
    /// Bias random walk of the gyroscope.
    pub gyro_walk: Noise,
    /// Bias random walk of the accelerometer.
    pub accel_walk: Noise,
}

/// Residuals of one view and of the interval that follows it, in estimated sigmas (RMS).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Mid-exposure, ns of the camera's clock.
    pub time_ns: i64,
    /// Inlier and outlier corners.
    pub corners: [usize; 2],
    /// RMS residual of the corners, in nominal sigmas.
    pub corner: f64,
    /// Pose of the view.
    pub pose: f64,
    /// Rotation to the next view; `None` if IMU samples are missing in between.
    pub gyro: Option<f64>,
    /// Velocity and displacement to the next view.
    pub accel: Option<f64>,
}

/// Result of the calibration.
#[derive(Clone, Debug)]
pub struct CameraImu {
    /// Takes points in the left optical frame to the IMU's.
    pub imu_from_left: RigidTransform,
    /// `t_imu - t_camera` in the middle of the recording, s.
    pub time_offset_s: f64,
    /// Growth per second.
    pub time_drift: f64,
    /// Gravity in the target's frame, m/s², of length [`GRAVITY`].
    pub gravity_in_target: [f64; 3],
    /// In the middle of the recording, rad/s.
    pub gyro_bias: [f64; 3],
    /// In the middle of the recording, m/s².
    pub accel_bias: [f64; 3],
    /// Size of the board over its nominal size.
    pub board_scale: f64,
    /// `measured = shape true + bias`, row-major.
    pub gyro_shape: [[f64; 3]; 3],
    /// The same for the accelerometer.
    pub accel_shape: [[f64; 3]; 3],
    /// Standard deviations.
    pub sigmas: Sigmas,
    /// Covariance of rotation (3, in the left optical frame, rad), translation (3, m) and time
    /// offset (s).
    pub covariance: SMatrix<f64, 7, 7>,
    /// Directions that this recording does not determine.
    pub unobservable: Vec<UnobservableDirection>,
    /// Checks of the result.
    pub gates: Vec<Gate>,
    /// Estimated noise levels.
    pub noises: NoiseEstimates,
    /// Correlation of the angular rates, 0 to 1, by time offset, s.
    pub correlation: Vec<[f64; 2]>,
    /// Residuals of each view used.
    pub residuals: Vec<Residual>,
    /// Number of frames given, of views with a pose, and of views down-weighted because they
    /// contradict the rest.
    pub views: [usize; 3],
}

impl CameraImu {
    /// Verdict of the worst gate.
    pub fn verdict(&self) -> Verdict {
        self.gates
            .iter()
            .map(|gate| gate.verdict)
            .max()
            .unwrap_or(Verdict::Pass)
    }
}

/// Reasons for a missing result.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CameraImuError {
    /// A number is NaN or infinite, or a sigma is not above 0.
    #[error("reading {what} {index}: a number is not finite, or a sigma is not above 0")]
    NotFinite {
        /// View or IMU sample.
        what: &'static str,
        /// Index, from 0.
        index: usize,
    },
    /// Timestamps do not increase.
    #[error("reading {what} {index}: its time is not after that of the one before")]
    Order {
        /// View or IMU sample.
        what: &'static str,
        /// Index, from 0.
        index: usize,
    },
    /// Too few frames show the board: record again.
    #[error(
        "finding the board: {found} of {given} frames give a pose, expected at least {expected}"
    )]
    TooFewViews {
        /// Frames given.
        given: usize,
        /// Views with a pose.
        found: usize,
        /// Number required.
        expected: usize,
    },
    /// Camera and IMU do not overlap in time, according to their clocks.
    #[error(
        "connecting views and IMU: {found} of {given} intervals between views have complete IMU samples, \
         expected at least {expected}: different clocks, or a time offset beyond {searched_s} s?"
    )]
    NoOverlap {
        /// Intervals between views.
        given: usize,
        /// Intervals with IMU samples.
        found: usize,
        /// Number required.
        expected: usize,
        /// Search range of the time offset, s, to both sides.
        searched_s: f64,
    },
    /// The gyroscope rotates more, or less, than the camera.
    #[error(
        "comparing angular rates: the gyroscope's are {ratio:.2} times those of the camera, expected 1: \
         gyroscope in other units, or an IMU of another camera?"
    )]
    RateMismatch {
        /// Gyroscope over camera.
        ratio: f64,
    },
    /// Gravity is implausible: other units, another board.
    #[error(
        "finding gravity: found {found:.2} m/s², expected about 9.81: accelerometer in other units, board of \
         another size, or an IMU of another camera?"
    )]
    Gravity {
        /// Estimate.
        found: f64,
    },
    /// The optimization did not converge.
    #[error("fitting the motion: no end after {iterations} iterations")]
    NoEnd {
        /// Number of iterations.
        iterations: usize,
    },
}
