//! IMU: sample buffer, preintegration and propagation.

pub(crate) mod imu_buffer;
pub(crate) mod imu_set;
pub(crate) mod propagation;
