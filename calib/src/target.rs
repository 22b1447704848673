//! Calibration targets: flat boards whose corners are known, and finding these corners in a picture.
//!
//! Contract: a [`Target`] says where its corners are and what is black on it, in metres; files of ours
//! and of Kalibr give one or say what is wrong with them. [`detect()`] gives a board's corners in a picture,
//! each with its id and its place to a few hundredths of a pixel; what is not sure is absent. Nothing here
//! knows a lens: pixel coordinates in, pixel coordinates out.
//!
//! How a corner is found: saddle points of the smoothed picture (`saddle`), borders followed from one to
//! the next (`link`), squares and lattices out of these links, ids from the tags, markers, or the size of
//! the whole board, and at the end the place where the gradients around a corner point past (`refine`).

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
