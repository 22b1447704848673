//! Reads a sealed hand-off (images, calibration, IMU samples) and reconstructs it to a scene
//! bundle.
//!
//! - [`input`]: opens a hand-off and refuses it if it differs from what was validated; its images
//!   and samples come through [`session_input`].
//! - [`pipeline`]: a hand-off to a scene bundle, stage by stage.
//! - [`evaluate`]: errors of an estimated trajectory against ground truth.
//! - [`camera_images`]: a few small images of each camera.
//! - [`report`]: HTML report of a scene bundle.
//! - [`export`]: writes images as PNG with their times, for programs in other languages.
//!
//! ```no_run
//! use reconstruction::Input;
//!
//! let input = Input::open("library/0192aa00-0000-7000-8000-000000000001".as_ref())?;
//! for set in input.session().sets()? {
//!     let set = set?;
//!     for view in set.views.iter().flatten() {
//!         println!("{} {} {} {:?}", set.number, view.camera, view.time, view.left);
//!     }
//! }
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! It knows the hand-off and nothing of the catalogue, of devices, or of how a session was
//! recorded.

pub mod camera_images;
pub mod evaluate;
pub mod export;
pub mod input;
pub mod pipeline;
pub mod report;

pub use input::{Input, InputError};
