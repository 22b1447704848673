//! Disparity and depth of rectified stereo images, with a standard deviation per pixel.
//!
//! A pair of images that differ by a shift of 8 columns, from a camera with a focal length of 100
//! px and a baseline of 6 cm, shows a wall at 75 cm:
//!
//! ```
//! use depth::{Band, Config, Geometry, ImageView, Matcher, Preset};
//!
//! # // A random texture of 3 x 3 patches; the right image shows it `shift` columns further to the left.
//! # fn pair(width: usize, height: usize, shift: usize) -> [Vec<u8>; 2] {
//! #     let gray = |x: usize, y: usize| {
//! #         let hash = (x / 3 * 1009 + y / 3 + 1) as u64;
//! #         40 + (hash.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 57) as u8
//! #     };
//! #     [0, shift].map(|from| (0..width * height).map(|i| gray(i % width + from, i / width)).collect())
//! # }
//! # let [left, right] = pair(128, 48, 8);
//! let mut matcher = Matcher::new(Config::preset(Preset::Fast), 128, 48)?;
//! let images = [ImageView::packed(128, 48, &left)?, ImageView::packed(128, 48, &right)?];
//! let map = matcher.run(&images[0], &images[1], &Band::full(0, 32, 48)?)?;
//!
//! let geometry = Geometry { focal_px: 100.0, center: [63.5, 23.5], baseline_m: 0.06, offset_px: 0.0 };
//! let depth = geometry.depth(map, 0.1)?;
//! let [row, column] = [24, 80];
//! let [depth_m, sigma_m] = [&depth.depth_m, &depth.sigma_m].map(|of| of[row * 128 + column]);
//! assert!((depth_m - 0.75).abs() < 0.05, "{depth_m} m");
//! assert!(sigma_m > 0.0 && sigma_m < 0.1 * depth_m, "{sigma_m} m");
//! # Ok::<(), depth::DepthError>(())
//! ```

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
mod lanes;
mod linear;
mod map;
mod matcher;
mod median;
pub mod noise;
mod planes;
mod prediction;
#[cfg(test)]
mod reference;
mod row_alignment;
pub mod sigma;
mod smoothing;
mod speckle;

pub use aggregation::{Paths, Penalties};
pub use band::Band;
pub use banded_matcher::{BandStats, BandedMatcher};
pub use census::Census;
pub use config::{BandConfig, Config, Margin, Matching, Preset};
pub use error::DepthError;
pub use half_resolution::Downsample;
pub use imaging::ImageView;
pub use lanes::Level;
pub use map::{DepthMap, DisparityMap, Geometry};
pub use matcher::{MatchStats, Matcher};
