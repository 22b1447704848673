//! Opens scenes from folders and files.

use std::path::Path;

use super::beogym::{self, BeogymConfig};
use super::bundle::{self, BundleConfig};
use super::data::SceneData;
use super::file;
use crate::error::SimulationError;

impl SceneData {
    /// Opens a scene bundle, or a scene file with several of them (reference page).
    ///
    /// # Errors
    /// [`SimulationError::Bundle`] for what is no bundle, [`SimulationError::Scene`] for damaged
    /// files and contradictions, each with sector, file and first wrong index.
    pub fn open(path: &Path) -> Result<Self, SimulationError> {
        Self::open_with(path, &BundleConfig::default())
    }

    /// Opens a scene bundle with another configuration.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_with(path: &Path, config: &BundleConfig) -> Result<Self, SimulationError> {
        let is_manifest = path.file_name().is_some_and(|name| name == "scene.json");
        match path.is_file() && !is_manifest {
            true => file::open(path, config),
            false => bundle::open(path, config),
        }
    }

    /// Imports a folder of Beogym: `gaussian_splat_data` with its sectors and `surfaceMap.pcd`, or
    /// one with `sequence.json` (reference page).
    ///
    /// # Errors
    /// [`SimulationError::Scene`] with sector, file and first wrong index.
    pub fn open_beogym(path: &Path, config: &BeogymConfig) -> Result<Self, SimulationError> {
        beogym::open(path, config)
    }
}
