//! Scenes: sectors with what was reconstructed of them, and edges between the sectors.
//!
//! Contract: a [`SceneData`] does not change and is shared by all worlds and cameras. Opening
//! checks the hash of every file that may be used later; a damaged one is an error with its name, a
//! missing output is listed in [`SceneData::missing`] with the features that it costs. Gaussians
//! are only checked at opening, and loaded when they are needed.

mod beogym;
mod bundle;
mod crossing;
mod file;
mod gaussians;
mod graph;
mod hash;
pub(crate) mod measures;
mod residency;
mod sector;
mod similarity;

use std::path::Path;

pub use beogym::BeogymConfig;
pub use bundle::BundleConfig;
pub use crossing::{CrossingConfig, Place};
pub use gaussians::GaussianSource;
pub use graph::GraphConfig;
pub use residency::{GaussianStore, ResidencyConfig, SectorGaussians};
pub use sector::{Area, RecordedView, Recording, RecordingCamera, Sector, SectorEdge};
pub use similarity::Similarity;
pub(crate) use similarity::rigid;

use crate::error::SimulationError;

/// A scene.
#[derive(Clone, Debug)]
pub struct SceneData {
    /// Its name, for messages.
    pub name: String,
    /// Its sectors, at least one.
    pub sectors: Vec<Sector>,
    /// Hash of everything in it. Snapshots belong to a scene by it.
    pub hash: [u8; 32],
    /// When an agent changes its sector.
    pub crossing: CrossingConfig,
    missing: Vec<Missing>,
}

/// An output that a scene does not have.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Missing {
    /// Name of the bundle or sector.
    pub place: String,
    /// Name of the output.
    pub output: String,
    /// What cannot be done without it.
    pub features: String,
}

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

    /// A scene of sectors in memory, with the hash of their content.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] for no sectors, names that are not unique, edges to unknown
    /// sectors, cycles of edges that do not close and scales inside of a recording.
    pub fn new(name: &str, sectors: Vec<Sector>) -> Result<Self, SimulationError> {
        let hash = hash::of_sectors(&sectors);
        Self::with_hash(name, sectors, hash, Vec::new())
    }

    fn with_hash(
        name: &str,
        sectors: Vec<Sector>,
        hash: [u8; 32],
        missing: Vec<Missing>,
    ) -> Result<Self, SimulationError> {
        graph::check(&sectors, &GraphConfig::default())?;
        Ok(Self {
            name: name.to_owned(),
            sectors,
            hash,
            crossing: CrossingConfig::default(),
            missing,
        })
    }

    /// What is missing, and which features that costs.
    pub fn missing(&self) -> &[Missing] {
        &self.missing
    }

    /// A sector's index by its name.
    pub fn sector(&self, name: &str) -> Option<usize> {
        self.sectors.iter().position(|sector| sector.name == name)
    }
}
