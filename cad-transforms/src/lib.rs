//! Contract 2: the poses of sensors and parts on the rig.
//!
//! A [`Frame`] is a named coordinate frame, a [`RigidTransform`] takes points from one frame to
//! another, and a [`Rig`] is the tree of fixed transforms of one build of the chest plate, read
//! from a TOML file.
//!
//! Conventions, which every other crate follows:
//!
//! - A transform is named `b_from_a`: it takes coordinates in frame `a` to coordinates in frame
//!   `b`. Points are named `x_in_b`. Chains read right to left, `c_from_a = c_from_b * b_from_a`.
//! - `rig` is the body frame: x forward, y left, z up (REP-103), origin at the CAD datum of the
//!   plate. `NAME/left` and `NAME/right` are optical frames: x right, y down, z forward. `NAME/imu`
//!   is the frame in which that camera's IMU reports. `world` has z up along gravity.
//! - Metres and radians, `f64`. Rotations are unit quaternions, Hamilton convention, stored
//!   `w x y z`.
//!
//! This crate knows nothing of images, sessions or calibration of lenses.

pub mod cad;
pub mod covariance;
pub mod frame;
pub mod output;
pub mod rig;
pub mod so3;
pub mod transform;
pub mod view;

pub use covariance::{Covariance, CovarianceError};
pub use frame::{Frame, FrameError, FramePart};
pub use rig::{Edge, Provenance, ProvenanceKind, Rig, RigError};
pub use transform::{RigidTransform, TransformError};
pub use view::FieldOfView;
