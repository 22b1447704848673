//! Depth images with sigmas and poses to the ground that a person walked on.
//!
//! [`fusion`] makes a truncated signed distance field (TSDF) of depth images, [`mesh`] its surface.
//! [`planes`] finds planes in the mesh and refits them to the depths themselves; [`edges`] are
//! where they meet or end, and the heights of steps. [`maps`] are grids of each walkable level, for
//! foothold planning. [`contact_patch`] is the part of a sole that bears. [`simplify`] removes
//! triangles that feet do not need, [`convex`] makes parts for physics. [`evaluate`] compares
//! results with ground truth.
//!
//! A camera that looks down at a step of 20 cm from 1.2 m above it:
//!
//! ```
//! use cad_transforms::RigidTransform;
//! use terrain::{DepthView, RowMotion, edges, fusion, maps, mesh, planes};
//!
//! let (size, focal, center) = ([160, 120], 120.0, [79.5, 59.5]);
//! // The ground is 20 cm deeper in the right half of the image: x > 0 in the world.
//! let depth_m: Vec<f32> =
//!     (0..160 * 120).map(|i| if i % 160 < 80 { 1.2 } else { 1.4 }).collect();
//! let sigma_m = vec![0.004; depth_m.len()];
//! let down = [std::f64::consts::PI, 0.0, 0.0];
//! let view = DepthView {
//!     size,
//!     focal_px: [focal; 2],
//!     center_px: center,
//!     world_from_view: RigidTransform::from_rotation_vector(down, [0.0, 0.0, 1.2])?,
//!     row_motion: RowMotion::default(),
//!     pose_sigma_m: 0.002,
//!     depth_m: &depth_m,
//!     sigma_m: &sigma_m,
//!     color: None,
//!     classes: None,
//! };
//! let mut volume = fusion::Volume::new(Default::default())?;
//! volume.add(&view)?;
//! let mut mesh = mesh::Mesh::of(&volume, &Default::default());
//!
//! // Views are given twice: voxels round what planes of the depths do not.
//! let mut refiner = planes::PlaneRefiner::new(&mesh, &Default::default());
//! refiner.add(&view)?;
//! let planes = refiner.finish();
//! let edges = edges::find_edges(&planes, &Default::default());
//! edges::snap(&mut mesh, &planes, &edges, 0.02);
//! let step = edges.iter().find_map(|edge| edge.step).expect("the step");
//! assert!((step.height_m - 0.2).abs() < 0.002, "{step:?}");
//!
//! let levels = maps::build(&mesh, &edges, &[], &Default::default());
//! let cell = levels[0].index(-0.3, 0.0).expect("in the map");
//! assert!(levels[0].elevation[cell].abs() < 0.002);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! Frames: the world has z up; a view has x right, y down, z along its optical axis. Metres,
//! radians, seconds, pixels. The same input gives the same bytes on any number of threads. Nothing
//! here knows sessions, files of scenes, feet, or cameras other than rectified views with depth.

#![deny(unsafe_code)]

mod config;
pub mod convex;
pub mod edges;
mod error;
pub mod evaluate;
pub mod fusion;
pub mod ground;
mod hull;
mod instructions;
pub mod maps;
pub mod mesh;
mod patch;
pub mod planes;
pub mod simplify;
mod view;

pub use config::{
    ConvexConfig, EdgeConfig, FusionConfig, MapConfig, MeshConfig, ObstacleConfig, PatchConfig,
    PlaneConfig, RampConfig, SimplifyConfig,
};
pub use error::TerrainError;
pub use patch::{ContactPatch, contact_patch};
pub use view::{DepthView, PixelClass, RowMotion};
