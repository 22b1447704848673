//! A hand-off, opened for reading.
//!
//! Contract. Opening checks the seal, the verdict and every byte that was sealed, and refuses a
//! session that is missing, failed its validation without being accepted, was edited or changed
//! ([`InputError`]); [`Input::notes`] lists what was accepted. Images and samples come from
//! [`Input::session`]: frame sets in order of time, frames in order of their numbers, and by number
//! or time; their bytes are checked once more as they are read, against the checksums of the sealed
//! index.

use std::path::{Path, PathBuf};

use session_archive::handoff::HandOff;
use session_archive::index::Index;
use session_archive::manifest::Manifest;
use session_archive::record::{CameraCalibration, ClockMap, FrameTransform};
use session_input::Session;

mod error;
mod judgement;
mod open;
mod state;

pub use error::InputError;
pub use session_archive::handoff::Check;

use state::State;

/// Name of the hand-off among the inputs of stages; its hash is its seal.
pub const HANDOFF: &str = "handoff";

/// A hand-off that was accepted.
#[derive(Debug)]
pub struct Input {
    root: PathBuf,
    handoff: HandOff,
    notes: Vec<String>,
    manifest: Manifest,
    state: State,
    session: Session,
}

impl Input {
    /// Opens the hand-off in a session's folder after checking every byte of it. `path` is the
    /// folder or the `handoff.json` in it.
    ///
    /// # Errors
    /// See [`InputError`].
    pub fn open(path: &Path) -> Result<Self, InputError> {
        Self::open_with(path, Check::Content, |_, _| {})
    }

    /// The session's folder; the rig's files are in it.
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The hand-off: sealed files, program, verdict.
    pub fn handoff(&self) -> &HandOff {
        &self.handoff
    }

    /// The session's manifest: cameras and IMUs in the order that everything here follows.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Index: numbers and times of all frames, IMU batches and frame sets.
    pub fn index(&self) -> &Index {
        self.session.index()
    }

    /// The session's frames, frame sets and IMU samples.
    pub fn session(&self) -> &Session {
        &self.session
    }

    /// Calibration of one side, as in `feet/left`; `None` if the session has none.
    pub fn calibration(&self, eye: &str) -> Option<&CameraCalibration> {
        self.state.calibrations.get(eye)
    }

    /// Recorded extrinsics, each `parent_from_child`; empty if the session has none.
    pub fn transforms(&self) -> &[FrameTransform] {
        &self.state.transforms
    }

    /// How the ticks of a device clock, as in `feet` or `feet/imu`, became times: maps by rising
    /// version, the newest last. Of versions that were replaced between two segments only one is
    /// here.
    pub fn clock_maps(&self, clock: &str) -> &[ClockMap] {
        self.state.clock_maps.get(clock).map_or(&[], Vec::as_slice)
    }
}
