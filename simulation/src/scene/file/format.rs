//! Content of a scene file.

use serde::{Deserialize, Serialize};

use crate::scene::sector::Area;
use crate::scene::similarity::Similarity;

/// Value of `format` in the file, and its version.
pub(in crate::scene) const FORMAT: &str = "paws-scene-graph";
pub(in crate::scene) const VERSION: u32 = 1;
/// Longest file, bytes.
pub(super) const MAX_BYTES: u64 = 16 << 20;

/// A scene file.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::scene) struct SceneFile {
    pub(in crate::scene) format: String,
    pub(in crate::scene) version: u32,
    pub(in crate::scene) name: String,
    pub(in crate::scene) recordings: Vec<RecordingEntry>,
    #[serde(default)]
    pub(in crate::scene) edges: Vec<EdgeEntry>,
}

/// A recording with one or several sectors.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::scene) struct RecordingEntry {
    /// Prefix of the names of its sectors.
    pub(in crate::scene) name: String,
    /// Path of a bundle, relative to the file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::scene) bundle: Option<String>,
    /// Path of a folder of Beogym, relative to the file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::scene) beogym: Option<String>,
    /// Least x and y of what its sector owns, m. Without both corners that is the extent of its
    /// maps and Gaussians.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::scene) area_min_m: Option<[f64; 2]>,
    /// Greatest x and y, m.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::scene) area_max_m: Option<[f64; 2]>,
}

impl RecordingEntry {
    /// The area of its sector, if the file states one, or what is wrong with it.
    pub(super) fn area(&self, sectors: usize) -> Result<Option<Area>, String> {
        match (self.area_min_m, self.area_max_m) {
            (None, None) => Ok(None),
            (Some(_), Some(_)) if sectors != 1 => Err(format!("an area of {sectors} sectors")),
            (Some(min_m), Some(max_m)) if (0..2).all(|k| min_m[k] < max_m[k]) => {
                Ok(Some(Area::new(min_m, max_m)))
            }
            (min_m, max_m) => Err(format!("an area from {min_m:?} to {max_m:?}")),
        }
    }
}

/// An edge. Its reverse follows from it.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(in crate::scene) struct EdgeEntry {
    pub(in crate::scene) from: String,
    pub(in crate::scene) to: String,
    pub(in crate::scene) to_from_here: Similarity,
    pub(in crate::scene) overlap_min_m: [f64; 2],
    pub(in crate::scene) overlap_max_m: [f64; 2],
    /// Distance by which its alignment missed, m; none where that is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(in crate::scene) residual_m: Option<f64>,
}
