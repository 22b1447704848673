//! `paws`, on the host: import, validate, index, export and hand over recorded sessions.
//!
//! A *library* is a folder with one folder per session and a catalogue that can be rebuilt from
//! them at any time. Nothing that was recorded is ever changed here: sessions are copied in, derived
//! files (`index.bin`, reports, the hand-off) are written beside the recorded ones and can be
//! deleted, and a damaged session is recovered into a copy of its own.
//!
//! One verb or concept per module. A verb returns an [`outcome::Outcome`], which becomes the exit
//! code; what it has to say goes to the [`console::Console`] that it is given.

/// What wrote a file, in the files that say so.
pub const SOFTWARE: &str = concat!("paws ", env!("CARGO_PKG_VERSION"));

pub mod cadence;
pub mod calibrate;
pub mod catalogue;
pub mod change;
pub mod cli;
pub mod condition;
pub mod console;
pub mod deep;
pub mod documents;
pub mod examine;
mod examples;
pub mod export;
pub mod external;
pub mod facts;
pub mod find;
pub mod frames;
pub mod handoff;
pub mod import;
pub mod importing;
pub mod indexing;
pub mod library;
pub mod limits;
pub mod list;
pub mod loss;
pub mod metrics;
pub mod outcome;
pub mod page;
pub mod plots;
pub mod progress;
pub mod prune;
pub mod pull;
pub mod quality;
pub mod rebuild;
pub mod recover;
pub mod reporting;
pub mod rig;
mod seen;
pub mod show;
pub mod target;
pub mod text;
pub mod truth;
pub mod validate;
pub mod validation;
