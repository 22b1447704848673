//! Rectified stereo pictures to disparity, depth and their sigma.

#![allow(
    clippy::needless_range_loop,
    reason = "kernels walk several rows at once; by index they become vector code"
)]

mod aggregate;
pub mod band;
mod banded;
mod cells;
mod census;
mod cost;
mod error;
pub mod evaluate;
mod halved;
mod lanes;
mod map;
mod matcher;
mod median;
pub mod noise;
mod picture;
mod settings;
mod settle;
pub mod sigma;
mod speckle;
#[cfg(test)]
mod twin;

pub use aggregate::{Paths, Penalties};
pub use band::Band;
pub use banded::{Banded, Spared};
pub use census::Census;
pub use error::DepthError;
pub use halved::Half;
pub use lanes::Level;
pub use map::{DepthMap, DisparityMap, Geometry};
pub use matcher::{Matcher, Seen};
pub use picture::Picture;
pub use settings::{Matching, Preset, Settings};
