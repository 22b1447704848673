//! Input of the estimation.

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Eye, ImuNoise, ImuSample, Lens};
use nalgebra::{Matrix3, Vector3};

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

/// The lens of a camera, or two that are rigidly connected.
#[derive(Clone, Debug)]
pub struct Cameras {
    pub(super) left: Lens,
    pub(super) right: Option<Right>,
    /// Line time: from one row to the next, s.
    pub(super) line_s: f64,
}

#[derive(Clone, Debug)]
pub(super) struct Right {
    pub(super) lens: Lens,
    pub(super) rotation: Matrix3<f64>,
    pub(super) translation: Vector3<f64>,
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
