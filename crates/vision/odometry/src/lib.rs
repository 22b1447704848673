//! Visual-inertial odometry: from stereo images and IMU samples of a rig to its poses with
//! covariances.
//!
//! ```text
//!  images ──► tracks ──────► window ──► causal poses        (frontend: pyramid, detector, klt, tracker)
//!  IMU ──► preintegrated ──┘    │                           (backend: window, solver, marginalization)
//!                               └──► keyframes ──► loop closures ──► refined poses
//! ```
//!
//! - [`rig`]: stereo cameras and IMUs of the rig with their nominal calibration.
//! - [`input`]: frame sets and IMU samples.
//! - [`estimator`]: causal poses; each depends on earlier input only.
//! - [`mapping`]: bundle adjustment of the whole session after its end.
//!
//! Contract. *Early*: the first pose comes with the first usable frame set; until gravity has been
//! measured its tilt is uncertain and its covariance states it. *Late*: frame sets are in order of
//! time; the frames of a camera may be earlier or later than their set by half a frame interval.
//! *Gap*: without images the IMU alone propagates the pose while its uncertainty is small; without
//! IMU samples the images alone estimate it. *Failure*: an unknown pose is reported as lost; every
//! pose has a covariance and a status. Same input, same bytes, on any number of threads.
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
