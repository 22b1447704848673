//! Contract 1: what was recorded and when.
//!
//! A session is a folder: a manifest, the rig's files, and segments in MCAP, each readable alone.
//! `FORMAT.md` beside this crate is the contract; the crate is its writer, reader, verifier and
//! recovery. It knows nothing of devices, video codecs or catalogues.

pub mod handoff;
pub mod index;
pub mod layout;
pub mod manifest;
pub mod mcap;
pub mod reader;
pub mod record;
pub mod recover;
pub mod scan;
pub mod storage;
pub mod text;
pub mod time;
pub mod verify;
pub mod writer;
