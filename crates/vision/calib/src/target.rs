//! Calibration targets: planar boards with known corners, and their detection in images.
//!
//! Contract: a [`Target`] defines where its corners are and which parts are black, in metres; it is
//! read from our files and Kalibr's, with validation. [`detect()`] returns a board's corners in an
//! image, each with its id and its position to a few hundredths of a pixel; uncertain corners are
//! absent. Nothing here knows a lens: pixel coordinates in, pixel coordinates out.
//!
//! Steps: saddle points of the smoothed image (`saddle`), borders followed from one to the next
//! (`link`), squares and lattices from these links, ids from the tags, markers, or the size of the
//! whole board, and subpixel refinement (`refine`).

pub mod board;
pub mod codes;
pub mod detect;
pub mod pdf;

mod blur;
mod chessboard;
mod decode;
mod file;
mod grid;
mod image;
mod lattice;
mod link;
mod refine;
mod saddle;
mod square;

pub use board::{Corner, Marker, Rectangle, Target};
pub use codes::Dictionary;
pub use detect::{Blur, DetectedCorner, Detection, Settings, detect, detect_all};
pub use image::ImageView;

#[cfg(test)]
mod tests;
