//! Opens scenes from folders and files.

use std::path::Path;

use super::beogym::{self, BeogymConfig};
use super::bundle::{self, BundleConfig};
use super::data::SceneData;
use super::file;
use super::import;
use crate::error::SimulationError;

impl SceneData {
    /// Opens a scene bundle, or a scene of several recordings: its scene file, or the folder with
    /// `scene-graph.json` (reference page).
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
        let of_folder = path.join(file::IN_FOLDER);
        if of_folder.is_file() {
            return file::open(&of_folder, config);
        }
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

    /// Imports a folder of Beogym and writes it as a new folder that [`Self::open`] opens: a scene
    /// bundle for each sector, and `scene-graph.json` with their areas and edges. The maps of a
    /// sector reach 8 m beyond its area. Returns the import with what the folder
    /// [lacks](Self::missing). `now_civil_ns` is for the provenance, ns of UTC since 1970.
    ///
    /// # Errors
    /// As [`Self::open_beogym`]; [`SimulationError::Scene`] if there is something at the new path
    /// or it cannot be written. Then nothing is left there that was not there before.
    pub fn import_beogym(
        from: &Path,
        to: &Path,
        config: &BeogymConfig,
        now_civil_ns: i64,
    ) -> Result<Self, SimulationError> {
        let scene = beogym::open(from, config)?;
        import::write(&scene, config, to, now_civil_ns)?;
        Ok(scene)
    }
}
