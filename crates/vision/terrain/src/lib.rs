//! Depth images with sigmas and poses to the ground that a person walked on.
//!
//! [`fusion`] makes a truncated signed distance field (TSDF) of depth images, [`mesh`] its surface.
//! [`evaluate`] compares results with ground truth.
//!
//! Frames: the world has z up; a view has x right, y down, z along its optical axis. Metres,
//! radians, seconds, pixels. The same input gives the same bytes on any number of threads. Nothing
//! here knows sessions, files of scenes, feet, or cameras other than rectified views with depth.

#![forbid(unsafe_code)]

mod config;
mod error;
pub mod evaluate;
pub mod fusion;
pub mod mesh;
mod view;

pub use config::{FusionConfig, MeshConfig};
pub use error::TerrainError;
pub use view::{DepthView, PixelClass, RowMotion};
