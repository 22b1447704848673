//! Tests of `paws-calib` on simulated sessions, through the program.

mod arguments;
mod cameras;
mod imu_noise;
mod rendered;
mod verify;
