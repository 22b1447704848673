//! capture-daemon

pub mod sources;
pub mod sync;
