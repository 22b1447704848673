//! `pawsd`: records the rig, on the body.
//!
//! Path of a frame:
//!
//! ```text
//! source ──► inbox ──► hub ─────────────► encoder ──► outbox ──► recorder ──► session-archive
//! (a thread   (bounded  (clock maps, gap   (GStreamer, (bounded   (pre-roll, gate, frame sets,
//!  each)       in bytes) causes, alarms)    own threads) in bytes)  gap records, disk guard)
//! ```
//!
//! Everything but the sources' and GStreamer's threads is plain code that receives samples and
//! times as arguments ([`hub`], [`recorder`]). [`run`] puts it on threads in real time, or calls it
//! in a loop in virtual time, where nothing is ever dropped and the same input gives the same
//! bytes.

pub mod announce;
pub mod check;
pub mod clock;
pub mod config;
pub mod control;
pub mod devices;
mod digest;
mod disk;
pub mod encode;
pub mod encoding;
mod error_chain;
pub mod hub;
mod notify;
pub mod preview;
pub mod queue;
mod realtime_priority;
pub mod recorder;
pub mod run;
pub mod selftest;
pub mod sources;
pub mod status;
pub mod sync;
