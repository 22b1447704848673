//! Button, light and beeper: control and status for a person without a screen.
//!
//! Two halves that know nothing of one another, nor of recording:
//!
//! - **In**: a [`button`] gives edges with their times, a [`button_commands::Gesture`] makes
//!   commands of them, and a [`listener::Listener`] does both on a thread, through unplugging and
//!   return.
//! - **Out**: the state to show is a [`signal::Signal`]; a [`pattern`] says how it blinks and
//!   beeps; a [`panel::Panel`] shows it on every [`light`] and [`beeper`].
//!
//! What each light means, to print: [`table`], and `docs/reference/led-table.md` that is made from
//! it. Which devices a machine has: [`inventory`].
//!
//! Contract: nothing here stops a recording or waits for one. A command is reported once, with the
//! time of the press that began it. A button that goes away is reported and waited for; a light
//! that fails is logged once and tried again. Times are integer nanoseconds on CLOCK_MONOTONIC and
//! come in from a [`Clock`].
//!
//! Run in a virtual machine on the kernel's simulated GPIO lines and input devices; never yet on
//! the pins of a Jetson.

use std::sync::Arc;

pub mod beeper;
pub mod button;
pub mod button_commands;
mod error;
mod gpio;
pub mod inventory;
pub mod light;
pub mod listener;
pub mod panel;
pub mod pattern;
pub mod signal;
pub mod spec;
pub mod table;
mod wait;

pub use error::DeviceError;
pub use wait::Waker;

/// Now on CLOCK_MONOTONIC, nanoseconds. Handed in, so that tests run on a time of their own.
pub type Clock = Arc<dyn Fn() -> i64 + Send + Sync>;

/// Nanoseconds in a millisecond.
pub(crate) const NS_PER_MS: i64 = 1_000_000;
