//! A scene: its sectors, and what it does not have.

use super::crossing::config::CrossingConfig;
use super::graph::{self, GraphConfig};
use super::hash;
use super::sector::Sector;
use super::similarity::Similarity;
use crate::error::SimulationError;

/// A scene.
#[derive(Clone, Debug)]
pub struct SceneData {
    /// Its name, for messages.
    pub name: String,
    /// Its sectors, at least one. A scene of other ones is made by [`SceneData::new`], which
    /// checks and hashes them.
    pub sectors: Vec<Sector>,
    hash: [u8; 32],
    pub(super) crossing: CrossingConfig,
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

    /// Takes points of each sector to the frame of the first sector that edges connect it with,
    /// along a spanning tree of the edges: the index of that sector, and the transform.
    pub fn roots_from_sectors(&self) -> Vec<(usize, Similarity)> {
        graph::spanning_tree(&self.sectors)
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

    /// Hash of everything in it. Snapshots belong to a scene by it.
    pub fn hash(&self) -> &[u8; 32] {
        &self.hash
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
