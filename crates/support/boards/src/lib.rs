//! Planar calibration boards: where their corners are, which parts are black, and the codes of
//! their markers.
//!
//! [`Target`] is a board, in metres; [`Dictionary`] are its markers; [`pdf`] draws it at its true
//! size. This crate knows nothing of files of boards, of images, or of detection.

pub mod pdf;

mod board;
mod codes;

pub use board::{Corner, Marker, Rectangle, Target};
pub use codes::{ARUCO_NAMES, Dictionary, quarter_turn};
