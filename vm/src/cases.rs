//! The test cases.

mod config;
pub mod power_cuts;
mod take;

use crate::case::Case;

/// All of them, in the order in which they run.
pub const ALL: &[Case] = &[take::CASE, power_cuts::CASE];
