//! Writing a session.
//!
//! Messages are collected into a chunk; a closed chunk is one write and one sync. What is on disk
//! is known at any time ([`SessionWriter::durability`]), what may still be lost is at most the
//! chunk in the making.
//!
//! * **Chunks begin with key frames.** A chunk is an *epoch* of [`SessionSpec::chunk_ns`] on the
//!   log-time axis, counted from the host clock's zero: the same count is used to force key frames. A camera enters the next epoch with its first key frame there; until every
//!   camera that delivers has done so, two chunks are open, and messages of the cameras that are
//!   ahead wait in the second. A camera that sends no key frame in time does not hold the others
//!   up: no chunk is open longer than [`MAX_CHUNK_NS`].
//! * **A failed write or sync ends that segment for good.** The chunk is still in memory, so it
//!   is written again as the first of a new segment, and nothing is lost; if that fails too, gap
//!   records take the place of its samples in a third; if that fails, the writer is finished and
//!   says so.
//! * **Stopping is O(1)**: one chunk, one summary of at most a minute, one manifest.

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;

use crate::layout;
use crate::manifest::{
    Camera, FORMAT, FORMAT_VERSION, Imu, Manifest, RigFile, SegmentEntry, SegmentState, State,
    Stop, Stream, is_state, stream_table,
};
use crate::mcap::{ChunkBuilder, SegmentEncoder};
use crate::record::{
    self, CompressedVideo, Event, Frame, Gap, Protobuf, Record, Segment, paws, timestamp,
};
use crate::storage::{self, Storage, WriteFile};
use crate::time::{CivilTime, HostTime};

mod contents;
mod video;

use contents::{
    chunk_bounds, extents, gaps, is_sampled, members, messages, runs, samples, stream_of,
};
use video::VideoRef;

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

/// What a session is to be.
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
    /// What records.
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

/// Up to where everything is on disk: the messages, or the gap records in their place
/// ([`Incident::lost`]).
///
/// ```
/// use session_archive::record::Event;
/// use session_archive::time::HostTime;
/// # use session_archive::time::CivilTime;
/// # let spec = session_archive::writer::SessionSpec {
/// #     session_id: "0192aa00-0000-7000-8000-00000000000d".to_owned(),
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
/// # let mut writer = session_archive::writer::SessionWriter::create(storage, spec)?;
/// let mark = Event { text: "stairs".to_owned(), ..Event::default() };
/// writer.append("", HostTime(100), HostTime(100), &mark)?;
/// // The chunk in the making is what a power cut may take.
/// assert_eq!(writer.durability().messages, 0);
/// assert!(writer.durability().until < HostTime(100));
///
/// writer.poll(HostTime(2_000_000_000))?;
/// let durable = writer.durability();
/// assert_eq!((durable.messages, durable.chunks), (1, 1));
/// assert_eq!(durable.until, HostTime(2_000_000_000));
/// # Ok::<(), session_archive::writer::WriteError>(())
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Durability {
    /// Every message appended so far with a log time up to here is on disk.
    pub until: HostTime,
    /// Messages on disk.
    pub messages: u64,
    /// Chunks on disk, the heads of segments not counted.
    pub chunks: u64,
    /// Bytes on disk.
    pub bytes: u64,
}

/// Something that went wrong and was dealt with.
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
    /// The disk failed for good; what [`SessionWriter::durability`] says is on disk remains valid.
    /// Close the writer and tell the user.
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

struct OpenSegment {
    number: u32,
    file: Box<dyn WriteFile>,
    encoder: SegmentEncoder,
    /// Earliest log time of its chunks, the head not counted.
    start: Option<HostTime>,
}

/// How far one camera has come.
#[derive(Clone, Copy, Default)]
struct VideoProgress {
    /// It put something into the open chunk, so closing it waits for its next key frame.
    in_open: bool,
    /// Its newest key frame belongs to the next chunk.
    in_next: bool,
}

struct StateMessage {
    sequence: u32,
    data: Vec<u8>,
}

/// Writes one session. See the module's documentation for what it promises.
pub struct SessionWriter {
    storage: Arc<dyn Storage>,
    manifest: Manifest,
    segment: Option<OpenSegment>,
    open: ChunkBuilder,
    next: ChunkBuilder,
    open_epoch: Option<i64>,
    next_epoch: Option<i64>,
    video: Vec<VideoProgress>,
    sequences: Vec<u32>,
    /// The newest message of every stream that holds state, as far as it is on disk.
    states: BTreeMap<u16, StateMessage>,
    /// The same, still in the open chunk.
    new_states: BTreeMap<u16, StateMessage>,
    /// The manifest without segments, as every head repeats it.
    identity: String,
    newest: HostTime,
    durability: Durability,
    incidents: Vec<Incident>,
    finished: bool,
}

impl SessionWriter {
    /// Creates a session in an empty folder: rig files, first segment, manifest, all durable.
    ///
    /// # Errors
    /// [`WriteError::Create`], also if the folder already holds a session.
    pub fn create(storage: Arc<dyn Storage>, spec: SessionSpec) -> Result<Self, WriteError> {
        let streams = stream_table(&spec.cameras, &spec.imus);
        let mut writer = Self {
            manifest: Manifest {
                format: FORMAT.to_owned(),
                format_version: FORMAT_VERSION,
                session_id: spec.session_id,
                name: spec.name,
                software: spec.software,
                state: State::Recording,
                started: spec.started,
                started_civil: spec.started_civil,
                chunk_ns: spec.chunk_ns.clamp(1, MAX_CHUNK_NS),
                cameras: spec.cameras,
                imus: spec.imus,
                streams,
                rig: Vec::new(),
                segments: Vec::new(),
                extents: BTreeMap::new(),
                stopped: None,
            },
            storage,
            segment: None,
            open: ChunkBuilder::default(),
            next: ChunkBuilder::default(),
            open_epoch: None,
            next_epoch: None,
            video: Vec::new(),
            sequences: Vec::new(),
            states: BTreeMap::new(),
            new_states: BTreeMap::new(),
            identity: String::new(),
            newest: HostTime(0),
            durability: Durability::default(),
            incidents: Vec::new(),
            finished: false,
        };
        writer.video = vec![VideoProgress::default(); writer.manifest.cameras.len()];
        writer.sequences = vec![0; writer.manifest.streams.len()];
        writer.create_files(spec.rig).map_err(WriteError::Create)?;
        Ok(writer)
    }

    fn create_files(&mut self, rig: Vec<(String, Vec<u8>)>) -> io::Result<()> {
        let storage = self.storage.clone();
        if storage.open(layout::MANIFEST).is_ok() {
            return Err(io::Error::new(
                io::ErrorKind::AlreadyExists,
                "the folder already holds a session",
            ));
        }
        storage.create_dir(layout::SEGMENTS)?;
        storage.create_dir(layout::RIG)?;
        for (name, content) in rig {
            let mut file = storage.create(&layout::rig_file(&name))?;
            file.append(&content)?;
            file.sync_data()?;
            let blake3 = blake3::hash(&content).to_hex().to_string();
            self.manifest.rig.push(RigFile {
                name,
                bytes: content.len() as u64,
                blake3,
            });
        }
        storage.sync_dir(layout::RIG)?;
        self.identity = self.manifest.identity();
        // What cannot be read back (a rate that is no number, say) must not be written.
        Manifest::from_identity(&self.identity)
            .map_err(|e| io::Error::new(io::ErrorKind::InvalidInput, e))?;
        // The manifest first: a folder with segments always has one.
        self.write_manifest()?;
        self.open_segment(self.manifest.started)
    }

    /// The manifest as it stands.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// Up to where everything is on disk.
    pub fn durability(&self) -> Durability {
        self.durability
    }

    /// Failures since the last call that were dealt with; tell the user.
    pub fn take_incidents(&mut self) -> Vec<Incident> {
        std::mem::take(&mut self.incidents)
    }

    /// Appends a message to the stream of type `R` that belongs to `of` (a camera, an IMU, or
    /// `""`). `time` becomes the log time, `published` is when the daemon had it.
    ///
    /// # Errors
    /// See [`WriteError`]; after `Storage` and `Finished` only [`Self::close`] makes sense.
    pub fn append<R: Record>(
        &mut self,
        of: &str,
        time: HostTime,
        published: HostTime,
        message: &R,
    ) -> Result<(), WriteError> {
        let stream = self
            .manifest
            .stream::<R>(of)
            .ok_or_else(|| WriteError::UnknownStream(format!("{} of {of:?}", R::SCHEMA.name)))?;
        let (id, keeps_state) = (stream.id, is_state(stream));
        let bytes = message.encoded_len();
        let (log, publish) = self.admit(time, published, bytes)?;
        let sequence = self.take_sequence(id);
        if keeps_state {
            let data = message.encode_to_vec();
            self.new_states.insert(id, StateMessage { sequence, data });
        }
        self.open
            .message(id, sequence, log, publish, |out| encode(message, out));
        self.note(time);
        let idle = !self.video.iter().any(|v| v.in_open || v.in_next);
        self.close_overdue(if idle {
            self.manifest.chunk_ns
        } else {
            MAX_CHUNK_NS
        })
    }

    /// Appends a stereo frame: the access unit and its companion. The payload's CRC, length and
    /// the key-frame flag in `frame` are filled in here.
    ///
    /// # Errors
    /// As for [`Self::append`].
    ///
    /// ```
    /// use session_archive::record::Frame;
    /// # use session_archive::index::{Access, Index};
    /// # use session_archive::manifest::{Camera, Stop};
    /// # use session_archive::reader::SessionReader;
    /// # use session_archive::storage::FaultStorage;
    /// # use session_archive::time::{CivilTime, HostTime, TickLength};
    /// # use session_archive::writer::{SessionSpec, SessionWriter};
    /// # let spec = SessionSpec {
    /// #     session_id: "0192aa00-0000-7000-8000-00000000000e".to_owned(),
    /// #     name: String::new(),
    /// #     software: "example".to_owned(),
    /// #     started: HostTime(0),
    /// #     started_civil: CivilTime(0),
    /// #     chunk_ns: 500_000_000,
    /// #     cameras: vec![Camera {
    /// #         name: "feet".to_owned(),
    /// #         width: 64,
    /// #         height: 24,
    /// #         codec: "h264".to_owned(),
    /// #         colour: "grey".to_owned(),
    /// #         rate_hz: 30.0,
    /// #         tick: TickLength::NANOSECOND,
    /// #         trigger: None,
    /// #         source: "example".to_owned(),
    /// #         encoder: "none".to_owned(),
    /// #     }],
    /// #     imus: Vec::new(),
    /// #     rig: Vec::new(),
    /// # };
    /// # let storage = std::sync::Arc::new(FaultStorage::new());
    /// # let mut writer = SessionWriter::create(storage.clone(), spec)?;
    /// for number in 0..3 {
    ///     let time = 1_000_000 + number as i64 * 33_333_333;
    ///     let frame = Frame { number, time, host_time: time + 2_000_000, ..Frame::default() };
    ///     let unit = format!("access unit {number}");
    ///     writer.append_frame("feet", frame, unit.as_bytes(), number == 0)?;
    /// }
    /// # writer.close(Stop { at: HostTime(1_000_000_000), reason: "duration".to_owned() })?;
    ///
    /// let reader = SessionReader::open(storage)?;
    /// let index = Index::build(&reader, |_| {})?;
    /// let frame = index.cameras[0].frame(2).ok_or("no frame 2")?;
    /// let access = Access::open(&**reader.storage(), &index)?;
    /// assert_eq!(&access.unit(frame)?[..], b"access unit 2");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn append_frame(
        &mut self,
        camera: &str,
        mut frame: Frame,
        unit: &[u8],
        key_frame: bool,
    ) -> Result<(), WriteError> {
        let unknown = || WriteError::UnknownStream(format!("camera {camera:?}"));
        let slot = self
            .manifest
            .cameras
            .iter()
            .position(|c| c.name == camera)
            .ok_or_else(unknown)?;
        let video = self
            .manifest
            .stream::<CompressedVideo>(camera)
            .ok_or_else(unknown)?
            .id;
        let frames = self
            .manifest
            .stream::<Frame>(camera)
            .ok_or_else(unknown)?
            .id;
        let time = HostTime(frame.time);
        let (log, publish) = self.admit(time, HostTime(frame.host_time), unit.len())?;
        frame.payload_crc32 = crc32fast::hash(unit);
        frame.payload_bytes = unit.len() as u32;
        frame.key_frame = key_frame;
        if key_frame {
            self.enter_epoch(slot, time)?;
        }
        let ahead = self.video[slot].in_next;
        self.video[slot].in_open |= !ahead;
        let sequence = frame.number as u32;
        let message = VideoRef {
            timestamp: timestamp(time),
            frame_id: format!("{camera}/left"),
            data: unit,
            format: &self.manifest.cameras[slot].codec,
        };
        let chunk = if ahead {
            &mut self.next
        } else {
            &mut self.open
        };
        chunk.message(frames, sequence, log, publish, |out| encode(&frame, out));
        chunk.message(video, sequence, log, publish, |out| message.encode(out));
        self.note(time);
        if self.video.iter().all(|v| v.in_next || !v.in_open)
            && self.video.iter().any(|v| v.in_next)
        {
            self.close_chunk()?;
        }
        self.close_overdue(MAX_CHUNK_NS)
    }

    /// Closes the chunk in the making if it is overdue at `now`; call it when nothing arrives.
    ///
    /// # Errors
    /// As for [`Self::append`].
    pub fn poll(&mut self, now: HostTime) -> Result<(), WriteError> {
        self.newest = self.newest.max(now);
        self.close_overdue(MAX_CHUNK_NS)
    }

    /// Ends the session; the writer takes nothing more. Everything appended is on disk when this
    /// succeeds, as [`Durability`] says, and [`Self::take_incidents`] tells what went wrong on the
    /// way. After a fatal error it still writes the manifest if the disk lets it.
    ///
    /// # Errors
    /// See [`WriteError`]; [`WriteError::Finished`] after a fatal error, which was returned when it
    /// happened. The session can be opened all the same, up to what was durable.
    pub fn close(&mut self, stop: Stop) -> Result<Manifest, WriteError> {
        let mut result = if self.finished {
            Err(WriteError::Finished)
        } else {
            Ok(())
        };
        for _ in 0..2 {
            if result.is_ok() && !(self.open.is_empty() && self.next.is_empty()) {
                result = self.close_chunk();
            }
        }
        self.finished = true;
        self.finish_segment();
        self.manifest.state = State::Closed;
        self.manifest.stopped = Some(stop);
        let written = self.write_manifest().map_err(|error| WriteError::Storage {
            segment: self.manifest.segments.last().map_or(0, |s| s.number),
            error,
        });
        result.and(written).map(|()| self.manifest.clone())
    }

    /// Checks what every message must satisfy; log and publish time as MCAP stores them.
    fn admit(
        &self,
        time: HostTime,
        published: HostTime,
        bytes: usize,
    ) -> Result<(u64, u64), WriteError> {
        if self.finished {
            return Err(WriteError::Finished);
        }
        if bytes > MAX_CHUNK_BYTES {
            return Err(WriteError::TooLarge(bytes));
        }
        let log = u64::try_from(time.0).map_err(|_| WriteError::NegativeTime(time))?;
        Ok((log, u64::try_from(published.0).unwrap_or(log)))
    }

    fn take_sequence(&mut self, id: u16) -> u32 {
        let slot = &mut self.sequences[usize::from(id) - 1];
        let sequence = *slot;
        *slot = slot.wrapping_add(1);
        sequence
    }

    /// A key frame of camera `slot` arrived: it opens the next chunk if it belongs to a later
    /// epoch than the open one.
    fn enter_epoch(&mut self, slot: usize, time: HostTime) -> Result<(), WriteError> {
        let epoch = time.0.div_euclid(self.manifest.chunk_ns);
        // The camera is a whole epoch ahead of one that still holds the open chunk: close it.
        if self.video[slot].in_next && self.next_epoch.is_some_and(|next| epoch > next) {
            self.close_chunk()?;
        }
        let open = *self.open_epoch.get_or_insert(epoch);
        if epoch > open {
            self.video[slot].in_next = true;
            self.next_epoch.get_or_insert(epoch);
        }
        Ok(())
    }

    fn note(&mut self, time: HostTime) {
        self.newest = self.newest.max(time);
        self.update_until();
    }

    fn update_until(&mut self) {
        let pending = [&self.open, &self.next]
            .into_iter()
            .filter_map(|c| c.start_time())
            .min();
        self.durability.until = match pending {
            Some(first) => HostTime(first as i64 - 1),
            None => self.newest,
        };
    }

    fn close_overdue(&mut self, limit: i64) -> Result<(), WriteError> {
        // Twice after a leap in time: then the next chunk is overdue as well.
        while self.open_age() >= limit || self.open.bytes() + self.next.bytes() > MAX_CHUNK_BYTES {
            self.close_chunk()?;
        }
        Ok(())
    }

    /// How long the oldest message that is not written yet has waited on the log-time axis, ns. It may
    /// be in the next chunk, where a camera lags behind the other streams.
    fn open_age(&self) -> i64 {
        let starts = [&self.open, &self.next].map(|chunk| chunk.start_time());
        let oldest = starts.into_iter().flatten().min();
        oldest.map_or(-1, |start| self.newest.0.saturating_sub(start as i64))
    }

    /// Writes the open chunk; the next one becomes the open one.
    fn close_chunk(&mut self) -> Result<(), WriteError> {
        let mut chunk = std::mem::replace(&mut self.open, std::mem::take(&mut self.next));
        self.open_epoch = self.next_epoch.take().or(self.open_epoch);
        for video in &mut self.video {
            *video = VideoProgress {
                in_open: video.in_next,
                in_next: false,
            };
        }
        if chunk.is_empty() {
            return Ok(());
        }
        let bytes = chunk.finish();
        self.commit(&bytes)?;
        self.update_until();
        self.next.recycle(bytes);
        Ok(())
    }

    /// Puts a chunk on disk, in a new segment if the current one is full or fails.
    fn commit(&mut self, bytes: &[u8]) -> Result<(), WriteError> {
        let first = match self.try_commit(bytes) {
            Ok(()) => return Ok(()),
            Err(e) => e,
        };
        let segment = self.give_up(&first);
        let again = self.try_commit(bytes);
        let Err(second) = again else {
            self.incidents.push(Incident {
                segment,
                error: first,
                lost: Vec::new(),
            });
            return Ok(());
        };
        let segment = self.give_up(&second);
        let (lost, substitute) = self.substitute(bytes, &first);
        if let Err(error) = self.try_commit(&substitute) {
            let segment = self.give_up(&error);
            self.finished = true;
            return Err(WriteError::Storage { segment, error });
        }
        self.incidents.push(Incident {
            segment,
            error: second,
            lost,
        });
        Ok(())
    }

    fn try_commit(&mut self, bytes: &[u8]) -> io::Result<()> {
        let (start, end) = chunk_bounds(bytes);
        let full = self.segment.as_ref().is_some_and(|s| {
            let span = end.since(s.start.unwrap_or(start).min(start));
            s.start.is_some()
                && (span > MAX_SEGMENT_NS
                    || s.encoder.position() + bytes.len() as u64 > MAX_SEGMENT_BYTES)
        });
        if full {
            self.finish_segment();
        }
        if self.segment.is_none() {
            self.open_segment(start)?;
        }
        if let Some(segment) = &mut self.segment {
            segment.file.append(bytes)?;
            segment.file.sync_data()?;
            segment.encoder.chunk(bytes).map_err(io::Error::other)?;
            segment.start = Some(segment.start.map_or(start, |s| s.min(start)));
        }
        self.update_entry(SegmentState::Open);
        self.states.append(&mut self.new_states);
        self.durability.messages += messages(bytes).count() as u64;
        self.durability.chunks += 1;
        self.durability.bytes += bytes.len() as u64;
        self.update_extents(bytes);
        Ok(())
    }

    /// Starts a segment file: its head chunk says who it is and repeats all state.
    fn open_segment(&mut self, time: HostTime) -> io::Result<()> {
        let previous = self.manifest.segments.last();
        let number = previous.map_or(0, |s| s.number + 1);
        let previous_valid_bytes = previous.map_or(0, |s| s.bytes);
        self.manifest.segments.push(SegmentEntry {
            number,
            state: SegmentState::Open,
            bytes: 0,
            start: None,
            end: None,
            messages: 0,
        });
        let mut file = self.storage.create(&layout::segment(number))?;
        let identity = Segment {
            format_version: FORMAT_VERSION,
            session_id: self.manifest.session_id.clone(),
            number,
            previous_valid_bytes,
            manifest: self.identity.clone(),
        };
        let states = self
            .states
            .iter()
            .map(|(id, s)| (*id, s.sequence, &s.data[..]));
        let head = head_chunk(&identity, &self.manifest.streams, time, states);
        let (mut encoder, mut bytes) = SegmentEncoder::start(PROFILE, LIBRARY);
        encoder.chunk(&head).map_err(io::Error::other)?;
        bytes.extend(head);
        let started = file
            .append(&bytes)
            .and_then(|()| file.sync_data())
            .and_then(|()| self.storage.sync_dir(layout::SEGMENTS));
        if let Err(error) = started {
            // Nothing in it counts.
            if is_full(&error) {
                let _ = file.truncate(0);
            }
            return Err(error);
        }
        self.segment = Some(OpenSegment {
            number,
            file,
            encoder,
            start: None,
        });
        self.update_entry(SegmentState::Open);
        self.write_manifest()
    }

    /// Ends the open segment with its summary. A failure here loses nothing: every chunk is on
    /// disk, and a segment without a summary is read from front to back.
    fn finish_segment(&mut self) {
        let Some(mut segment) = self.segment.take() else {
            return;
        };
        let summary = segment.encoder.clone().finish();
        let ended = segment
            .file
            .append(&summary)
            .and_then(|()| segment.file.sync_data());
        let number = segment.number;
        let whole = segment.encoder.position() + summary.len() as u64;
        self.segment = Some(segment);
        match ended {
            Ok(()) => {
                self.update_entry(SegmentState::Closed);
                if let Some(entry) = self.manifest.segments.last_mut() {
                    entry.bytes = whole;
                }
                self.segment = None;
            }
            Err(error) => {
                self.give_up(&error);
                self.incidents.push(Incident {
                    segment: number,
                    error,
                    lost: Vec::new(),
                });
            }
        }
    }

    /// Ends the open segment after a failure: only what was synced counts, and nothing if that is
    /// but its head. Returns its number. What readers are to pass over they know from the next segment's head and from
    /// the manifest, so the unreliable bytes may remain: a file system that got back a bad place on the disk would
    /// give it to the next segment. Only a full disk needs the room.
    fn give_up(&mut self, error: &io::Error) -> u32 {
        let segment = self.segment.take();
        let Some(entry) = self.manifest.segments.last_mut() else {
            return 0;
        };
        entry.state = SegmentState::GivenUp;
        if let Some(OpenSegment {
            mut file, start, ..
        }) = segment
        {
            if start.is_none() {
                (entry.bytes, entry.messages) = (0, 0);
                (entry.start, entry.end) = (None, None);
            }
            if is_full(error) {
                let _ = file.truncate(entry.bytes);
            }
        }
        entry.number
    }

    fn update_entry(&mut self, state: SegmentState) {
        if let (Some(segment), Some(entry)) = (&self.segment, self.manifest.segments.last_mut()) {
            entry.state = state;
            entry.bytes = segment.encoder.position();
            entry.messages = segment.encoder.counts().values().sum();
            let bounds = segment.encoder.bounds();
            entry.start = bounds.map(|(start, _)| HostTime(start as i64));
            entry.end = bounds.map(|(_, end)| HostTime(end as i64));
        }
    }

    fn write_manifest(&self) -> io::Result<()> {
        storage::replace(&*self.storage, layout::MANIFEST, &self.manifest.to_bytes())
    }

    /// What is written in place of a chunk that the disk refused twice: the same chunk, which is
    /// small now because gap records stand for its samples, and an event that says so. Numbers
    /// that the chunk has gap records for keep those; sets that name a lost frame go with it.
    fn substitute(&mut self, bytes: &[u8], error: &io::Error) -> (Vec<Gap>, Vec<u8>) {
        let log = chunk_bounds(bytes).0.0.max(0) as u64;
        let streams = &self.manifest.streams;
        let lost: Vec<Gap> = runs(samples(bytes, streams))
            .into_iter()
            .flat_map(|(stream, runs)| {
                let mut before = self.manifest.extents.get(&stream).map(|e| e.end.0);
                runs.into_iter().map(move |run| Gap {
                    time_before: before.replace(run.end.0),
                    stream: stream.clone(),
                    first: run.first,
                    last: run.last,
                    cause: paws::gap::Cause::Storage.into(),
                    time_after: None,
                    detail: error.to_string(),
                })
            })
            .collect();
        let is_lost = |camera: &str, number: u64| {
            let mut gaps = lost.iter();
            gaps.any(|g| g.stream == camera && (g.first..=g.last).contains(&number))
        };
        let mut chunk = ChunkBuilder::default();
        for m in messages(bytes) {
            let kept = stream_of(streams, &m).is_some_and(|s| {
                !is_sampled(s) && members(s, &m).all(|(camera, number)| !is_lost(&camera, number))
            });
            if kept {
                chunk.message(
                    m.channel_id,
                    m.sequence,
                    m.log_time,
                    m.publish_time,
                    |out| {
                        out.extend_from_slice(m.data);
                    },
                );
            }
        }
        if let Some(id) = self.manifest.stream::<Gap>("").map(|s| s.id) {
            for gap in &lost {
                let sequence = self.take_sequence(id);
                chunk.message(id, sequence, log, log, |out| encode(gap, out));
            }
        }
        if let Some(id) = self.manifest.stream::<Event>("").map(|s| s.id) {
            let event = Event {
                kind: paws::event::Kind::Fault.into(),
                source: "disk".to_owned(),
                text: format!("the samples of a chunk could not be written: {error}"),
            };
            let sequence = self.take_sequence(id);
            chunk.message(id, sequence, log, log, |out| encode(&event, out));
        }
        (lost, chunk.finish())
    }

    /// Widens what the manifest says of the numbered streams by a chunk that is on disk.
    fn update_extents(&mut self, bytes: &[u8]) {
        let streams = &self.manifest.streams;
        for (name, more) in extents(samples(bytes, streams).chain(gaps(bytes, streams))) {
            let known = self.manifest.extents.entry(name).or_insert(more);
            known.cover(more);
        }
    }
}

/// The first chunk of a segment: schemas, channels, who the segment is, and the state of the
/// session so far as (channel, sequence, message), so that the segment can be read alone. In a
/// chunk, because only chunks have a checksum that holds while the file still grows.
pub(crate) fn head_chunk<'a>(
    identity: &Segment,
    streams: &[Stream],
    time: HostTime,
    states: impl Iterator<Item = (u16, u32, &'a [u8])>,
) -> Vec<u8> {
    let mut head = ChunkBuilder::default();
    let log = time.0.max(0) as u64;
    for (schema, id) in record::SCHEMAS.iter().zip(1..) {
        head.schema(id, schema);
    }
    for stream in streams {
        let schema = record::SCHEMAS.iter().position(|s| s.name == stream.schema);
        let schema_id = schema.map_or(0, |i| i as u16 + 1);
        let metadata = BTreeMap::from([("of".to_owned(), stream.of.clone())]);
        head.channel(stream.id, schema_id, &stream.topic, &metadata);
    }
    let own = streams
        .iter()
        .find(|s| s.schema == Segment::SCHEMA.name)
        .map_or(1, |s| s.id);
    head.message(own, identity.number, log, log, |out| encode(identity, out));
    for (id, sequence, data) in states {
        head.message(id, sequence, log, log, |out| out.extend(data));
    }
    head.finish()
}

/// Whether there is no room left, rather than something broken.
fn is_full(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded
    )
}

/// Appends a protobuf message; a `Vec` grows, so encoding into it cannot fail.
fn encode(message: &impl Protobuf, out: &mut Vec<u8>) {
    message.encode_raw(out);
}
