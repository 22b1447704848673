//! Output `rig`: `rig.json`, intrinsics and extrinsics of cameras and IMUs as used by the stages.
//!
//! Contract: names of cameras are folder names, each once; likewise IMUs.

use std::collections::BTreeSet;

use cad_transforms::rig::{Foot, TagFamily};
use cad_transforms::{Covariance, RigidTransform};
use camera_models::{CameraModel, ImuNoise};
use serde::{Deserialize, Serialize};

use super::{read_json, refused, write_json};
use crate::draft::Draft;
use crate::error::BundleError;
use crate::layout;
use crate::scene::OutputReader;

const FILE: &str = "rig.json";

/// A rig.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigModel {
    /// Its name.
    pub name: String,
    /// Which build of it.
    pub revision: String,
    /// Its stereo cameras. Other outputs refer to a camera by its index here, from 0.
    pub cameras: Vec<RigCamera>,
    /// Its IMUs.
    pub imus: Vec<RigImu>,
    /// Shoes of the wearer with tags or a known sole, each foot at most once.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub shoes: Vec<RigShoe>,
}

/// A shoe of the wearer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigShoe {
    /// Which foot. Its frame has its origin in the middle of the sole, x to the toe, y to the left,
    /// z up from the sole.
    pub foot: Foot,
    /// Outline of the sole in the frame of the foot, m, counter-clockwise seen from above; empty if
    /// unknown.
    pub outline_m: Vec<[f64; 2]>,
    /// Standard deviation of its vertices, m.
    pub outline_sigma_m: Option<f64>,
    /// Its tags.
    pub tags: Vec<RigShoeTag>,
}

/// An AprilTag on a shoe.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigShoeTag {
    /// Its family.
    pub family: TagFamily,
    /// Its number in the family.
    pub id: u32,
    /// Side of the black square, m.
    pub size_m: f64,
    /// Standard deviation of that, m.
    pub size_sigma_m: Option<f64>,
    /// Takes points in the tag's frame (x right, y down, z into the tag) to the foot's, metres.
    pub foot_from_tag: RigidTransform,
    /// Its covariance: of a small motion of the tag in its own axes.
    pub foot_from_tag_covariance: Option<Covariance>,
}

/// A stereo camera.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigCamera {
    /// Its name.
    pub name: String,
    /// Intrinsics of the left image as recorded.
    pub left: CameraModel,
    /// Intrinsics of the right image as recorded.
    pub right: CameraModel,
    /// Takes points in the left optical frame to the rig's, metres.
    pub rig_from_left: RigidTransform,
    /// Its covariance: of a small motion of the left optical frame in its own axes.
    pub rig_from_left_covariance: Option<Covariance>,
    /// Takes points in the left optical frame to the right one, metres.
    pub right_from_left: RigidTransform,
    /// Its covariance: of a small motion of the left optical frame in its own axes.
    pub right_from_left_covariance: Option<Covariance>,
    /// Readout line time, s: exposure of a row relative to the row above; 0 for a global shutter.
    pub line_s: f64,
}

/// An IMU.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigImu {
    /// Its name.
    pub name: String,
    /// Takes points in the IMU's frame to the rig's, metres.
    pub rig_from_imu: RigidTransform,
    /// Its covariance: of a small motion of the IMU in its own axes.
    pub rig_from_imu_covariance: Option<Covariance>,
    /// Nominal rate, Hz.
    pub rate_hz: Option<f64>,
    /// Noise model.
    pub noise: Option<ImuNoise>,
    /// Measurement range: largest angular rate and specific force, rad/s and m/s².
    pub range: Option<[f64; 2]>,
}

impl RigModel {
    /// A camera by its name, with its index.
    pub fn camera(&self, name: &str) -> Option<(usize, &RigCamera)> {
        self.cameras
            .iter()
            .enumerate()
            .find(|(_, c)| c.name == name)
    }

    fn validate(&self) -> Option<String> {
        let cameras: Vec<&str> = self.cameras.iter().map(|c| c.name.as_str()).collect();
        let imus: Vec<&str> = self.imus.iter().map(|i| i.name.as_str()).collect();
        for (what, names) in [("camera", &cameras), ("IMU", &imus)] {
            if let Some(name) = names.iter().find(|name| !layout::is_file_path(name)) {
                return Some(format!("a {what} called {name:?}"));
            }
            if names.iter().collect::<BTreeSet<_>>().len() < names.len() {
                return Some(format!("{what}s called {}", names.join(", ")));
            }
        }
        for camera in &self.cameras {
            if !(camera.line_s.is_finite() && camera.line_s >= 0.0) {
                return Some(format!(
                    "{} s from row to row of {}",
                    camera.line_s, camera.name
                ));
            }
        }
        let feet: BTreeSet<Foot> = self.shoes.iter().map(|shoe| shoe.foot).collect();
        if feet.len() < self.shoes.len() {
            return Some("two shoes of one foot".to_owned());
        }
        // A camera's number is a byte in other outputs.
        (cameras.len() > 256).then(|| format!("{} cameras", cameras.len()))
    }
}

/// Writes the rig.
///
/// # Errors
/// [`BundleError::Refused`] for names that are invalid or duplicate, [`BundleError::Io`].
pub fn write(draft: &Draft, rig: &RigModel) -> Result<(), BundleError> {
    if let Some(found) = rig.validate() {
        let expected = "up to 256 different names of ASCII letters, digits, _, - and ., and times of 0 or more";
        return Err(refused(draft, FILE, found, expected));
    }
    write_json(draft, FILE, rig)
}

/// Reads the rig.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read(reader: &OutputReader) -> Result<RigModel, BundleError> {
    let rig: RigModel = read_json(reader, FILE)?;
    match rig.validate() {
        None => Ok(rig),
        Some(found) => Err(BundleError::Malformed {
            path: reader.file_path(FILE),
            place: "names and times".to_owned(),
            found,
            expected: "different names of ASCII letters, digits, _, - and ., times of 0 or more"
                .to_owned(),
        }),
    }
}
