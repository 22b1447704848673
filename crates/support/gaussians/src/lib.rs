//! 3D Gaussians (Kerbl et al., 3D Gaussian Splatting for Real-Time Radiance Field Rendering, 2023)
//! as data: their parameters, rigid transforms of them, and files.
//!
//! - [`Splats`] is a structure of arrays of Gaussians. World frame, m.
//! - [`files`] reads and writes `.ply`, `.splat` and `.spz`, and writes `.glb`.
//!
//! Nothing here renders or trains: the crate `splats` does.
#![allow(
    clippy::needless_range_loop,
    reason = "formulas of vectors and matrices use the same index in several arrays"
)]

mod error;
pub mod files;
pub mod harmonics;
mod random;
mod splats;
#[cfg(test)]
mod tests;

pub use error::GaussianError;
pub use random::random_splats;
pub use splats::{MAX_DEGREE, Plane, Splat, Splats, coefficients};
