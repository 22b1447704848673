//! Disparity and depth of rectified stereo images, with a standard deviation per pixel.

#![allow(
    clippy::needless_range_loop,
    reason = "kernels read several rows in one loop; with indices the compiler vectorizes them"
)]

mod aggregation;
pub mod band;
mod banded_matcher;
mod census;
mod config;
mod consistency;
mod correlation;
mod cost;
mod error;
pub mod evaluate;
mod half_resolution;
mod image;
mod lanes;
mod map;
mod matcher;
mod median;
pub mod noise;
#[cfg(test)]
mod reference;
pub mod sigma;
mod speckle;

pub use aggregation::{Paths, Penalties};
pub use band::Band;
pub use banded_matcher::{BandStats, BandedMatcher};
pub use census::Census;
pub use config::{BandConfig, Config, Matching, Preset};
pub use error::DepthError;
pub use half_resolution::Downsample;
pub use image::ImageView;
pub use lanes::Level;
pub use map::{DepthMap, DisparityMap, Geometry};
pub use matcher::{MatchStats, Matcher};
