//! Scenes: sectors with what was reconstructed of them, and edges between the sectors.
//!
//! Contract: a [`SceneData`] does not change and is shared by all worlds and cameras. Opening
//! checks the hash of every file that may be used later; a damaged one is an error with its name, a
//! missing output is listed in [`SceneData::missing`] with the features that it costs. Gaussians
//! are only checked at opening, and loaded when they are needed.

mod beogym;
mod bundle;
mod crossing;
mod data;
mod file;
mod gaussians;
mod graph;
mod hash;
mod import;
pub(crate) mod measures;
mod open;
mod residency;
mod sector;
mod similarity;

pub use beogym::BeogymConfig;
pub use bundle::BundleConfig;
pub use crossing::Place;
pub use data::{Missing, SceneData};
pub use gaussians::GaussianSource;
pub use residency::{GaussianStore, ResidencyConfig, content::SectorGaussians};
pub use sector::{Area, RecordedView, Recording, RecordingCamera, Sector, SectorEdge};
pub use similarity::Similarity;
pub(crate) use similarity::rigid;
