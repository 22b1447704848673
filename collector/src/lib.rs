//! `paws`, on the host: import, validate, index, export and hand over recorded sessions.
//!
//! A *library* is a folder with one folder per session and a catalogue that can be rebuilt from
//! them at any time. Nothing that was recorded is ever changed here: sessions are copied in,
//! derived files (`index.bin`, reports, the hand-off) are written beside the recorded ones and can
//! be deleted, and a damaged session is recovered into a copy of its own.
//!
//! One command or concept per module. A command returns a [`console_output::Outcome`], which
//! becomes the exit code, and writes its results to the [`console_output::Console`] that it is
//! given. Calibration is a program of its own, `paws-calib`.

/// Name and version of this program, as written into output files.
pub const SOFTWARE: &str = concat!("paws ", env!("CARGO_PKG_VERSION"));

mod cadence;
mod calibration_check;
mod camera_images;
pub mod catalogue;
pub mod cli;
pub mod commands;
pub mod condition;
mod derived_files;
mod documents;
mod examples;
mod external;
mod folders;
mod forwarding;
mod ground_truth;
pub mod import;
pub mod library;
mod loss;
mod plots;
mod quality;
pub mod report_page;
pub mod scan_session;
mod session_key;
mod session_search;
pub mod session_stats;
mod session_validation;
pub mod target;
pub mod validation;
mod verdict_change;
