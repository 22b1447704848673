//! Random numbers of the simulation, and their streams.

pub use counter_random::{bell, bits, exponential, uniform};

/// Streams of random numbers by purpose.
pub(crate) const TEXTURE: u64 = 0x100;
pub(crate) const SCENE: u64 = 0x600;
pub(crate) const WALK: u64 = 0x700;
pub(crate) const SENSOR: u64 = 0x800;
pub(crate) const IMU: u64 = 0x900;
pub(crate) const FAULT: u64 = 0xa00;
pub(crate) const DEVICE: u64 = 0xb00;
