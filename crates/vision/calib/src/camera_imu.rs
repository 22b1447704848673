//! Camera–IMU calibration from a recording of a board: extrinsics and time offset.
//!
//! Contract: [`estimate`] takes corners of a board with known lenses and the IMU samples, and
//! returns `imu_from_left`, the time offset, gravity, biases and the nuisance parameters estimated
//! with them, each with a sigma. It needs no initial values: rotation and offset come from angular
//! rates, gravity and lever arm from a linear fit, at any angle. [`Priors`] count as measurements
//! with their sigma, so that parameters which the recording does not determine keep them;
//! [`CameraImu::unobservable`] lists these directions. [`CameraImu::gates`] lists the checks of the
//! result. A result with a failed gate must not be used.
//!
//! The time offset is that of Kalibr: `t_imu = t_camera + offset`, where `t_camera` is mid-exposure
//! and `t_imu` the timestamp of the IMU sample. The delay of the IMU's own filter is part of it.
//! The line time of a rolling shutter must be known ([`Cameras::with_rolling_shutter`]).
//!
//! Frames without a board, IMU gaps and saturated values interrupt the chain of states; the
//! remaining parts are used. Corners and whole views that do not fit are down-weighted or rejected
//! (robust loss).
//!
//! Method and reasons: docs/decisions/0006-camera-imu.md. Same input, same bytes.

mod chain;
mod config;
mod estimate;
mod gates;
mod initialization;
mod noise;
mod observability;
mod preintegrate;
mod problem;
mod recording;
mod result;
pub mod simulate;
mod so3;
#[cfg(test)]
mod tests;
mod track;
mod view;

pub use camera_models::ImuSample;
pub use config::{
    Config, GateConfig, InitializationConfig, NoiseConfig, ObservabilityConfig, SampleConfig,
    SolverConfig, ViewConfig,
};
pub use estimate::estimate;
pub use estimate::reference::{FormulationResult, Formulations};
pub use gates::{Gate, UnobservableDirection, Verdict};
pub use noise::{Noise, NoiseEstimates};
pub use recording::{Cameras, Corner, GRAVITY, Priors, Recording, TargetObservation};
pub use result::{CameraImu, CameraImuError, Residual, Sigmas};
