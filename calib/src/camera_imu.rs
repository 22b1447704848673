//! Where the IMU sits behind the camera, and by how much their clocks differ, from a recording before a
//! board.
//!
//! Contract: [`estimate`] takes corners of a board with known lenses and the samples of the IMU, and gives
//! `imu_from_left`, the time offset, gravity, biases, and what else had to be found with them, each with a
//! sigma. It needs no start: rotation and offset come from rotation rates, gravity and lever arm from a
//! linear fit, all from any angle. What was [`Priors`] counts as one more measurement with the
//! sigma told, so that whatever the recording does not determine stays there; [`CameraImu::weak`] names these
//! directions. [`CameraImu::gates`] says what speaks against the result. A result with a failed gate must
//! not be used.
//!
//! The time offset is Kalibr's: `t_imu = t_camera + offset`, where `t_camera` is the middle of the exposure
//! and `t_imu` what the IMU's samples carry. Delay of the IMU's own filter is part of it. The time from row
//! to row of a rolling shutter must be known ([`Cameras::with_rolling_shutter`]).
//!
//! Pictures without board, gaps of the IMU and values at the end of its range break the chain; what is
//! left is used. Corners and whole pictures that do not fit count less, or not at all.
//!
//! How it is done and why: docs/decisions/0006-camera-imu.md. Same input, same bytes.

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

/// Gravity that is assumed, m/s² (the standard's; on earth it lies between 9.764 and 9.834).
pub const GRAVITY: f64 = 9.806_65;

/// A corner of the board in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Corner {
    /// On the board, m.
    pub x_in_target: [f64; 3],
    /// In the picture, pixels; integer values at pixel centres.
    pub pixel: [f64; 2],
    /// Standard deviation per axis, pixels.
    pub sigma_px: f64,
    /// Which eye saw it.
    pub eye: Eye,
}

/// All corners that a camera saw at one instant, in one eye or both.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TargetObservation {
    /// Middle of the exposure, ns of the camera's clock.
    pub time_ns: i64,
    /// Empty where no board was found.
    pub corners: Vec<Corner>,
}

/// One sample of an IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// When, ns of the IMU's clock.
    pub time_ns: i64,
    /// Angular rate, rad/s.
    pub gyro: [f64; 3],
    /// Specific force, m/s²: `R (a - g)`, so that a sensor at rest measures 9.8 upwards.
    pub accel: [f64; 3],
}

/// One lens, or two that are rigidly together.
#[derive(Clone, Debug)]
pub struct Cameras {
    left: Lens,
    right: Option<Right>,
    /// From one row to the next, s.
    line_s: f64,
}

#[derive(Clone, Debug)]
struct Right {
    lens: Lens,
    rotation: Matrix3<f64>,
    translation: Vector3<f64>,
}

impl Cameras {
    /// The left camera, and the right one with `right_from_left` if it counts.
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

    /// The same where rows are exposed one after the other, `line_s` seconds from each to the next below;
    /// the times of pictures are those of the middle row.
    #[must_use]
    pub fn with_rolling_shutter(mut self, line_s: f64) -> Self {
        self.line_s = line_s;
        self
    }
}

/// What was recorded.
#[derive(Clone, Debug)]
pub struct Recording {
    /// The lenses.
    pub cameras: Cameras,
    /// In order of time.
    pub observations: Vec<TargetObservation>,
    /// In order of time.
    pub imu: Vec<ImuSample>,
    /// White noise and walk of the biases.
    pub noise: ImuNoise,
    /// Largest values of gyroscope and accelerometer, rad/s and m/s²; infinite if not known.
    pub range: [f64; 2],
}

/// What is known without the recording, each with its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Priors {
    /// From the rig file; none if nothing is known.
    pub imu_from_left: Option<RigidTransform>,
    /// Per axis, rad.
    pub rotation_sigma_rad: f64,
    /// Per axis, m. With nothing told, how far apart IMU and camera may be.
    pub translation_sigma_m: f64,
    /// IMU time minus camera time, s.
    pub time_offset_s: f64,
    /// Its standard deviation, s. The search covers three of them to both sides.
    pub time_offset_sigma_s: f64,
    /// Rate of the two clocks against each other.
    pub time_drift_sigma: f64,
    /// Biases when switched on, rad/s and m/s².
    pub bias_sigma: [f64; 2],
    /// Scale of the sensors' axes, and each axis' share in the others' values.
    pub scale_and_skew_sigma: [f64; 2],
    /// Size of the board over what is told.
    pub board_scale_sigma: f64,
}

impl Default for Priors {
    /// Nothing but what holds for any camera with a small IMU in it.
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

/// Standard deviations of what was found.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sigmas {
    /// Turns about the axes of the left optical frame, rad.
    pub rotation_rad: [f64; 3],
    /// m.
    pub translation_m: [f64; 3],
    /// s.
    pub time_offset_s: f64,
    /// Seconds per second.
    pub time_drift: f64,
    /// Direction of gravity, two turns, rad.
    pub gravity_rad: [f64; 2],
    /// rad/s.
    pub gyro_bias: [f64; 3],
    /// m/s².
    pub accel_bias: [f64; 3],
    /// Of one.
    pub board_scale: f64,
}

/// The noise of one kind of measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
    /// Standard deviation found over that told. The result is computed with what was found.
    pub ratio_to_nominal: f64,
    /// Measurements beyond what their kind needed to be explained.
    pub redundancy: f64,
}

/// Noise of all kinds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseEstimates {
    /// Corners about the pose that fits their picture best.
    pub corners: Noise,
    /// Those poses about the motion, given the corners' noise as found. Above 1: errors that all
    /// corners of a picture share.
    pub poses: Noise,
    /// White noise of the gyroscope.
    pub gyro: Noise,
    /// White noise of the accelerometer.
    pub accel: Noise,
    /// Walk of the gyroscope's bias.
    pub gyro_walk: Noise,
    /// Walk of the accelerometer's bias.
    pub accel_walk: Noise,
}

/// How well one picture and the interval that follows it fit, in sigmas as found (root of the mean square).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Middle of the exposure, ns of the camera's clock.
    pub time_ns: i64,
    /// Corners that count, and that do not.
    pub corners: [usize; 2],
    /// Root of the mean square of the corners' errors, in sigmas told.
    pub corner: f64,
    /// The picture's pose.
    pub pose: f64,
    /// The turn to the next picture; none without inertial samples all the way.
    pub gyro: Option<f64>,
    /// Velocity and displacement to the next picture.
    pub accel: Option<f64>,
}

/// The result.
#[derive(Clone, Debug)]
pub struct CameraImu {
    /// Takes points in the left optical frame to the IMU's.
    pub imu_from_left: RigidTransform,
    /// `t_imu - t_camera` in the middle of the recording, s.
    pub time_offset_s: f64,
    /// How much it grows per second.
    pub time_drift: f64,
    /// Gravity in the target's frame, m/s², of length [`GRAVITY`].
    pub gravity_in_target: [f64; 3],
    /// In the middle of the recording, rad/s.
    pub gyro_bias: [f64; 3],
    /// In the middle of the recording, m/s².
    pub accel_bias: [f64; 3],
    /// Size of the board over what was told.
    pub board_scale: f64,
    /// `measured = shape true + bias`, rows first.
    pub gyro_shape: [[f64; 3]; 3],
    /// The same of the accelerometer.
    pub accel_shape: [[f64; 3]; 3],
    /// Standard deviations.
    pub sigmas: Sigmas,
    /// Covariance of rotation (3, turns in the left optical frame, rad), translation (3, m) and time offset (s).
    pub covariance: SMatrix<f64, 7, 7>,
    /// Directions that this recording does not determine.
    pub unobservable: Vec<UnobservableDirection>,
    /// What was checked.
    pub gates: Vec<Gate>,
    /// How much noise there is.
    pub noises: NoiseEstimates,
    /// Agreement of rotation rates, 0 to 1, by time offset, s.
    pub correlation: Vec<[f64; 2]>,
    /// Each picture that was used.
    pub residuals: Vec<Residual>,
    /// Pictures given, with a board whose pose could be found, and those that hardly count because they
    /// contradict the rest.
    pub views: [usize; 3],
}

impl CameraImu {
    /// The worst of the gates.
    pub fn verdict(&self) -> Verdict {
        self.gates
            .iter()
            .map(|gate| gate.verdict)
            .max()
            .unwrap_or(Verdict::Pass)
    }
}

/// Why there is no result.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum CameraImuError {
    /// A number is NaN or infinite, or a sigma is not above 0.
    #[error("reading {what} {index}: a number is not finite, or a sigma is not above 0")]
    NotFinite {
        /// Picture or IMU sample.
        what: &'static str,
        /// Which, from 0.
        index: usize,
    },
    /// Times do not grow.
    #[error("reading {what} {index}: its time is not after that of the one before")]
    Order {
        /// Picture or IMU sample.
        what: &'static str,
        /// Which, from 0.
        index: usize,
    },
    /// Hardly any picture shows the board: record again.
    #[error(
        "finding the board: {found} of {given} pictures give a pose, expected at least {expected}"
    )]
    TooFewViews {
        /// Pictures given.
        given: usize,
        /// Pictures with a pose.
        found: usize,
        /// Fewest.
        expected: usize,
    },
    /// Pictures and IMU were not recorded at the same time, as far as the clocks tell.
    #[error(
        "joining pictures and IMU: {found} of {given} intervals between pictures have inertial samples all the \
         way, expected at least {expected}: other clocks, or a time offset beyond {searched_s} s?"
    )]
    NoOverlap {
        /// Intervals between pictures.
        given: usize,
        /// Intervals with samples.
        found: usize,
        /// Fewest.
        expected: usize,
        /// How far was searched to both sides, s.
        searched_s: f64,
    },
    /// The gyroscope turns more, or less, than the camera.
    #[error(
        "comparing rotation rates: the gyroscope's are {ratio:.2} times those of the pictures, expected 1: \
         gyroscope in other units, or an IMU of another camera?"
    )]
    RateMismatch {
        /// Gyroscope over pictures.
        ratio: f64,
    },
    /// Gravity cannot be that: other units, another board.
    #[error(
        "finding gravity: found {found:.2} m/s², expected about 9.81: accelerometer in other units, board of \
         another size, or an IMU of another camera?"
    )]
    Gravity {
        /// As found.
        found: f64,
    },
    /// The search for the best fit did not end.
    #[error("fitting the motion: no end after {iterations} iterations")]
    NoEnd {
        /// How many were made.
        iterations: usize,
    },
}
