//! The renderer: tiles of 16x16 pixels, vectors of eight lanes, threads of the current rayon pool.
//!
//! Contract: the same image as the [reference](crate::reference) up to rounding, and the same bytes
//! on any number of threads and with every [`Level`]. Gaussians that cannot be represented in f32
//! in the image (degenerate or larger than about 10⁷ px) are not rendered and counted.
//!
//! Stages: projection of eight neighboring Gaussians at a time (`project`), order by depth
//! (`order`), lists of Gaussians per tile (`bins`), blending per tile (`blend`), background,
//! exposure and depths (`finish`).

mod backward;
mod bins;
mod blend;
mod detail;
mod finish;
mod forward;
mod geometry;
mod gradients;
mod image;
mod observe;
mod order;
mod project;
mod rays;
mod slope;
#[cfg(test)]
mod tests;
mod view;
mod weights;

pub use detail::{DetailScene, config::DetailConfig};
pub use forward::{Pass, RenderStats, Renderer};
pub use gradients::{Gradients, ImageGradient};
pub use image::Image;
pub(crate) use observe::{Observation, PixelErrors};
pub(crate) use view::TILE;
