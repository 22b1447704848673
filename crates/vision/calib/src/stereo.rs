//! The calibration of one stereo camera with its IMU.
//!
//! Contract: a [`StereoCalibration`] returned by a reader has finite, valid intrinsics and a right
//! eye to the right of the left one. Values that the file does not contain are `None`, not a
//! default.

use std::path::{Path, PathBuf};

use cad_transforms::RigidTransform;
use serde::{Deserialize, Serialize};

use crate::camera::{CameraModel, Distortion};
use crate::convert::LensModel;
use crate::error::CalibError;

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

/// Extrinsics and noise of an IMU.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImuCalibration {
    /// Takes points in the left optical frame to the IMU's frame, metres.
    pub imu_from_left: RigidTransform,
    /// Nominal rate, Hz.
    pub rate_hz: f64,
    /// Noise model, if the file contains one.
    pub noise: Option<ImuNoise>,
}

/// Continuous-time IMU noise model, as EuRoC and Kalibr write it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ImuNoise {
    /// Gyroscope white noise, rad/s/√Hz.
    pub gyro_noise_density: f64,
    /// Gyroscope bias random walk, rad/s²/√Hz.
    pub gyro_random_walk: f64,
    /// Accelerometer white noise, m/s²/√Hz.
    pub accel_noise_density: f64,
    /// Accelerometer bias random walk, m/s³/√Hz.
    pub accel_random_walk: f64,
}

/// Files from which a calibration was read.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// Format; `None` for a calibration that was not read from a file.
    pub format: Option<Format>,
    /// Every file that was read, in reading order. Their bytes belong into the session.
    pub files: Vec<PathBuf>,
    /// The part of the file that was used, for example the section of a resolution.
    pub part: Option<String>,
}

/// Formats of calibration files that are read and written.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Format {
    /// Stereolabs factory file `SNnnnn.conf`.
    ZedConf,
    /// EuRoC / ASL folder with `sensor.yaml` files.
    Euroc,
    /// KITTI odometry `calib.txt` with projection matrices.
    Kitti,
    /// `K.txt` with one camera matrix and a baseline, for a rectified pair.
    Pair,
    /// Kalibr `camchain.yaml`, with `imu.yaml` beside it.
    Kalibr,
    /// Basalt `calibration.json`.
    Basalt,
    /// OpenCV FileStorage YAML: `K1 D1 K2 D2 R T` and the like.
    OpenCv,
    /// COLMAP `cameras.txt`, with `rigs.txt` beside it.
    Colmap,
    /// COLMAP `cameras.bin`, with `rigs.txt` beside it.
    ColmapBin,
    /// nerfstudio and instant-ngp `transforms.json`.
    Nerfstudio,
    /// ROS `camera_info` YAML, one file per camera.
    Ros,
    /// RoSys camera JSON.
    Rosys,
    /// Middlebury stereo `calib.txt`.
    Middlebury,
}

impl Format {
    /// All formats.
    pub const ALL: [Self; 13] = [
        Self::ZedConf,
        Self::Euroc,
        Self::Kitti,
        Self::Pair,
        Self::Kalibr,
        Self::Basalt,
        Self::OpenCv,
        Self::Colmap,
        Self::ColmapBin,
        Self::Nerfstudio,
        Self::Ros,
        Self::Rosys,
        Self::Middlebury,
    ];

    /// Name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::ZedConf => "zed",
            Self::Euroc => "euroc",
            Self::Kitti => "kitti",
            Self::Pair => "pair",
            Self::Kalibr => "kalibr",
            Self::Basalt => "basalt",
            Self::OpenCv => "opencv",
            Self::Colmap => "colmap",
            Self::ColmapBin => "colmap-bin",
            Self::Nerfstudio => "nerfstudio",
            Self::Ros => "ros",
            Self::Rosys => "rosys",
            Self::Middlebury => "middlebury",
        }
    }

    /// The format of a name on the command line.
    ///
    /// ```
    /// use calib::{Format, LensModel};
    ///
    /// assert_eq!(Format::from_name("kalibr"), Some(Format::Kalibr));
    /// assert_eq!(Format::from_name("matlab"), None);
    /// assert!(Format::ALL.into_iter().all(|format| Format::from_name(format.name()) == Some(format)));
    /// // What a format can hold of a lens.
    /// assert!(Format::Kalibr.models().contains(&LensModel::DoubleSphere));
    /// assert!(!Format::OpenCv.models().contains(&LensModel::DoubleSphere));
    /// ```
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|format| format.name() == name)
    }

    /// The lens models of the format, the smallest of a family first.
    pub fn models(self) -> &'static [LensModel] {
        use LensModel::{
            DoubleSphere, Eucm, KannalaBrandt4, None, RadTan4, RadTan5, Radial2, Rational8,
        };
        match self {
            Self::Kitti | Self::Pair | Self::Middlebury => &[None],
            Self::ZedConf => &[None, RadTan5, Rational8, KannalaBrandt4],
            Self::Euroc => &[None, RadTan4, KannalaBrandt4],
            Self::Kalibr => &[None, RadTan4, KannalaBrandt4, DoubleSphere, Eucm],
            Self::Basalt => &[None, Rational8, KannalaBrandt4, DoubleSphere, Eucm],
            Self::OpenCv | Self::Rosys => &[None, RadTan4, RadTan5, Rational8, KannalaBrandt4],
            Self::Colmap | Self::ColmapBin => &[None, Radial2, RadTan4, Rational8, KannalaBrandt4],
            Self::Nerfstudio => &[None, RadTan4, RadTan5, KannalaBrandt4],
            Self::Ros => &[None, RadTan5, Rational8, KannalaBrandt4],
        }
    }
}

/// Tolerance of a rectified pair: rotation in rad and offset in m. Rectified files have exact
/// zeros; this only absorbs rounding errors.
const RECTIFIED_TOLERANCE: f64 = 1e-12;

/// Maximum distance of two sensors of one camera, metres. Beyond it the values are millimetres.
pub(crate) const MAX_BASELINE_M: f64 = 10.0;

/// Error text for a right eye to the left of the left one.
pub(crate) fn swapped(right_from_left: &RigidTransform) -> Option<String> {
    let [x, ..] = right_from_left.translation_m();
    (x >= 0.0).then(|| {
        format!(
            "the left camera's origin is at x = {x} m in the right camera's frame, expected below 0: are left and \
             right swapped?"
        )
    })
}

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

    /// The calibration itself, if its values are valid. `path` is its file.
    pub(crate) fn validate(self, path: &Path) -> Result<Self, CalibError> {
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
            Some(reason) => Err(CalibError::Implausible {
                path: path.to_owned(),
                reason,
            }),
        }
    }
}
