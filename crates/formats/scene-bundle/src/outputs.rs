//! The outputs that the format defines, each with its writer and reader.
//!
//! Contract: a writer puts the files of its output into a [`Draft`] and leaves the commit to the
//! caller; a reader takes an [`OutputReader`], so every byte is checked against its hash before it
//! is used. `FORMAT.md` has the layouts.

pub mod cloud;
pub mod collision;
pub mod contacts;
pub mod depth;
pub mod feet;
pub mod grid;
pub mod keyframes;
pub mod maps;
pub mod masks;
pub mod rig;
pub mod splats;
pub mod tag_detections;
pub mod terrain;
pub mod tracks;
pub mod trajectory;

pub(crate) mod gray_png;

use serde::Serialize;
use serde::de::DeserializeOwned;

use crate::draft::Draft;
use crate::error::BundleError;
use crate::scene::OutputReader;

/// The rig: intrinsics and extrinsics of cameras and IMUs.
pub const RIG: &str = "rig";
/// The rig with the camera extrinsics refined by the bundle adjustment.
pub const RIG_REFINED: &str = "rig-refined";
/// Poses of the rig, each computed from the whole recording.
pub const TRAJECTORY: &str = "trajectory";
/// Causal poses of the rig, each computed from the data before it only, as a robot would have them.
pub const TRAJECTORY_CAUSAL: &str = "trajectory-causal";
/// Causal poses of the rig in the odom frame, which do not jump.
pub const TRAJECTORY_ODOM: &str = "trajectory-odom";
/// Keyframes of the odometry with their feature tracks and keypoints.
pub const TRACKS: &str = "tracks";
/// Keyframes of each camera, with their poses.
pub const KEYFRAMES: &str = "keyframes";
/// Pixels of each camera that may be used: wearer masks and dynamic masks.
pub const MASKS: &str = "masks";
/// Depth of keyframes.
pub const DEPTH: &str = "depth";
/// Point cloud.
pub const CLOUD: &str = "cloud";
/// Tags on the wearer's shoes in the images of the cameras.
pub const TAG_DETECTIONS: &str = "tag-detections";
/// Poses of the wearer's feet.
pub const FEET: &str = "feet";
/// Contacts of the wearer's feet with the ground.
pub const CONTACTS: &str = "contacts";
/// Mesh of the ground, its planes and step edges.
pub const TERRAIN: &str = "terrain";
/// Maps of walkable levels.
pub const MAPS: &str = "maps";
/// Convex parts and height layers for physics.
pub const COLLISION: &str = "collision";
/// The scene as 3D Gaussians.
pub const SPLATS: &str = "splats";

pub(crate) fn write_json(
    draft: &Draft,
    path: &str,
    value: &impl Serialize,
) -> Result<(), BundleError> {
    let mut text = serde_json::to_vec_pretty(value).unwrap_or_default();
    text.push(b'\n');
    draft.write(path, &text)
}

pub(crate) fn read_json<T: DeserializeOwned>(
    reader: &OutputReader,
    path: &str,
) -> Result<T, BundleError> {
    serde_json::from_slice(&reader.read(path)?).map_err(|e| BundleError::Malformed {
        path: reader.file_path(path),
        place: format!("line {}", e.line()),
        found: format!("JSON where {e}"),
        expected: format!("what the format has in {path}"),
    })
}

/// JSON without blanks, for files of many numbers.
pub(crate) fn write_compact_json(
    draft: &Draft,
    path: &str,
    value: &impl Serialize,
) -> Result<(), BundleError> {
    let mut text = serde_json::to_vec(value).unwrap_or_default();
    text.push(b'\n');
    draft.write(path, &text)
}

/// A value that the format does not allow, from a caller or in a file.
#[derive(Debug)]
pub(crate) struct Fault {
    place: String,
    found: String,
    expected: &'static str,
}

impl Fault {
    pub(crate) fn new(place: &str, found: String, expected: &'static str) -> Self {
        Self {
            place: place.to_owned(),
            found,
            expected,
        }
    }

    /// From the caller of a writer.
    pub(crate) fn refused(self, draft: &Draft, file: &str) -> BundleError {
        let found = format!("{}: {}", self.place, self.found);
        refused(draft, file, found, self.expected)
    }

    /// In a file that is read.
    pub(crate) fn malformed(self, reader: &OutputReader, file: &str) -> BundleError {
        malformed(
            reader.file_path(file),
            self.place,
            self.found,
            self.expected,
        )
    }
}

/// A file that is not as the format has it.
pub(crate) fn malformed(
    path: std::path::PathBuf,
    place: String,
    found: String,
    expected: &str,
) -> BundleError {
    BundleError::Malformed {
        path,
        place,
        found,
        expected: expected.to_owned(),
    }
}

/// A value that the caller gave and the format does not allow.
pub(crate) fn refused(draft: &Draft, file: &str, found: String, expected: &str) -> BundleError {
    BundleError::Refused {
        path: draft.file_path(file),
        found,
        expected: expected.to_owned(),
    }
}
