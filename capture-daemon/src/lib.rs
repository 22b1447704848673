//! capture-daemon

pub mod sources;
