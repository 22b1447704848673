//! The test cases.

mod config;
pub mod cost;
mod devices;
mod drivers;
mod faults;
pub mod power_cuts;

use crate::case::Case;

/// All of them, in the order in which they run.
pub fn all() -> impl Iterator<Item = &'static Case> {
    WHOLE.iter().chain(&faults::CASES)
}

const WHOLE: [Case; 8] = [
    drivers::CASE,
    devices::DEVICES,
    devices::GOLDEN,
    devices::PAIR,
    devices::SOAK,
    devices::REAL_TIME,
    cost::CASE,
    power_cuts::CASE,
];
