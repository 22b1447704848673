//! session-archive

pub mod time;
