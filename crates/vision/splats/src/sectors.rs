//! Sectors: parts of a scene of a long walk, each trained by itself.
//!
//! [`Cells`] divide the ground by the positions of the cameras, [`CellVisibility`] says which views
//! see a cell from outside of it, a [`Part`] is what the training of a sector leaves: the Gaussians
//! in its cell. [`merged_background`] is the sky behind all of them.
//!
//! Contract: every point of the world is in exactly one cell, so that parts can be put together
//! as they are. The same input gives the same cells, views and bytes.

mod background;
mod cells;
mod config;
mod part;
mod visibility;

pub use background::merged_background;
pub use cells::{CellBox, Cells};
pub use config::SectorConfig;
pub use part::Part;
pub use visibility::CellVisibility;
