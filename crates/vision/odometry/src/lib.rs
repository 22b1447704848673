//! Stereo pictures and IMU samples of a rig in; where the rig was, and how sure that is, out.
//!
//! ```text
//!  pictures ──► tracks ──► window ──► causal poses          (front end: pyramid, corners, follow, tracker)
//!  IMU ──► preintegrated ──┘    │                           (back end: window, solve, marginal)
//!                               └──► keyframes ──► loops ──► adjusted poses
//! ```
//!
//! - [`rig`]: what is known of the rig: stereo cameras, IMUs, where they sit.
//! - [`input`]: frame sets, as they come.
//! - [`odometry`]: poses as they become known; each depends on what came before it alone.
//! - [`mapping`]: the whole session at once, when it is over.
//!
//! Contract. *Early*: the first pose comes with the first frame set that shows anything; until gravity has been
//! felt its tilt is uncertain and its covariance says so. *Late*: frame sets come in order of time; a camera's
//! pictures may be earlier or later than their set by half a frame. *At a gap* of pictures the IMU carries on, as long
//! as it is sure; at one of the IMU pictures do. *On failure*: a pose that is not known is given as lost; every one
//! carries a covariance and a status. Same input, same bytes, on any number of threads.
//!
//! This crate knows nothing of sessions, files, or devices.

pub mod input;
pub mod keyframe;
pub mod mapping;
pub mod odometry;
pub mod rig;
pub mod settings;

mod anew;
mod corners;
mod describe;
mod doubt;
mod felt;
mod follow;
mod imu;
#[cfg(test)]
mod made;
mod marginal;
mod motion;
mod mount;
mod pyramid;
mod shift;
mod shown;
mod sight;
mod so3;
mod solve;
mod start;
mod state;
mod tracker;
mod window;

pub use input::{FrameSet, ImuSample, View};
pub use keyframe::Keyframe;
pub use mapping::{Adjusted, Mapping};
pub use odometry::{Estimate, Odometry, Status};
pub use rig::Rig;
pub use settings::{Preset, Settings};
pub use shift::Shift;
