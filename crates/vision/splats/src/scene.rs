//! The scene: 3D Gaussians, what is behind them, and how a camera exposes.
//!
//! World frame, metres. Colors are those of the images (sRGB values from 0 to 1), blended as they
//! are: that is the convention of all files of Gaussians.

mod exposure;
mod morton;
mod sky;

#[cfg(test)]
mod tests;

pub use exposure::Exposure;
pub use gaussians::{MAX_DEGREE, Plane, Splat, Splats, coefficients};
pub(crate) use morton::morton_order;
pub use sky::Sky;
pub(crate) use sky::taps;

/// A scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The Gaussians.
    pub splats: Splats,
    /// What is behind them.
    pub background: Background,
}

/// What is behind all Gaussians.
#[derive(Clone, Debug, PartialEq)]
pub enum Background {
    /// One color.
    Constant([f32; 3]),
    /// A color per direction in the world.
    Sky(Sky),
}

impl Background {
    /// The color in a direction in the world; the length does not matter.
    pub fn color(&self, direction_in_world: [f32; 3]) -> [f32; 3] {
        match self {
            Self::Constant(color) => *color,
            Self::Sky(sky) => sky.color(direction_in_world),
        }
    }
}
