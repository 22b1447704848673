//! A simulated chest rig with exact ground truth.
//!
//! A person walks through a scene with three stereo cameras and their IMUs on the chest. The sensor
//! data is rendered, and every quantity that later code estimates is known exactly.
//!
//! Data flow: [`scene`] (geometry, light, a route) → [`walker`] (poses of rig and feet) →
//! [`camera`] (images and their ground truth) and IMU samples. [`simulation`] combines them;
//! [`render`] and [`preview`] write the results. Everything is a function of names and a seed:
//! nothing is loaded, no clock is read, and the same seed gives the same bytes on any machine.

pub mod calibration_error;
pub mod camera;
pub mod device;
pub mod faults;
pub mod film;
pub mod imu;
pub mod lens;
mod png_file;
pub mod preview;
pub mod random;
pub mod render;
pub mod rig;
pub mod scene;
pub mod simulation;
pub mod spline;
pub mod targets;
pub mod walker;
