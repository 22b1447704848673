//! AprilTags of known identity and size in stereo images: their poses from the whole printed
//! pattern, also where blur hides its corners.
//!
//! A detector of corners needs a sharp tag of 20 pixels and gets its range from its size, which the
//! tone curve falsifies. Here the identity and the approximate pose of a tag are known: [`fit()`]
//! compares the printed tag, blurred as its motion says, with the gray values of all eyes that
//! see it.
//!
//! Frames: a *reference* frame in which the eyes are at rest; the frame of an eye, x right, y down,
//! z into the image; that of a [`Tag`]. Metres, radians, seconds, pixels, gray levels of 8 bits.
//! Nothing here knows sessions, shoes or gaits.
#![allow(
    clippy::needless_range_loop,
    reason = "loops for vectors use the same index in several arrays"
)]

mod align;
mod batch;
mod blur;
mod cells;
mod config;
pub mod decode;
mod fit;
mod levels;
mod linearization;
mod locate;
mod moments;
mod patch;
mod pattern;
mod planar_pose;
mod quadrilateral;
mod regions;
mod residuals;
mod search;
pub mod square;
mod tag;
mod template;
#[cfg(test)]
mod test_images;
mod tone;
mod view;

pub use config::Config;
pub use fit::{Fit, Minimum, fit, refine};
pub use locate::{LocateConfig, Place, locate};
pub use planar_pose::{mirrored, poses_from_corners};
pub use quadrilateral::QuadrilateralConfig;
pub use regions::RegionConfig;
pub use search::{Detection, SearchConfig, Searcher};
pub use tag::Tag;
pub use view::{Motion, View};
