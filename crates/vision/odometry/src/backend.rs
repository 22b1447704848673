//! Back end: states, factors and the least squares problem of the sliding window.

pub(crate) mod covariance;
pub(crate) mod extrinsics;
pub(crate) mod gyro_scale;
pub(crate) mod heading_drift;
pub(crate) mod landmark_elimination;
pub(crate) mod marginalization;
pub(crate) mod motion_factor;
pub(crate) mod newest_pose;
pub(crate) mod observation;
pub(crate) mod reprojection;
pub(crate) mod solver;
pub(crate) mod state;
pub(crate) mod stereo;
pub(crate) mod window;
