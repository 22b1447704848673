//! Confidence: how far an image of a scene is outside of what its training saw.
//!
//! A [`Coverage`] is gathered once, after a training, from its views: which instants and directions
//! saw each Gaussian, how finely and with which errors, through which space views looked, and where
//! they saw sky. [`Coverage::render`] gives channels of an image from any camera, and
//! [`CoverageImage::confidence`] combines them to a confidence of each pixel, a prediction of the
//! PSNR, and the odds that the whole image is bad.
//!
//! Contract: nothing of a truth is used, only the scene and the views of its training. Neither
//! rendering nor training depends on it. The same bytes on any number of threads.

mod channels;
mod config;
mod coverage;
mod directions;
mod measure;
mod rays;
mod sky;
mod space;
#[cfg(test)]
mod tests;

pub use channels::CoverageImage;
pub use config::{ConfidenceConfig, CoverageConfig, ImageMeasureConfig, MeasureConfig};
pub use coverage::{Coverage, ObservedGaussian};
pub use directions::{DIRECTIONS, Directions};
pub use measure::{Confidence, IMAGE_CHANNELS};
pub use sky::ObservedSky;
pub use space::{ObservedSpace, SpaceBlock};
