//! Calibration of lenses, stereo cameras, IMUs and the rig: detection of targets, and estimation.
//!
//! Images, samples and models ([`camera_models`]) come in as plain data, results go out as plain
//! data. [`target`] finds boards in images, [`cameras`] calibrates intrinsics and extrinsics from
//! them, [`camera_imu`] the IMU, [`imu_noise`] its noise; [`verify`] checks a calibration from an
//! ordinary recording.
//!
//! This crate knows nothing of files, devices, sessions or the catalogue.

pub mod adjust;
pub mod allan;
pub mod camera_imu;
pub mod cameras;
pub mod epipolar;
pub mod imu_noise;
pub mod pnp;
pub mod target;
pub mod verify;

#[cfg(test)]
mod test_data;
