//! The calibration of one stereo camera with its IMU.
//!
//! Contract: a [`StereoCalibration`] returned by a reader has finite, valid intrinsics and a right
//! eye to the right of the left one. Values that the file does not contain are `None`, not a
//! default.

use std::path::PathBuf;

use cad_transforms::RigidTransform;
use serde::{Deserialize, Serialize};

use crate::camera::{CameraModel, Distortion};
use crate::imu::ImuCalibration;
use crate::plausibility::{InvalidCalibration, MAX_BASELINE_M, swapped};

/// Calibration of a stereo camera at one resolution.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StereoCalibration {
    /// The left camera, the reference of the pair.
    pub left: CameraModel,
    /// The right camera.
    pub right: CameraModel,
    /// Takes points in the left optical frame to the right one (OpenCV's R and T), metres.
    pub right_from_left: RigidTransform,
    /// The IMU, if the files contain one.
    pub imu: Option<ImuCalibration>,
    /// Source of the calibration.
    pub provenance: Provenance,
}

/// One of the two cameras.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Eye {
    /// The left camera.
    Left,
    /// The right camera.
    Right,
}

/// Files from which a calibration was read.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Name of the format; `None` for a calibration that was not read from a file.
    pub format: Option<String>,
    /// Every file that was read, in reading order. Their bytes belong into the session.
    pub files: Vec<PathBuf>,
    /// The part of the file that was used, for example the section of a resolution.
    pub part: Option<String>,
}

/// Tolerance of a rectified pair: rotation in rad and offset in m. Rectified files have exact
/// zeros; this only absorbs rounding errors.
const RECTIFIED_TOLERANCE: f64 = 1e-12;

impl StereoCalibration {
    /// The model of one eye.
    pub fn eye(&self, eye: Eye) -> &CameraModel {
        match eye {
            Eye::Left => &self.left,
            Eye::Right => &self.right,
        }
    }

    /// Distance between the two optical centres, metres.
    pub fn baseline_m(&self) -> f64 {
        self.right_from_left.distance_m()
    }

    /// Whether the images are rectified as delivered: no distortion, one camera matrix, parallel
    /// axes, and the offset along x alone. Then corresponding points share a row.
    pub fn is_rectified(&self) -> bool {
        let [_, y, z] = self.right_from_left.translation_m();
        let (left, right) = (&self.left, &self.right);
        left.distortion == Distortion::None
            && right.distortion == Distortion::None
            && (left.fx, left.fy, left.cy) == (right.fx, right.fy, right.cy)
            && self.right_from_left.angle_rad() <= RECTIFIED_TOLERANCE
            && y.abs() <= RECTIFIED_TOLERANCE
            && z.abs() <= RECTIFIED_TOLERANCE
    }

    /// The calibration itself, if its values are valid.
    ///
    /// # Errors
    /// [`InvalidCalibration::Implausible`] for impossible intrinsics, sensors that are farther
    /// apart than [`MAX_BASELINE_M`], and swapped eyes.
    pub fn validate(self) -> Result<Self, InvalidCalibration> {
        let cameras = [("left", &self.left), ("right", &self.right)];
        let lens = cameras.iter().find_map(|(name, camera)| {
            Some(format!("{name} camera: {}", camera.invalid_reason()?))
        });
        let apart = |what: &str, b_from_a: &RigidTransform| {
            let metres = b_from_a.distance_m();
            (!metres.is_finite() || metres > MAX_BASELINE_M).then(|| {
                format!(
                    "{what} {metres} m apart, expected at most {MAX_BASELINE_M}: not in metres?"
                )
            })
        };
        let placement = apart("the cameras are", &self.right_from_left)
            .or_else(|| swapped(&self.right_from_left))
            .or_else(|| apart("IMU and left camera are", &self.imu.as_ref()?.imu_from_left));
        match lens.or(placement) {
            None => Ok(self),
            Some(reason) => Err(InvalidCalibration::Implausible { reason }),
        }
    }
}
