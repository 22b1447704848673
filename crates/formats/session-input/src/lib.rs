//! Sessions as plain data for estimators: IMU samples in SI units with their gaps, decoded frames
//! and frame sets.
//!
//! - [`imu`]: stored IMU batches to samples in SI units, in one place, and the rules for gaps.
//! - [`image`]: decoded images, one per eye.
//! - [`session`]: an indexed session: its frames, frame sets and IMU samples, in order or by
//!   number.
//! - [`visit`]: all images of a camera through a callback, on all cores.
//! - [`stills`]: a few small images of a camera.
//!
//! It knows the session format and the video decoder. It knows nothing of hand-offs and verdicts,
//! of bundles, nor of any estimator: programs convert its types to those of the vision crates.

mod error;
mod gop;
pub mod image;
pub mod imu;
pub mod session;
pub mod stills;
pub mod visit;

pub use error::{FrameFault, ImuFault, ReadError, SessionError};
pub use image::{Color, Image};
pub use imu::ImuSample;
pub use session::{
    FrameSet, Frames, LumaFrameSet, LumaFrameSets, Session, Sets, StereoFrame, View,
};
