//! Parameters of a session, its limits, and the reports of its writer.

use std::io;

use crate::manifest::{Camera, Imu};
use crate::record::Gap;
use crate::time::{CivilTime, HostTime};

/// Default chunk length: what a power cut may take, plus how far the cameras lag each other.
pub const DEFAULT_CHUNK_NS: i64 = 500_000_000;
/// No message waits longer than this for its chunk to be closed.
pub const MAX_CHUNK_NS: i64 = 1_000_000_000;
/// A chunk is closed early at this size; no record may be larger.
pub const MAX_CHUNK_BYTES: usize = 32 << 20;
/// A segment spans at most this much log time.
pub const MAX_SEGMENT_NS: i64 = 60_000_000_000;
/// A segment has at most this many bytes (and the summary).
pub const MAX_SEGMENT_BYTES: u64 = 512 << 20;

/// MCAP profile of the segments.
pub const PROFILE: &str = "paws";
/// MCAP library string of the segments.
pub const LIBRARY: &str = concat!("session-archive ", env!("CARGO_PKG_VERSION"));

/// Parameters of a session.
///
/// ```
/// # use session_archive::manifest::Imu;
/// # use session_archive::record::ImuBatch;
/// # use session_archive::storage::FaultStorage;
/// use session_archive::time::{CivilTime, HostTime, TickLength};
/// use session_archive::writer::{DEFAULT_CHUNK_NS, SessionSpec, SessionWriter};
///
/// # let imu = Imu {
/// #     name: "feet/imu".to_owned(),
/// #     rate_hz: 200.0,
/// #     tick: TickLength::ZED_MINI,
/// #     source: "example".to_owned(),
/// #     noise: None,
/// # };
/// let spec = SessionSpec {
///     session_id: "0192aa00-0000-7000-8000-00000000000b".to_owned(),
///     name: "stairs".to_owned(),
///     software: "example 1.0".to_owned(),
///     started: HostTime(5_000_000_000),
///     started_civil: CivilTime(1_790_000_000_000_000_000),
///     chunk_ns: DEFAULT_CHUNK_NS,
///     cameras: Vec::new(),
///     imus: vec![imu],
///     rig: vec![("rig.toml".to_owned(), b"revision = 1\n".to_vec())],
/// };
/// let writer = SessionWriter::create(std::sync::Arc::new(FaultStorage::new()), spec)?;
/// assert_eq!(writer.manifest().rig[0].bytes, 13);
/// let stream = writer.manifest().stream::<ImuBatch>("feet/imu");
/// assert_eq!(stream.map(|s| s.topic.as_str()), Some("/feet/imu/samples"));
/// # Ok::<(), session_archive::writer::WriteError>(())
/// ```
#[derive(Clone, Debug)]
pub struct SessionSpec {
    /// A UUID.
    pub session_id: String,
    /// Given by the user; may be empty.
    pub name: String,
    /// The recording software.
    pub software: String,
    /// When recording begins.
    pub started: HostTime,
    /// The same instant in civil time.
    pub started_civil: CivilTime,
    /// Chunk length aimed at, ns; at most [`MAX_CHUNK_NS`].
    pub chunk_ns: i64,
    /// The cameras.
    pub cameras: Vec<Camera>,
    /// The IMUs.
    pub imus: Vec<Imu>,
    /// Name and content of the files to keep in `rig/`.
    pub rig: Vec<(String, Vec<u8>)>,
}

/// A failure that the writer has recovered from.
#[derive(Debug)]
pub struct Incident {
    /// The segment that was given up.
    pub segment: u32,
    /// What failed.
    pub error: io::Error,
    /// What is lost by it; empty if the chunk could be written elsewhere.
    pub lost: Vec<Gap>,
}

/// Why a message was not taken.
///
/// A message of a stream that the session does not have is a defect of the caller:
///
/// ```
/// use session_archive::record::Frame;
/// use session_archive::time::HostTime;
/// # use session_archive::time::CivilTime;
/// # let spec = session_archive::writer::SessionSpec {
/// #     session_id: "0192aa00-0000-7000-8000-00000000000c".to_owned(),
/// #     name: String::new(),
/// #     software: "example".to_owned(),
/// #     started: HostTime(0),
/// #     started_civil: CivilTime(0),
/// #     chunk_ns: 500_000_000,
/// #     cameras: Vec::new(),
/// #     imus: Vec::new(),
/// #     rig: Vec::new(),
/// # };
/// # let storage = std::sync::Arc::new(session_archive::storage::FaultStorage::new());
/// # let mut writer = session_archive::writer::SessionWriter::create(storage, spec).unwrap();
/// let refused = writer.append("feet", HostTime(5), HostTime(5), &Frame::default()).unwrap_err();
/// assert_eq!(refused.to_string(), "the session has no stream paws.Frame of \"feet\"");
/// let refused = writer.append_frame("feet", Frame::default(), b"access unit", true).unwrap_err();
/// assert_eq!(refused.to_string(), "the session has no stream camera \"feet\"");
/// ```
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// The disk failed for good; what
    /// [`SessionWriter::durability`](super::SessionWriter::durability) says is on disk remains
    /// valid. Close the writer and tell the user.
    #[error("writing segment {segment} failed, and so did every new one")]
    Storage {
        /// The last segment that was tried.
        segment: u32,
        /// What failed.
        #[source]
        error: io::Error,
    },
    /// The session cannot be created: choose another folder or free the disk.
    #[error("creating the session")]
    Create(#[source] io::Error),
    /// A message with a negative time: a defect of the caller.
    #[error("log time {0} is before the host clock's zero")]
    NegativeTime(HostTime),
    /// A stream that the session does not have: a defect of the caller.
    #[error("the session has no stream {0}")]
    UnknownStream(String),
    /// A record larger than a chunk may be: a defect of the caller.
    #[error("a record of {0} bytes; at most {MAX_CHUNK_BYTES} fit into a chunk")]
    TooLarge(usize),
    /// The disk failed for good before, or the session is closed.
    #[error("this writer is finished: the disk failed before, or the session is closed")]
    Finished,
}
