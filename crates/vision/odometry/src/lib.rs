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
//!
//! # Example
//!
//! A rig with one stereo camera at rest, in front of a wall that is 2 m away:
//!
//! ```
//! use odometry::{Config, FrameSet, Odometry, Preset, Rig, Status, View};
//! # use cad_transforms::RigidTransform;
//! # use imaging::ImageView;
//! # use camera_models::{CameraModel, Distortion};
//! # use odometry::rig::StereoCamera;
//! # let lens = CameraModel::new((160, 120), [100.0, 100.0, 79.5, 59.5], Distortion::None);
//! # let camera = StereoCamera {
//! #     name: "front".to_owned(),
//! #     left: lens,
//! #     right: lens,
//! #     rig_from_left: RigidTransform::identity(),
//! #     covariance: None,
//! #     right_from_left: RigidTransform::from_translation_m([-0.08, 0.0, 0.0])?,
//! #     right_from_left_covariance: None,
//! #     line_s: 0.0,
//! # };
//! # // Gray patches of 5 x 5 pixels, shifted to the left, with sensor noise of each image.
//! # let image = |shift: usize, noise: u64| -> Vec<u8> {
//! #     let hash = |a: u64| (a.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as u8;
//! #     let gray = |i: usize| {
//! #         let (x, y) = (i % 160, i / 160);
//! #         let patch = hash(((x + shift) / 5 * 1009 + y / 5) as u64);
//! #         40 + patch / 2 + hash(noise.wrapping_mul(7919) + i as u64) % 3
//! #     };
//! #     (0..160 * 120).map(gray).collect()
//! # };
//!
//! let rig = Rig { cameras: vec![camera], imus: Vec::new() };
//! let mut odometry = Odometry::new(&rig, Config::preset(Preset::Fast));
//! let mut estimates = Vec::new();
//! for number in 0..3 {
//!     let time_ns = number * 66_666_667;
//!     // A shift of 4 px is the disparity of the wall.
//!     let [left, right] = [0, 4].map(|shift| image(shift, 2 * number as u64 + shift as u64));
//!     let [left, right] = [&left, &right].map(|pixels| ImageView::new(160, 120, 160, pixels).unwrap());
//!     let view = View { time_ns, left, right, mask: None };
//!     estimates.push(odometry.add_frames(&FrameSet { time_ns, views: vec![Some(view)] }));
//! }
//! let last = estimates[2];
//! assert_eq!((last.status, last.time_ns), (Status::Tracked, 133_333_334));
//! assert!(last.world_from_rig.distance_m() < 0.02, "{}", last.world_from_rig.distance_m());
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The covariance of a pose is that of a small motion of the rig in its own axes: the first three
//! components are metres, the others radians.
//!
//! ```
//! use odometry::{Config, FrameSet, Odometry, Preset, Rig};
//! # use cad_transforms::RigidTransform;
//! # use camera_models::{CameraModel, Distortion};
//! # use odometry::rig::StereoCamera;
//! # let lens = CameraModel::new((160, 120), [100.0, 100.0, 79.5, 59.5], Distortion::None);
//! # let camera = StereoCamera {
//! #     name: "front".to_owned(),
//! #     left: lens,
//! #     right: lens,
//! #     rig_from_left: RigidTransform::identity(),
//! #     covariance: None,
//! #     right_from_left: RigidTransform::from_translation_m([-0.08, 0.0, 0.0])?,
//! #     right_from_left_covariance: None,
//! #     line_s: 0.0,
//! # };
//! # let rig = Rig { cameras: vec![camera], imus: Vec::new() };
//! # let mut odometry = Odometry::new(&rig, Config::preset(Preset::Fast));
//! // The first pose is the origin of the world. Without an IMU its tilt is known only roughly.
//! let first = odometry.add_frames(&FrameSet { time_ns: 0, views: vec![None] });
//! assert_eq!(first.world_from_rig.distance_m(), 0.0);
//! let sigmas: Vec<f64> = first.covariance.diagonal().iter().map(|variance| variance.sqrt()).collect();
//! assert!(sigmas[..3].iter().all(|sigma| *sigma < 0.01), "{sigmas:?} m");
//! assert!(sigmas[3..].iter().any(|sigma| *sigma > 0.1), "{sigmas:?} rad");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod config;
pub mod estimator;
pub mod input;
pub mod keyframe;
pub mod mapping;
pub mod rig;

mod backend;
mod frontend;
mod inertial;
#[cfg(test)]
mod test_rig;

pub use camera_models::ImuSample;
pub use config::{Config, Preset};
pub use estimator::{Estimate, Odometry, Status, camera_shift::CameraShift};
pub use inertial::imu_set::ImuUse;
pub use input::{FrameSet, View};
pub use keyframe::Keyframe;
pub use mapping::{Mapping, MappingResult};
pub use rig::Rig;
