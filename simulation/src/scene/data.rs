//! A scene: its sectors, and what it does not have.

use super::crossing::config::CrossingConfig;
use super::graph::{self, GraphConfig};
use super::hash;
use super::sector::Sector;
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
    pub(super) missing: Vec<Missing>,
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
    /// A scene of sectors in memory, with the hash of their content.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] for no sectors, names that are not unique, edges to unknown
    /// sectors, cycles of edges that do not close and scales inside of a recording.
    pub fn new(name: &str, sectors: Vec<Sector>) -> Result<Self, SimulationError> {
        let hash = hash::of_sectors(&sectors);
        Self::with_hash(name, sectors, hash, Vec::new())
    }

    pub(super) fn with_hash(
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
