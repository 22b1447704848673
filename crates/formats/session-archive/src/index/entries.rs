//! The entries of an index.

use std::io;
use std::ops::Range;

use bincode::{Decode, Encode};

/// Where one access unit is, and what is known of its frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Encode, Decode)]
pub struct FrameEntry {
    /// Number in the camera's stream.
    pub number: u64,
    /// Middle of the exposure, host clock, ns.
    pub time_ns: i64,
    /// One standard deviation of it, ns.
    pub sigma_ns: u64,
    /// Whether the time is not to be trusted within its sigma.
    pub time_unreliable: bool,
    /// When the daemon received it, host clock, ns.
    pub host_time_ns: i64,
    /// Device clock.
    pub device_ticks: i64,
    /// Exposure where the device reports it, ns.
    pub exposure_ns: Option<u32>,
    /// Position in [`CameraIndex::frames`] of the key frame that decoding has to start from.
    pub key: u32,
    /// Segment.
    pub segment: u32,
    /// First byte of the access unit in the segment's file.
    pub offset: u64,
    /// Length of the access unit.
    pub bytes: u32,
    /// CRC-32 of the access unit.
    pub crc32: u32,
}

/// The frames of one camera, by number.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode)]
pub struct CameraIndex {
    /// The camera.
    pub name: String,
    /// Its frames that can be decoded, by number.
    pub frames: Vec<FrameEntry>,
    /// Frames that are there but cannot be decoded, because their key frame is missing.
    pub undecodable: u64,
}

/// Where one IMU batch is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Encode, Decode)]
pub struct BatchEntry {
    /// Number of the first sample.
    pub first_number: u64,
    /// Samples.
    pub samples: u32,
    /// Time of the first sample, host clock, ns.
    pub start_ns: i64,
    /// Time of the last sample, host clock, ns.
    pub end_ns: i64,
    /// Segment.
    pub segment: u32,
    /// First byte of the message's payload in the segment's file.
    pub offset: u64,
    /// Length of the payload.
    pub bytes: u32,
    /// CRC-32 of the payload.
    pub crc32: u32,
}

/// The batches of one IMU, by number.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode)]
pub struct ImuIndex {
    /// The IMU.
    pub name: String,
    /// Its batches.
    pub batches: Vec<BatchEntry>,
}

/// One frame set.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode)]
pub struct SetEntry {
    /// Number of the set.
    pub number: u64,
    /// Its time, host clock, ns.
    pub time_ns: i64,
    /// For each camera of [`Index::cameras`], position of its frame, if it has one here.
    pub frames: Vec<Option<u32>>,
}

/// The index of a session.
#[derive(Clone, Debug, PartialEq, Eq, Encode, Decode)]
pub struct Index {
    /// The session.
    pub session_id: String,
    /// Length of each segment's file when the index was built.
    pub segments: Vec<(u32, u64)>,
    /// In the order of the manifest.
    pub cameras: Vec<CameraIndex>,
    /// In the order of the manifest.
    pub imus: Vec<ImuIndex>,
    /// By time.
    pub sets: Vec<SetEntry>,
    /// Damaged ranges and missing segments: what was in them is not here.
    pub damaged: u64,
}

/// Why an index, or what it points to, cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum IndexError {
    /// The index is absent, or the file system reports an I/O error: build it.
    #[error("reading the index")]
    Io(#[from] io::Error),
    /// The file is no index of this version, or damaged: build it again.
    #[error("the index cannot be read: {0}")]
    Unreadable(String),
    /// The session is not the one that was indexed: build it again.
    #[error("the index does not belong to this session: {0}")]
    Stale(String),
    /// What lies where the index points is not what was indexed: the session changed or is damaged.
    #[error("segment {segment}, byte {offset}: the content does not match its checksum")]
    Mismatch {
        /// The segment.
        segment: u32,
        /// Where in its file.
        offset: u64,
    },
}

impl CameraIndex {
    /// The frame with this number.
    pub fn frame(&self, number: u64) -> Option<&FrameEntry> {
        self.position(number).map(|i| &self.frames[i])
    }

    /// Position of the frame with this number.
    pub fn position(&self, number: u64) -> Option<usize> {
        self.frames.binary_search_by_key(&number, |f| f.number).ok()
    }

    /// Positions of all frames that share the key frame of the one at `position`.
    ///
    /// ```
    /// # use std::sync::Arc;
    /// # use session_archive::index::Index;
    /// # use session_archive::reader::SessionReader;
    /// # use session_archive::storage::DiskStorage;
    /// # let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/v1");
    /// # let reader = SessionReader::open(Arc::new(DiskStorage::new(folder)))?;
    /// # let index = Index::build(&reader, |_| {})?;
    /// // A camera with 20 frames in a second, and a key frame first in each half of it.
    /// let camera = index.camera("feet").ok_or("no such camera")?;
    /// let position = camera.position(112).ok_or("no frame 112")?;
    /// // To decode frame 112, start with the key frame of its group.
    /// let group = camera.gop(position);
    /// assert_eq!(group, 10..20);
    /// assert_eq!(camera.frames[position].key as usize, group.start);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn gop(&self, position: usize) -> Range<usize> {
        let Some(frame) = self.frames.get(position) else {
            return 0..0;
        };
        let start = frame.key as usize;
        let length = self.frames[start..].partition_point(|f| f.key == frame.key);
        start..start + length
    }
}
