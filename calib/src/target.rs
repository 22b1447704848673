//! Calibration targets: flat boards whose corners are known, and finding these corners in a picture.
//!
//! Contract: a [`Target`] says where its corners are and what is black on it, in metres; files of ours
//! and of Kalibr give one or say what is wrong with them. Nothing here knows a lens: pixel coordinates in,
//! pixel coordinates out.

pub mod board;
pub mod codes;

mod file;

pub use board::{Corner, Rectangle, Target};
pub use codes::Dictionary;
