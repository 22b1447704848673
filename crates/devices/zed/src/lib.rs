//! ZED cameras over USB: what Stereolabs' USB cameras have that other cameras do not.
//!
//! A ZED Mini is two USB devices: a camera, which any V4L2 program can read, and a microcontroller
//! with an IMU, which speaks HID. This crate drives the second one, and estimates the relation of
//! their clocks:
//!
//! * [`report`], [`command`]: the microcontroller's bytes, pure;
//! * [`number`]: numbers for samples that come without one, so that a lost one is seen;
//! * [`imu`]: the driver: start, keep alive, watch, restart, reopen;
//! * [`frame_sync`]: the relation of the IMU's clock to the camera's, from frame-sync flags;
//! * [`camera`]: modes, USB identities, settings, serial number, the switch of frame sync.
//!
//! Time comes in as an argument everywhere, in nanoseconds of CLOCK_MONOTONIC.
//!
//! `cargo run -p zed --example zed_imu_check -- 10` checks the IMU of a camera for ten seconds.
//!
//! Nothing here was ever run on a real camera. What it is tested on: recorded facts of the
//! protocol, a simulated device in this process, and one behind the kernel's own HID drivers in a
//! virtual machine.

pub mod camera;
pub mod command;
pub mod frame_sync;
pub mod imu;
pub mod number;
pub mod report;
