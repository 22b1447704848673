//! `paws`, on the host: import, validate, index, export and hand over recorded sessions.
//!
//! A *library* is a folder with one folder per session and a catalogue that can be rebuilt from
//! them at any time. Nothing that was recorded is ever changed here: sessions are copied in, derived
//! files (`index.bin`, reports, the hand-off) are written beside the recorded ones and can be
//! deleted, and a damaged session is recovered into a copy of its own.
//!
//! One command or concept per module. A command returns an [`outcome::Outcome`], which becomes the
//! exit code, and writes its results to the [`console::Console`] that it is given.

/// Name and version of this program, as written into output files.
pub const SOFTWARE: &str = concat!("paws ", env!("CARGO_PKG_VERSION"));

pub mod cadence;
mod camera_images;
pub mod catalogue;
pub mod cli;
pub mod commands;
pub mod condition;
pub mod console;
pub mod decode_check;
pub mod documents;
mod examples;
pub mod external;
pub mod frame_tree;
pub mod ground_truth;
pub mod import;
pub mod library;
pub mod limits;
pub mod loss;
pub mod outcome;
pub mod plots;
pub mod progress;
pub mod quality;
pub mod report_page;
pub mod scan_session;
pub mod session_search;
pub mod session_stats;
pub mod target;
pub mod text;
pub mod validation;
pub mod verdict_change;
