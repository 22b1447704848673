//! State of the machine: heat, power, disk, clocks; and the measures when they become scarce.
//!
//! Each module is in two halves. One reads: it takes [`Roots`] or a path, may wait for a slow
//! sensor or disk (so call it from a thread that may), keeps nothing, and never fails for a sensor
//! that is absent, only reports less. The other judges: it takes what was read and the time,
//! remembers what it must, and has no other input. So a laptop, a Jetson and a machine that reports
//! nothing are all folders in a test, and an hour of heat takes a millisecond.
//!
//! [`thermal`], [`battery`], [`disk`] and [`clock`] report the state, [`ladder`] turns the first
//! three into measures, [`realtime`] asks the kernel for what a recorder needs.
//! `cargo run -p machine --example machine_check` prints all of it.
//!
//! Times are integer nanoseconds on `CLOCK_MONOTONIC`. **Nothing here has run on a Jetson**: its
//! sensors are known from the vendor's guide and from what its users have published, and are
//! imitated in tests.

pub mod battery;
pub mod clock;
pub mod disk;
pub mod ladder;
pub mod realtime;
mod sysfs;
pub mod thermal;

pub use sysfs::Roots;

/// Nanoseconds of a second.
pub const NS_PER_S: i64 = 1_000_000_000;
