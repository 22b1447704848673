//! Bundle adjustment of cameras that observe known points: intrinsics, poses of cameras on the rig
//! and of targets in the world, and the pose of the rig at each instant, jointly.
//!
//! Contract: [`solve`] finds the most probable values under the observations and the priors. The
//! Jacobians are analytic; poses of instants are eliminated (Schur complement), so that time grows
//! linearly with the number of observations and with the cube of the number of lenses and fixed
//! poses. A parameter without a prior that the views do not determine gives
//! [`AdjustError::Undetermined`], which names it. The same problem gives the same bits on any
//! number of threads.
//!
//! A point in a target is projected through
//!
//! ```text
//! x_in_eye = eye_from_rig * rig_from_world(instant) * world_from_target * x_in_target
//! ```
//!
//! where `eye_from_rig` is the inverse of a chain of poses `parent_from_child`. A pose is changed
//! by `[v, ω]`: its translation by `v`, its rotation by `Exp(ω)` from the left, both in the axes of
//! the frame it leads to. Covariances have that order, translation first (m, rad).
//!
//! Observations carry their own sigma. Their common scale is estimated with the rest
//! ([`Solution::scale`]), and larger residuals are down-weighted (Huber 1964).

mod config;
mod covariance;
mod locate;
mod normal;
mod pose;
mod problem;
mod scaling;
mod solve;
#[cfg(test)]
pub(crate) mod tests;

pub use config::{Config, LocateConfig};
pub use covariance::Covariance;
pub(crate) use covariance::pose_jacobian;
pub use locate::locate;
pub(crate) use normal::in_chunks;
pub(crate) use pose::step_between;
pub use problem::{
    AdjustError, LensBlock, Parameter, Point, PoseBlock, PosePrior, Prior, Problem, View,
};
pub use solve::{Solution, solve};
pub(crate) use solve::{by_points, median_scale, reduced_equations};
