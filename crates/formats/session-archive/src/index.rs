//! The derived index of a session: where every frame, IMU batch and frame set is.
//!
//! It is built by one pass over the session and can be deleted at any time. Looking something up
//! takes a binary search in memory and one read; what is read is checked against the frame's own
//! CRC-32, so a session that changed under its index is noticed.
//!
//! On disk it is bincode in zstd behind a CRC-32. That format may change with any version of this
//! crate: an index that cannot be read is built again (`docs/decisions/0003-derived-index.md`).

use std::io;

use crate::layout;
use crate::reader::{Entry, ReadError, SessionReader};
use crate::time::HostTime;

mod access;
mod build;
mod entries;

pub use access::Access;
pub use entries::*;

use build::{Build, segment_lengths};

const MAGIC: [u8; 8] = *b"PAWSIDX3";
/// No index is larger than this once unpacked; three cameras at 30 Hz take 0.6 GB in a whole day.
const UNPACKED_LIMIT: usize = 1 << 30;
/// The least that a decoded index may take: every index of an hour's walk takes less.
const SMALL: usize = 16 << 20;
/// A limit between the two.
const MIDDLE: usize = 256 << 20;
/// An entry takes at most this many times the bytes in memory that it takes unpacked: a camera
/// without frames, 56 bytes for 3, is the worst.
const GROWTH: usize = 20;

impl Index {
    /// Builds the index by one pass; `progress` is called with the bytes of each message read.
    /// Damaged parts are left out and counted.
    ///
    /// # Errors
    /// The file system reports an I/O error.
    ///
    /// ```
    /// use std::sync::Arc;
    ///
    /// use session_archive::index::{Access, Index};
    /// use session_archive::reader::SessionReader;
    /// use session_archive::storage::DiskStorage;
    ///
    /// # let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/v1");
    /// let reader = SessionReader::open(Arc::new(DiskStorage::new(folder)))?;
    /// let index = Index::build(&reader, |_| {})?;
    /// assert_eq!((index.cameras.len(), index.damaged), (2, 0));
    ///
    /// // The second batch of the IMU: 20 samples from number 20 on, read by themselves and checked.
    /// let batch = &index.imu("feet/imu").ok_or("no such IMU")?.batches[1];
    /// assert_eq!((batch.first_number, batch.samples), (20, 20));
    /// let samples = Access::open(&**reader.storage(), &index)?.batch(batch)?;
    /// assert_eq!(samples.times.len(), 20);
    /// assert_eq!(samples.times[0], batch.start_ns);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn build(reader: &SessionReader, mut progress: impl FnMut(u64)) -> Result<Self, ReadError> {
        let mut build = Build::new(reader)?;
        for entry in reader.entries() {
            match entry? {
                Entry::Message(m) => {
                    progress(m.data.len() as u64);
                    build.message(&m);
                }
                // What follows may refer to frames that are lost, until the next key frame.
                Entry::Damage { .. } | Entry::SegmentMissing { .. } => {
                    build.key.fill(None);
                    build.index.damaged += 1;
                }
                Entry::SegmentEnd { .. } => {}
            }
        }
        Ok(build.finish())
    }

    /// The index as the bytes of `index.bin`.
    ///
    /// # Errors
    /// Memory is exhausted.
    pub fn to_bytes(&self) -> io::Result<Vec<u8>> {
        let plain =
            bincode::encode_to_vec(self, bincode::config::standard()).map_err(io::Error::other)?;
        let packed = zstd::bulk::compress(&plain, 1)?;
        let mut out = MAGIC.to_vec();
        out.extend(crc32fast::hash(&packed).to_le_bytes());
        out.extend((plain.len() as u64).to_le_bytes());
        out.extend(packed);
        Ok(out)
    }

    /// The index in the bytes of `index.bin`.
    ///
    /// # Errors
    /// [`IndexError::Unreadable`].
    ///
    /// ```
    /// use session_archive::index::Index;
    ///
    /// let index = Index {
    ///     session_id: "0192aa00".to_owned(),
    ///     segments: vec![(0, 4096)],
    ///     cameras: Vec::new(),
    ///     imus: Vec::new(),
    ///     sets: Vec::new(),
    ///     damaged: 0,
    /// };
    /// let mut bytes = index.to_bytes()?;
    /// assert_eq!(Index::from_bytes(&bytes)?, index);
    ///
    /// *bytes.last_mut().unwrap() ^= 1;
    /// let error = Index::from_bytes(&bytes).unwrap_err();
    /// assert_eq!(error.to_string(), "the index cannot be read: its checksum does not match");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, IndexError> {
        let unreadable = |what: &str| IndexError::Unreadable(what.to_owned());
        let header = MAGIC.len() + 12;
        if bytes.len() < header || bytes[..8] != MAGIC {
            return Err(unreadable("it is no index of this version"));
        }
        let packed = &bytes[header..];
        if crc32fast::hash(packed).to_le_bytes() != bytes[8..12] {
            return Err(unreadable("its checksum does not match"));
        }
        let claimed = bytes[12..20]
            .iter()
            .rev()
            .fold(0_u64, |n, b| n << 8 | u64::from(*b));
        let size = usize::try_from(claimed).unwrap_or(usize::MAX);
        // zstd never packs tighter than about 1 : 30 000.
        if size > UNPACKED_LIMIT.min(packed.len().saturating_mul(32_768)) {
            return Err(unreadable("it claims an impossible size"));
        }
        // Memory that is not there is an error, not an abort: the index is built again then, or not
        // used.
        let mut plain = plain_file::reserve(size as u64)?;
        zstd::bulk::Decompressor::new()?.decompress_to_buffer(packed, &mut plain)?;
        let needed = plain.len().saturating_mul(GROWTH);
        if needed <= SMALL {
            Self::decode_within::<SMALL>(&plain)
        } else if needed <= MIDDLE {
            Self::decode_within::<MIDDLE>(&plain)
        } else {
            Self::decode_within::<UNPACKED_LIMIT>(&plain)
        }
    }

    /// Decodes an index. No length that is claimed in it is allocated before it is weighed against
    /// the limit, and the limit against the memory that there is.
    fn decode_within<const LIMIT: usize>(plain: &[u8]) -> Result<Self, IndexError> {
        // Room for what is decoded already, and for the length that the next list claims.
        drop(plain_file::reserve(2 * LIMIT as u64)?);
        let config = bincode::config::standard().with_limit::<LIMIT>();
        let (index, _) = bincode::decode_from_slice(plain, config)
            .map_err(|e| IndexError::Unreadable(e.to_string()))?;
        Ok(index)
    }

    /// Reads the index of a session and makes sure that it is this session's.
    ///
    /// # Errors
    /// See [`IndexError`]; on all but `Io` the index should be built again.
    pub fn read(reader: &SessionReader) -> Result<Self, IndexError> {
        let limit = UNPACKED_LIMIT as u64;
        let bytes = crate::storage::read_up_to(&**reader.storage(), layout::INDEX, limit)?;
        let index = Self::from_bytes(&bytes)?;
        if index.session_id != reader.manifest().session_id {
            return Err(IndexError::Stale(format!(
                "it is of session {}",
                index.session_id
            )));
        }
        if index.segments != segment_lengths(reader)? {
            return Err(IndexError::Stale(
                "the segments have other lengths".to_owned(),
            ));
        }
        Ok(index)
    }

    /// The camera with this name.
    pub fn camera(&self, name: &str) -> Option<&CameraIndex> {
        self.cameras.iter().find(|c| c.name == name)
    }

    /// The IMU with this name.
    pub fn imu(&self, name: &str) -> Option<&ImuIndex> {
        self.imus.iter().find(|i| i.name == name)
    }

    /// Position of the frame set with this number.
    pub fn set(&self, number: u64) -> Option<usize> {
        // Sets are sorted by time. Their numbers rise with it in what our recorder writes, and
        // nothing in the format forces them to.
        match self.sets.binary_search_by_key(&number, |s| s.number) {
            Ok(position) => Some(position),
            Err(_) => self.sets.iter().position(|s| s.number == number),
        }
    }

    /// Position of the frame set nearest to a time, the earlier one of two.
    ///
    /// ```
    /// use session_archive::index::{Index, SetEntry};
    /// use session_archive::time::HostTime;
    ///
    /// let set = |number| SetEntry { number, time_ns: number as i64 * 33, frames: Vec::new() };
    /// # let index = Index {
    /// #     session_id: String::new(),
    /// #     segments: Vec::new(),
    /// #     cameras: Vec::new(),
    /// #     imus: Vec::new(),
    /// #     sets: (10..14).map(set).collect(),
    /// #     damaged: 0,
    /// # };
    /// // Sets 10 to 13 at 330, 363, 396 and 429 ns.
    /// assert_eq!(index.set_at(HostTime(370)), Some(1));
    /// assert_eq!(index.set_at(HostTime(-5)), Some(0));
    /// assert_eq!(index.set(13), Some(3));
    /// assert_eq!(index.set(14), None);
    /// ```
    pub fn set_at(&self, time: HostTime) -> Option<usize> {
        let after = self.sets.partition_point(|s| s.time_ns < time.0);
        (after.saturating_sub(1)..self.sets.len())
            .take(2)
            .min_by_key(|&position| self.sets[position].time_ns.abs_diff(time.0))
    }
}
