//! Writing a session.
//!
//! Messages are collected into a chunk; a closed chunk is one write and one sync. What is on disk
//! is known at any time ([`SessionWriter::durability`]), what may still be lost is at most the
//! chunk in the making.
//!
//! * **Chunks begin with key frames.** A chunk is an *epoch* of [`SessionSpec::chunk_ns`] on the
//!   log-time axis, counted from the host clock's zero: the same count is used to force key frames.
//!   A camera enters the next epoch with its first key frame there; until every camera that
//!   delivers has done so, two chunks are open, and messages of the cameras that are ahead wait in
//!   the second. A camera that sends no key frame in time does not hold the others up: no chunk is
//!   open longer than [`MAX_CHUNK_NS`].
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
    FORMAT, FORMAT_VERSION, Manifest, RigFile, State, Stop, is_state, stream_table,
};
use crate::mcap::ChunkBuilder;
use crate::record::{CompressedVideo, Frame, Record, timestamp};
use crate::storage::Storage;
use crate::time::HostTime;

mod contents;
mod durability;
mod head_chunk;
mod open_segment;
mod segments;
mod spec;
mod video;

pub use durability::Durability;
pub(crate) use head_chunk::head_chunk;
pub use spec::*;

use head_chunk::encode;
use open_segment::OpenSegment;
use video::VideoRef;

/// Progress of one camera.
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
        // What cannot be read back (a rate that is not finite, for example) must not be written.
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

    /// Failures since the last call that the writer has recovered from, to be shown to the user.
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
    /// succeeds, as [`Durability`] says, and [`Self::take_incidents`] reports what went wrong
    /// meanwhile. After a fatal error it still writes the manifest if the disk lets it.
    ///
    /// # Errors
    /// See [`WriteError`]; [`WriteError::Finished`] after a fatal error, which was returned when it
    /// happened. The session can nevertheless be opened, up to what was durable.
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

    /// How long the oldest message that is not written yet has waited on the log-time axis, ns. It
    /// may be in the next chunk, where a camera lags behind the other streams.
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
}
