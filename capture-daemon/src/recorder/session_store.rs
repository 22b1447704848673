//! What the recorder needs of its machine: folders for sessions, free space, readings.

use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use machine::ladder::Pressure;
use session_archive::storage::Storage;
use session_archive::time::{CivilTime, HostTime};

use crate::status::MachineStatus;

/// Storage of sessions.
pub trait SessionStore: Send {
    /// Creates an empty folder for a session that began at this time, and an identifier for it.
    ///
    /// # Errors
    /// Any I/O error of the underlying file system.
    fn create(&mut self, started: CivilTime) -> io::Result<(PathBuf, Arc<dyn Storage>, String)>;

    /// Deletes a session's folder.
    ///
    /// # Errors
    /// Any I/O error of the underlying file system.
    fn discard(&mut self, path: &Path) -> io::Result<()>;

    /// Whether a session's folder still exists.
    fn is_there(&self, path: &Path) -> bool;

    /// Free space, bytes.
    fn free_bytes(&self) -> Option<u64>;

    /// State of the machine; called once a second. `recording`: the disk is being filled by a
    /// recording.
    fn machine(&mut self, now: HostTime, recording: bool) -> MachineReading;
}

/// One reading of the machine's state.
#[derive(Clone, Debug, Default)]
pub struct MachineReading {
    /// For records, page and terminal.
    pub status: MachineStatus,
    /// Input of the degradation ladder.
    pub pressure: Pressure,
    /// Events of its clocks.
    pub events: Vec<String>,
}
