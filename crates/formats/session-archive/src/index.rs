//! The derived index of a session: where every frame, IMU batch and frame set is.
//!
//! It is built by one pass over the session and can be deleted at any time. Looking something up
//! takes a binary search in memory and one read; what is read is checked against the frame's own
//! CRC-32, so a session that changed under its index is noticed.
//!
//! On disk it is bincode in zstd behind a CRC-32. That format may change with any version of this
//! crate: an index that cannot be read is built again (`docs/decisions/0003-derived-index.md`).

use std::collections::BTreeMap;
use std::io;
use std::ops::Range;
use std::sync::Arc;

use bincode::{Decode, Encode};
use bytes::Bytes;

use crate::layout;
use crate::mcap::CHUNK_PREFIX;
use crate::reader::{Entry, Message, ReadError, SessionReader};
use crate::record::paws::gap::Cause;
use crate::record::{CompressedVideo, Frame, FrameSet, Gap, ImuBatch, Protobuf, Record};
use crate::storage::{ReadAt, Storage};
use crate::time::HostTime;
use crate::verify::union;

const MAGIC: [u8; 8] = *b"PAWSIDX2";
/// No index is larger than this once unpacked; three cameras at 30 Hz take 0.6 GB in a whole day.
const UNPACKED_LIMIT: usize = 1 << 30;
/// The least that a decoded index may take: every index of an hour's walk takes less.
const SMALL: usize = 16 << 20;
/// Between the two.
const MIDDLE: usize = 256 << 20;
/// An entry takes at most this many times the bytes in memory that it takes unpacked: a camera without frames, 56
/// bytes for 3, is the worst.
const GROWTH: usize = 20;

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
    /// There is none, or the file system reports an I/O error: build it.
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
        // Memory that is not there is an error, not an abort: the index is built again then, or not used.
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

    /// Decodes an index. No length that is claimed in it is allocated before it is weighed against the limit, and the
    /// limit against the memory that there is.
    fn decode_within<const LIMIT: usize>(plain: &[u8]) -> Result<Self, IndexError> {
        // What is decoded already, and the next list's claim.
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

impl CameraIndex {
    /// Leaves out the frames that refer to one of these numbers: those between it and the next key
    /// frame. Gap records may come long after the frames, those of recovery last of all.
    fn leave_out_behind(&mut self, lost: Vec<(u64, u64)>) {
        let lost = union(lost);
        let frames = std::mem::take(&mut self.frames);
        let mut key = 0;
        for (position, frame) in frames.iter().enumerate() {
            let is_key = frame.key as usize == position;
            if is_key {
                key = self.frames.len() as u32;
            }
            let from = frames[frame.key as usize].number;
            let next = lost.partition_point(|range| range.1 <= from);
            let is_behind = lost.get(next).is_some_and(|range| range.0 < frame.number);
            if is_behind && !is_key {
                self.undecodable += 1;
            } else {
                self.frames.push(FrameEntry { key, ..*frame });
            }
        }
    }
}

/// Whether frames that are missing for this cause were encoded, so that later ones may refer to
/// them. Frames dropped before the encoder leave no trace in what it makes.
fn is_behind_the_encoder(cause: Cause) -> bool {
    match cause {
        Cause::EncoderRestart | Cause::WriterOverload | Cause::Storage | Cause::Damaged => true,
        Cause::Unknown
        | Cause::Device
        | Cause::Disconnected
        | Cause::EncoderOverload
        | Cause::Late
        | Cause::LoadShed
        | Cause::MachineOverload => false,
    }
}

fn segment_lengths(reader: &SessionReader) -> io::Result<Vec<(u32, u64)>> {
    let mut lengths = Vec::new();
    for number in reader.segment_numbers() {
        match reader.storage().open(&layout::segment(number)) {
            Ok(file) => lengths.push((number, file.len()?)),
            Err(e) if e.kind() == io::ErrorKind::NotFound => {}
            Err(e) => return Err(e),
        }
    }
    Ok(lengths)
}

/// Reads what an index points to, from any thread.
pub struct Access {
    files: BTreeMap<u32, Arc<dyn ReadAt>>,
}

impl Access {
    /// Opens the segments of a session.
    ///
    /// # Errors
    /// The file system reports an I/O error, or a segment that was indexed is missing.
    pub fn open(storage: &dyn Storage, index: &Index) -> io::Result<Self> {
        let mut files = BTreeMap::new();
        for (number, _) in &index.segments {
            files.insert(*number, Arc::from(storage.open(&layout::segment(*number))?));
        }
        Ok(Self { files })
    }

    /// The access unit of a frame, checked.
    ///
    /// # Errors
    /// [`IndexError::Mismatch`], or the file system reports an I/O error.
    pub fn unit(&self, frame: &FrameEntry) -> Result<Bytes, IndexError> {
        self.checked(frame.segment, frame.offset, frame.bytes, frame.crc32)
    }

    /// An IMU batch, checked.
    ///
    /// # Errors
    /// [`IndexError::Mismatch`], or the file system reports an I/O error.
    pub fn batch(&self, batch: &BatchEntry) -> Result<ImuBatch, IndexError> {
        let bytes = self.checked(batch.segment, batch.offset, batch.bytes, batch.crc32)?;
        ImuBatch::decode(bytes).map_err(|e| IndexError::Unreadable(e.to_string()))
    }

    fn checked(
        &self,
        segment: u32,
        offset: u64,
        length: u32,
        crc32: u32,
    ) -> Result<Bytes, IndexError> {
        let mismatch = IndexError::Mismatch { segment, offset };
        let Some(file) = self.files.get(&segment) else {
            return Err(mismatch);
        };
        if offset.saturating_add(u64::from(length)) > file.len()? {
            return Err(mismatch);
        }
        // Within the file, and yet not to be had where the file has holes and memory is short.
        let mut bytes = plain_file::reserve(length.into())?;
        bytes.resize(length as usize, 0);
        file.read_exact_at(&mut bytes, offset)?;
        if crc32fast::hash(&bytes) == crc32 {
            Ok(bytes.into())
        } else {
            Err(mismatch)
        }
    }
}

/// What a channel carries, with the position of its camera or IMU.
#[derive(Clone, Copy)]
enum Kind {
    Video(usize),
    Frame(usize),
    Imu(usize),
    Sets,
    Gaps,
}

/// A frame set before its frames' positions are known.
struct PendingSet {
    number: u64,
    time_ns: i64,
    members: Vec<(usize, u64)>,
}

struct Build {
    kinds: BTreeMap<u16, Kind>,
    index: Index,
    /// The frame record whose access unit has not come yet, per camera.
    awaiting: Vec<Option<Frame>>,
    /// Position of the key frame of the current run, per camera; none after a break.
    key: Vec<Option<u32>>,
    /// Number of the newest frame, per camera.
    newest: Vec<Option<u64>>,
    /// First and last numbers of frames that the encoder had made and that are lost, per camera.
    lost: Vec<Vec<(u64, u64)>>,
    sets: Vec<PendingSet>,
}

impl Build {
    fn new(reader: &SessionReader) -> Result<Self, ReadError> {
        let manifest = reader.manifest();
        let camera = |of: &str| manifest.cameras.iter().position(|c| c.name == of);
        let mut kinds = BTreeMap::new();
        for stream in &manifest.streams {
            let kind = match stream.schema.as_str() {
                name if name == CompressedVideo::SCHEMA.name => camera(&stream.of).map(Kind::Video),
                name if name == Frame::SCHEMA.name => camera(&stream.of).map(Kind::Frame),
                name if name == ImuBatch::SCHEMA.name => manifest
                    .imus
                    .iter()
                    .position(|i| i.name == stream.of)
                    .map(Kind::Imu),
                name if name == FrameSet::SCHEMA.name => Some(Kind::Sets),
                name if name == Gap::SCHEMA.name => Some(Kind::Gaps),
                _ => None,
            };
            if let Some(kind) = kind {
                kinds.insert(stream.id, kind);
            }
        }
        let cameras = manifest.cameras.iter().map(|c| CameraIndex {
            name: c.name.clone(),
            frames: Vec::new(),
            undecodable: 0,
        });
        let imus = manifest.imus.iter();
        let imus = imus.map(|i| ImuIndex {
            name: i.name.clone(),
            batches: Vec::new(),
        });
        let count = manifest.cameras.len();
        Ok(Self {
            kinds,
            index: Index {
                session_id: manifest.session_id.clone(),
                segments: segment_lengths(reader).map_err(|error| ReadError::Io {
                    path: layout::SEGMENTS.to_owned(),
                    error,
                })?,
                cameras: cameras.collect(),
                imus: imus.collect(),
                sets: Vec::new(),
                damaged: 0,
            },
            awaiting: vec![None; count],
            key: vec![None; count],
            newest: vec![None; count],
            lost: vec![Vec::new(); count],
            sets: Vec::new(),
        })
    }

    fn message(&mut self, m: &Message) {
        let payload_at = m.chunk_offset + CHUNK_PREFIX as u64 + u64::from(m.payload_offset);
        match self.kinds.get(&m.stream) {
            Some(Kind::Frame(camera)) => self.awaiting[*camera] = m.decode().ok(),
            Some(Kind::Video(camera)) => self.video(*camera, m, payload_at),
            Some(Kind::Imu(imu)) => {
                let Ok(batch) = m.decode::<ImuBatch>() else {
                    return;
                };
                let (Some(&start_ns), Some(&end_ns)) = (batch.times.first(), batch.times.last())
                else {
                    return;
                };
                self.index.imus[*imu].batches.push(BatchEntry {
                    first_number: batch.first_number,
                    samples: batch.device_ticks.len() as u32,
                    start_ns,
                    end_ns,
                    segment: m.segment,
                    offset: payload_at,
                    bytes: m.data.len() as u32,
                    crc32: crc32fast::hash(&m.data),
                });
            }
            Some(Kind::Sets) => {
                let Ok(set) = m.decode::<FrameSet>() else {
                    return;
                };
                let position = |name: &str| self.index.cameras.iter().position(|c| c.name == name);
                let members = set.members.iter();
                let members = members
                    .filter_map(|m| position(&m.camera).map(|c| (c, m.number)))
                    .collect();
                self.sets.push(PendingSet {
                    number: set.number,
                    time_ns: set.time,
                    members,
                });
            }
            Some(Kind::Gaps) => {
                let Ok(gap) = m.decode::<Gap>() else {
                    return;
                };
                let camera = (self.index.cameras.iter()).position(|c| c.name == gap.stream);
                if let (Some(camera), true) = (camera, is_behind_the_encoder(gap.cause())) {
                    self.lost[camera].push((gap.first, gap.last));
                }
            }
            None => {}
        }
    }

    fn video(&mut self, camera: usize, m: &Message, payload_at: u64) {
        let frame = self.awaiting[camera].take();
        let (Some(frame), Ok(video)) = (frame, m.decode::<CompressedVideo>()) else {
            return;
        };
        let matches = frame.number as u32 == m.sequence
            && crc32fast::hash(&video.data) == frame.payload_crc32
            && self.newest[camera].is_none_or(|newest| frame.number > newest);
        if !matches {
            self.key[camera] = None;
            return;
        }
        // An access unit without bytes lies nowhere.
        let unit_at = match video.data.is_empty() {
            true => 0,
            false => video.data.as_ptr() as usize - m.data.as_ptr() as usize,
        };
        let list = &mut self.index.cameras[camera];
        let position = list.frames.len() as u32;
        if frame.key_frame {
            self.key[camera] = Some(position);
        }
        self.newest[camera] = Some(frame.number);
        let Some(key) = self.key[camera] else {
            list.undecodable += 1;
            return;
        };
        list.frames.push(FrameEntry {
            number: frame.number,
            time_ns: frame.time,
            sigma_ns: frame.sigma_ns,
            time_unreliable: frame.time_unreliable,
            host_time_ns: frame.host_time,
            device_ticks: frame.device_ticks,
            key,
            segment: m.segment,
            offset: payload_at + unit_at as u64,
            bytes: video.data.len() as u32,
            crc32: frame.payload_crc32,
        });
    }

    fn finish(mut self) -> Index {
        for (camera, lost) in self.index.cameras.iter_mut().zip(self.lost) {
            camera.leave_out_behind(lost);
        }
        self.sets.sort_by_key(|s| (s.time_ns, s.number));
        let cameras = &self.index.cameras;
        let sets = self.sets.into_iter().map(|set| {
            let mut frames = vec![None; cameras.len()];
            for (camera, number) in set.members {
                frames[camera] = cameras[camera].position(number).map(|p| p as u32);
            }
            SetEntry {
                number: set.number,
                time_ns: set.time_ns,
                frames,
            }
        });
        self.index.sets = sets.collect();
        self.index
    }
}
