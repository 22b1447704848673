//! `paws`, on the host: import, validate, index, export and hand over recorded sessions.
//!
//! A *library* is a folder with one folder per session and a catalogue that can be rebuilt from
//! them at any time. Nothing that was recorded is ever changed here: sessions are copied in, derived
//! files (`index.bin`, reports, the hand-off) are written beside the recorded ones and can be
//! deleted, and a damaged session is recovered into a copy of its own.
//!
//! One command or concept per module. A command returns a [`console_output::Outcome`], which becomes the
//! exit code, and writes its results to the [`console_output::Console`] that it is given. Calibration is a program of
//! its own, `paws-calib`.

/// Name and version of this program, as written into output files.
pub const SOFTWARE: &str = concat!("paws ", env!("CARGO_PKG_VERSION"));

pub mod cadence;
mod calibration_check;
mod camera_images;
pub mod catalogue;
pub mod cli;
pub mod commands;
pub mod condition;
pub mod documents;
mod examples;
pub mod external;
mod forwarding;
pub mod ground_truth;
pub mod import;
pub mod library;
pub mod loss;
pub mod plots;
pub mod quality;
pub mod report_page;
pub mod scan_session;
pub mod session_search;
pub mod session_stats;
mod session_validation;
pub mod target;
pub mod validation;
pub mod verdict_change;
