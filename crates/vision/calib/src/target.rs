//! Detection of calibration targets (planar boards with known corners) in images.
//!
//! Contract: a [`Target`](boards::Target) defines where its corners are, in metres. [`detect()`]
//! returns a board's corners in an image, each with its id and its position to a few hundredths of
//! a pixel; uncertain corners are absent. Nothing here knows a lens: pixel coordinates in, pixel
//! coordinates out.
//!
//! Steps: saddle points of the smoothed image (`saddle`), borders followed from one to the next
//! (`link`), squares and lattices from these links, ids from the tags, markers, or the size of the
//! whole board, and subpixel refinement (`refine`).

mod blur;
mod chessboard;
mod config;
mod detect;
mod grid;
mod lattice;
mod link;
mod refine;
mod saddle;
mod scene;
mod smooth;

pub use blur::Blur;
pub use config::{
    BlurConfig, Config, LatticeConfig, LinkConfig, MarkerConfig, RefinementConfig, SaddleConfig,
};
pub use detect::{DetectedCorner, Detection, detect, detect_all};
pub use imaging::ImageView;

#[cfg(test)]
mod tests;
