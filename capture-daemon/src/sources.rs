//! Where pictures and IMU samples come from.

pub mod datasets;
