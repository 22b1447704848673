//! Why a hand-off is refused, and why something in it cannot be read.

use std::io;
use std::path::PathBuf;
use std::sync::Arc;

use session_archive::handoff::HandOffError;
use session_archive::index::IndexError;
use session_archive::reader::ReadError as SessionError;
use video::{DecodeError, PictureError};

/// Why a hand-off is refused. The path of its session comes last in every message.
#[derive(Debug, thiserror::Error)]
pub enum InputError {
    /// There is no such file or folder, or it cannot be reached.
    #[error("looking for a hand-off in {}", .path.display())]
    Path {
        /// As given.
        path: PathBuf,
        /// What failed.
        #[source]
        error: io::Error,
    },
    /// Missing, not validated, failed and not accepted, edited or changed: validate and hand over again.
    #[error("checking the hand-off of the session {}", .path.display())]
    HandOff {
        /// The session's folder.
        path: PathBuf,
        /// The error.
        #[source]
        error: HandOffError,
    },
    /// A file that reading relies on is not among those that were sealed: hand over again.
    #[error("the hand-off does not seal {file}, which reading relies on: {}", .path.display())]
    NotSealed {
        /// Path below the session's folder.
        file: String,
        /// The session's folder.
        path: PathBuf,
    },
    /// The manifest belongs to another session, or is invalid: hand over again.
    #[error("the hand-off is of session {sealed}, the manifest of {found}: {}", .path.display())]
    OtherSession {
        /// The session that was handed over.
        sealed: String,
        /// The session of the manifest.
        found: String,
        /// The session's folder.
        path: PathBuf,
    },
    /// The session's files cannot be read.
    #[error("reading the session {}", .path.display())]
    Session {
        /// The session's folder.
        path: PathBuf,
        /// What failed.
        #[source]
        error: SessionError,
    },
    /// Written by another version of the programs, or it does not fit: index and hand over again.
    #[error("reading the index of the session {}", .path.display())]
    Index {
        /// The session's folder.
        path: PathBuf,
        /// The error.
        #[source]
        error: IndexError,
    },
    /// Image format that this program does not know: update it.
    #[error("camera {camera} has {what} {found:?}, expected {expected}: {}", .path.display())]
    Unknown {
        /// The camera.
        camera: String,
        /// `codec` or `color`.
        what: &'static str,
        /// The value found.
        found: String,
        /// The values known.
        expected: &'static str,
        /// The session's folder.
        path: PathBuf,
    },
}

/// Why an item of an accepted hand-off cannot be read. Other parts of it may be intact: reading
/// other items, or the next one, is allowed.
#[derive(Clone, Debug, thiserror::Error)]
pub enum ReadError {
    /// The session has no camera or IMU of this name: a defect of the caller.
    #[error("the session has no camera or IMU {0:?}")]
    NoSuch(String),
    /// One frame is lost.
    #[error("reading frame {number} of {camera}")]
    Frame {
        /// The camera.
        camera: Arc<str>,
        /// The frame.
        number: u64,
        /// Why.
        #[source]
        fault: FrameFault,
    },
    /// One batch of IMU samples is lost.
    #[error("reading samples {first} to {last} of {imu}")]
    Imu {
        /// The IMU.
        imu: String,
        /// Number of the first sample of the batch.
        first: u64,
        /// Number of the last sample of the batch.
        last: u64,
        /// Why.
        #[source]
        fault: ImuFault,
    },
    /// The machine is out of threads: stop something else and try again.
    #[error("starting a thread")]
    Thread(#[source] Arc<io::Error>),
}

/// Why a frame cannot be read.
#[derive(Clone, Debug, thiserror::Error)]
pub enum FrameFault {
    /// Its bytes, or those of a frame that it depends on, changed since the hand-off was checked,
    /// or reading fails: open the hand-off again.
    #[error("reading its bytes")]
    Bytes(#[source] Arc<IndexError>),
    /// The decoder failed on the whole GOP. On another machine it may not.
    #[error("decoding it")]
    Decoder(#[source] DecodeError),
    /// The decoder returned the images around it but not this one: it is lost.
    #[error("the decoder returned no image for it")]
    NoImage,
    /// The size of the decoded image differs from the manifest.
    #[error("it is {found_width}x{found_height}, the manifest says {width}x{height}")]
    Size {
        /// Columns found.
        found_width: u32,
        /// Rows found.
        found_height: u32,
        /// Columns in the manifest.
        width: u32,
        /// Rows in the manifest.
        height: u32,
    },
    /// The decoded image cannot be split in two.
    #[error("cutting it into left and right")]
    Image(#[source] PictureError),
    /// The decoding thread ended before this frame: a defect of this program.
    #[error("its decoding thread ended early")]
    Ended,
}

/// Why a batch of IMU samples cannot be read.
#[derive(Clone, Debug, thiserror::Error)]
pub enum ImuFault {
    /// Its bytes changed since the hand-off was checked, or reading fails: open it again.
    #[error("reading their bytes")]
    Bytes(#[source] Arc<IndexError>),
    /// The record contradicts itself.
    #[error("{found} {what} for {samples} samples")]
    Lengths {
        /// Name of the values.
        what: &'static str,
        /// Their number.
        found: usize,
        /// Number of samples of the batch.
        samples: usize,
    },
}
