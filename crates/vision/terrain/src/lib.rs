//! Depth images with sigmas and poses to the ground that a person walked on.
//!
//! [`fusion`] makes a truncated signed distance field (TSDF) of depth images, [`mesh`] its surface.
//! [`planes`] finds planes in the mesh and refits them to the depths themselves; [`edges`] are
//! where they meet or end, and the heights of steps. [`maps`] are grids of each walkable level, for
//! foothold planning. [`simplify`] removes triangles that feet do not need, [`convex`] makes parts
//! for physics, and [`export`] writes meshes. [`evaluate`] compares results with ground truth.
//!
//! Frames: the world has z up; a view has x right, y down, z along its optical axis. Metres,
//! radians, seconds, pixels. The same input gives the same bytes on any number of threads. Nothing
//! here knows sessions, files of scenes, feet, or cameras other than rectified views with depth.

#![forbid(unsafe_code)]

mod config;
pub mod convex;
pub mod edges;
mod error;
pub mod evaluate;
pub mod export;
pub mod fusion;
pub mod ground;
pub mod maps;
pub mod mesh;
pub mod planes;
pub mod simplify;
mod view;

pub use config::{
    ConvexConfig, EdgeConfig, FusionConfig, MapConfig, MeshConfig, ObstacleConfig, PlaneConfig,
    SimplifyConfig,
};
pub use error::TerrainError;
pub use view::{DepthView, PixelClass, RowMotion};
