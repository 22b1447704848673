//! Why a session cannot be read, and why something in it cannot.

use std::io;
use std::sync::Arc;

use session_archive::index::IndexError;
use video::{DecodeError, RawImageError};

use crate::imu::LengthMismatch;

/// Why a session cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// The index does not fit the session, or a segment cannot be opened: index again.
    #[error(transparent)]
    Index(#[from] IndexError),
    /// Image format that this program does not know: update it.
    #[error("camera {camera} has {what} {found:?}, expected {expected}")]
    Format {
        /// The camera.
        camera: String,
        /// `codec` or `colour`.
        what: &'static str,
        /// The value found.
        found: String,
        /// The values known.
        expected: &'static str,
    },
}

/// Why an item of a session cannot be read. Other parts of it may be intact: reading other items,
/// or the next one, is allowed.
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
    /// Its bytes, or those of a frame that it depends on, changed since the session was checked,
    /// or reading fails: open the session again.
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
    Image(#[source] RawImageError),
    /// The decoding thread ended before this frame: a defect of this program.
    #[error("its decoding thread ended early")]
    Ended,
}

/// Why a batch of IMU samples cannot be read.
#[derive(Clone, Debug, thiserror::Error)]
pub enum ImuFault {
    /// Its bytes changed since the session was checked, or reading fails: open it again.
    #[error("reading their bytes")]
    Bytes(#[source] Arc<IndexError>),
    /// The record contradicts itself.
    #[error(transparent)]
    Lengths(#[from] LengthMismatch),
}
