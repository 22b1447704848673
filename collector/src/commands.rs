//! The commands of `paws`, one module each.
//!
//! A command returns an [`Outcome`](console_output::Outcome), which becomes the exit code, and
//! writes its results to the [`Console`](console_output::Console) that it is given.

pub mod export;
pub mod handoff;
pub mod import;
pub mod index;
pub mod list;
pub(crate) mod metrics;
pub mod prune;
pub mod pull;
pub mod rebuild;
pub mod recover;
pub mod report;
pub(crate) mod rig;
pub mod show;
pub mod validate;
