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

pub mod config;
pub mod estimator;
pub mod input;
pub mod keyframe;
pub mod mapping;
pub mod rig;

mod backend;
mod frontend;
mod inertial;
mod so3;
#[cfg(test)]
mod test_rig;

pub use config::{Config, Preset};
pub use estimator::{CameraShift, Estimate, Odometry, Status};
pub use input::{FrameSet, ImuSample, View};
pub use keyframe::Keyframe;
pub use mapping::{Mapping, Refined};
pub use rig::Rig;
