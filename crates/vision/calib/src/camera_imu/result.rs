//! Result of the estimation.

use cad_transforms::RigidTransform;
use nalgebra::SMatrix;

use super::config::Config;
use super::gates::{Gate, UnobservableDirection, Verdict};
use super::noise::NoiseEstimates;

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
    /// Configuration of the estimation.
    pub config: Config,
    /// Takes points in the left optical frame to the IMU's.
    pub imu_from_left: RigidTransform,
    /// `t_imu - t_camera` in the middle of the recording, s.
    pub time_offset_s: f64,
    /// Growth per second.
    pub time_drift: f64,
    /// Gravity in the target's frame, m/s², of length [`GRAVITY`](super::GRAVITY).
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
