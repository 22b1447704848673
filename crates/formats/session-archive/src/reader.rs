//! Reading a session.
//!
//! [`SessionReader::open`] takes any session folder, also one that was cut off or damaged: the
//! manifest is rebuilt from the segments if need be. [`SessionReader::entries`] goes through the
//! session in the order written, one chunk in memory at a time, every checksum checked; damage is
//! an entry like any other and never ends the iteration early. Random access goes through
//! [`crate::index`].
//!
//! The order is the order written: each stream is in the order of its numbers, streams are
//! interleaved to within a chunk. The heads of segments after the first repeat state; of what they
//! repeat, only what was not seen before is passed on, because its chunk is missing or damaged.
//! A segment whose head names another segment is damage, and nothing in it is passed on. A message
//! that no recorder can have written ([`DamageKind::Impossible`]) is damage as well.

use std::collections::{BTreeMap, VecDeque};
use std::io;
use std::sync::Arc;

use crate::foreign::{McapFile, identify};
use crate::impossible::impossible;
use crate::layout;
use crate::manifest::{
    Manifest, ManifestError, SegmentEntry, SegmentState, State, Stream, is_state,
};
use crate::mcap::{CHUNK_PREFIX, Record as McapRecord};
use crate::record::{Protobuf, Record, Segment};
use crate::roles::Roles;
use crate::scan::{Damage, DamageKind, End, Item, Scan, VerifiedChunk};
use crate::storage::{ReadAt, Storage};

mod message;

pub use message::Message;

/// Maximum number of consecutive missing segments: a file with a number farther beyond the others
/// does not belong to the session. A segment lasts a minute, so this is most of a day.
const MAX_HOLE: u32 = 1000;

/// Why a session cannot be read at all. Damage within it is not among these.
#[derive(Debug, thiserror::Error)]
pub enum ReadError {
    /// The folder holds neither a manifest nor a segment.
    #[error("no session here: neither {manifest} nor {dir}/ with a readable segment",
        manifest = layout::MANIFEST, dir = layout::SEGMENTS)]
    NoSession,
    /// In the place of a segment is an MCAP file of another profile: convert it.
    #[error(
        "no session here: {path} is {file}; expected the profile {profile:?}; `pawsd record` makes a session of a ROS 2 \
         bag, as a source of kind = \"bag\"", profile = crate::writer::PROFILE
    )]
    OtherProfile {
        /// The file.
        path: String,
        /// What it is.
        file: Box<McapFile>,
    },
    /// The manifest was written by a newer version, or cannot be read.
    #[error(transparent)]
    Manifest(#[from] ManifestError),
    /// The file system reports an I/O error.
    #[error("reading {path}")]
    Io {
        /// What was being read.
        path: String,
        /// What failed.
        #[source]
        error: io::Error,
    },
}

/// An item found while reading a session.
#[derive(Clone, Debug)]
pub enum Entry {
    /// A message whose chunk's checksum holds.
    Message(Message),
    /// Bytes of a segment that cannot be used.
    Damage {
        /// The segment.
        segment: u32,
        /// Range and cause.
        damage: Damage,
    },
    /// A segment ended.
    SegmentEnd {
        /// The segment.
        segment: u32,
        /// How.
        end: End,
    },
    /// A segment that should be there is not.
    SegmentMissing {
        /// The segment.
        segment: u32,
    },
}

/// A session opened for reading.
#[derive(Clone)]
pub struct SessionReader {
    storage: Arc<dyn Storage>,
    manifest: Manifest,
    manifest_note: Option<String>,
    files: Vec<SegmentFile>,
    /// Numbers of files in the folder of the segments that cannot be the session's.
    strangers: Vec<u32>,
}

/// A segment file and how much of it counts.
#[derive(Clone, Debug)]
struct SegmentFile {
    number: u32,
    present: bool,
    /// Number of valid bytes, where the writer stated it; else the whole file is valid.
    limit: Option<u64>,
    /// Number of bytes that the writer recorded as written.
    expected: u64,
    /// Whether the writer closed it, so that it has these bytes and no more.
    closed: bool,
}

impl SegmentFile {
    /// The damage of a file that has `length` bytes instead of the stated number.
    fn wrong_length(&self, length: u64) -> Option<Damage> {
        (self.closed && length != self.expected).then(|| Damage {
            bytes: length.min(self.expected)..length.max(self.expected),
            kind: DamageKind::Length,
        })
    }
}

impl SessionReader {
    /// Opens the session in a folder.
    ///
    /// # Errors
    /// See [`ReadError`]; a damaged session is not an error. A FIFO, a device, a socket or a link
    /// in the place of a file is one: [`ReadError::Io`], with [`plain_file::NotPlain`] as the
    /// cause.
    pub fn open(storage: Arc<dyn Storage>) -> Result<Self, ReadError> {
        let mut found = segment_files(&*storage)?;
        let mut strangers = Vec::new();
        let (manifest, manifest_note) = match Manifest::read(&*storage) {
            Ok(manifest) => (manifest, None),
            Err(e @ ManifestError::TooNew { .. }) => return Err(e.into()),
            // Not damage: something other than a file was put in its place.
            Err(ManifestError::Io(error)) if plain_file::is_not_plain(&error) => {
                let path = layout::MANIFEST.to_owned();
                return Err(ReadError::Io { path, error });
            }
            Err(e) => {
                let note = match &e {
                    ManifestError::Io(io) if io.kind() == io::ErrorKind::NotFound => {
                        format!("{} is missing", layout::MANIFEST)
                    }
                    e => e.to_string(),
                };
                strangers = take_strangers(&mut found, 0);
                (rebuild_manifest(&*storage, &found)?, Some(note))
            }
        };
        for file in &manifest.rig {
            let path = layout::rig_file(&file.name);
            match storage.open(&path) {
                Err(error) if plain_file::is_not_plain(&error) => {
                    return Err(ReadError::Io { path, error });
                }
                _ => {}
            }
        }
        strangers.extend(take_strangers(&mut found, manifest.segments.len() as u32));
        let last = found
            .last()
            .copied()
            .max(manifest.segments.last().map(|s| s.number));
        let files = (0..last.map_or(0, |n| n + 1))
            .map(|number| {
                let entry = manifest.segments.get(number as usize);
                let given_up = entry.filter(|e| e.state == SegmentState::GivenUp);
                SegmentFile {
                    number,
                    present: found.binary_search(&number).is_ok(),
                    limit: given_up.map(|e| e.bytes),
                    expected: entry.map_or(0, |e| e.bytes),
                    closed: entry.is_some_and(|e| e.state == SegmentState::Closed),
                }
            })
            .collect();
        let mut reader = Self {
            storage,
            manifest,
            manifest_note,
            files,
            strangers,
        };
        if reader.manifest.state == State::Recording {
            reader.limits_from_heads()?;
        }
        Ok(reader)
    }

    /// The manifest; rebuilt if [`Self::manifest_note`] says so.
    pub fn manifest(&self) -> &Manifest {
        &self.manifest
    }

    /// What was wrong with the manifest, if it was rebuilt from the segments.
    pub fn manifest_note(&self) -> Option<&str> {
        self.manifest_note.as_deref()
    }

    /// The storage.
    pub fn storage(&self) -> &Arc<dyn Storage> {
        &self.storage
    }

    /// The stream with this channel id.
    pub fn stream(&self, id: u16) -> Option<&Stream> {
        self.manifest.streams.iter().find(|s| s.id == id)
    }

    /// Numbers of the segments that the session has or should have.
    pub fn segment_numbers(&self) -> impl Iterator<Item = u32> + '_ {
        self.files.iter().map(|f| f.number)
    }

    /// Bytes in the segments that are there.
    ///
    /// # Errors
    /// The file system reports an I/O error.
    pub fn bytes(&self) -> Result<u64, ReadError> {
        let mut sum = 0;
        for file in self.files.iter().filter(|f| f.present) {
            let path = layout::segment(file.number);
            let length = self.storage.open(&path).and_then(|f| f.len());
            sum += length.map_err(|error| ReadError::Io { path, error })?;
        }
        Ok(sum)
    }

    /// Everything in the session, in the order written.
    pub fn entries(&self) -> Entries<'_> {
        Entries {
            reader: self,
            segment: 0,
            open: None,
            queue: VecDeque::new(),
            head_seen: false,
            strangers: self.strangers.iter(),
            roles: Roles::new(&self.manifest),
            states: (self.manifest.streams.iter())
                .filter(|s| is_state(s))
                .map(|s| (s.id, None))
                .collect(),
        }
    }

    /// The chunks and damage of one segment, in the order written; how it ended comes last.
    ///
    /// # Errors
    /// The segment's file cannot be opened.
    pub fn segment(&self, number: u32) -> Result<SegmentScan, ReadError> {
        let known = self.files.get(number as usize);
        let (limit, expected) = known.map_or((None, 0), |f| (f.limit, f.expected));
        SegmentScan::open(&*self.storage, number, limit, expected)
    }

    /// Every segment's head says how much of the segment before it counts: what lies behind was
    /// written again. The manifest may be older than the heads.
    fn limits_from_heads(&mut self) -> Result<(), ReadError> {
        for i in 1..self.files.len() {
            if !self.files[i].present {
                continue;
            }
            let number = self.files[i].number;
            let head = self.segment(number)?.head()?;
            if let Some(head) = head
                && !self.is_foreign(number, &head)
            {
                let before = &mut self.files[i - 1];
                before.limit = Some(head.previous_valid_bytes);
                before.expected = head.previous_valid_bytes;
            }
        }
        Ok(())
    }

    /// Whether the segment with this head is not what its file's name says.
    pub(crate) fn is_foreign(&self, number: u32, head: &Segment) -> bool {
        head.session_id != self.manifest.session_id || head.number != number
    }
}

/// Takes the numbers out of `found` that lie beyond a hole that no session has; `next` is what
/// comes after the manifest's last.
fn take_strangers(found: &mut Vec<u32>, mut next: u32) -> Vec<u32> {
    let is_far = |number: &u32| {
        let far = *number > next.saturating_add(MAX_HOLE);
        next = next.max(number.saturating_add(1));
        far
    };
    match found.iter().position(is_far) {
        Some(at) => found.split_off(at),
        None => Vec::new(),
    }
}

fn segment_files(storage: &dyn Storage) -> Result<Vec<u32>, ReadError> {
    let names = storage
        .list(layout::SEGMENTS)
        .map_err(|error| ReadError::Io {
            path: layout::SEGMENTS.to_owned(),
            error,
        })?;
    Ok(names
        .iter()
        .filter_map(|n| layout::segment_number(n))
        .collect())
}

/// The manifest as the first readable segment repeats it, with the segments that are there.
fn rebuild_manifest(storage: &dyn Storage, found: &[u32]) -> Result<Manifest, ReadError> {
    for &number in found {
        let Some(head) = SegmentScan::open(storage, number, None, 0)?.head()? else {
            continue;
        };
        let mut manifest = Manifest::from_identity(&head.manifest)?;
        let entry = |number| SegmentEntry {
            number,
            state: SegmentState::Open,
            bytes: 0,
            start: None,
            end: None,
            messages: 0,
        };
        manifest.segments = (0..=found.last().copied().unwrap_or(0))
            .map(entry)
            .collect();
        return Ok(manifest);
    }
    for &number in found {
        let path = layout::segment(number);
        let failed = |error| ReadError::Io {
            path: path.clone(),
            error,
        };
        let file = storage.open(&path).map_err(failed)?;
        if let Some(file) = identify(&*file).map_err(failed)?
            && file.profile != crate::writer::PROFILE
        {
            let file = Box::new(file);
            return Err(ReadError::OtherProfile { path, file });
        }
    }
    Err(ReadError::NoSession)
}

/// One segment, opened.
pub struct SegmentScan {
    file: Arc<dyn ReadAt>,
    path: String,
    limit: Option<u64>,
    expected: u64,
}

impl SegmentScan {
    fn open(
        storage: &dyn Storage,
        number: u32,
        limit: Option<u64>,
        expected: u64,
    ) -> Result<Self, ReadError> {
        let path = layout::segment(number);
        match storage.open(&path) {
            Ok(file) => Ok(Self {
                file: file.into(),
                path,
                limit,
                expected,
            }),
            Err(error) => Err(ReadError::Io { path, error }),
        }
    }

    /// A scan of the segment from its start.
    ///
    /// # Errors
    /// The file system reports an I/O error.
    pub fn scan(&self) -> Result<Scan, ReadError> {
        Scan::new(self.file.clone(), self.limit, self.expected).map_err(|e| self.failed(e))
    }

    /// The open file.
    pub fn file(&self) -> &Arc<dyn ReadAt> {
        &self.file
    }

    /// The whole file as damage: it does not belong to the session.
    fn foreign(&self) -> Result<Damage, ReadError> {
        let length = self.file.len().map_err(|e| self.failed(e))?;
        Ok(Damage {
            bytes: 0..length,
            kind: DamageKind::Foreign,
        })
    }

    pub(crate) fn failed(&self, error: io::Error) -> ReadError {
        ReadError::Io {
            path: self.path.clone(),
            error,
        }
    }

    /// The first chunk whose checksum holds: the head, if the segment has one.
    pub(crate) fn first_chunk(&self) -> Result<Option<VerifiedChunk>, ReadError> {
        let mut scan = self.scan()?;
        while let Some(item) = scan.next_item().map_err(|e| self.failed(e))? {
            if let Item::Chunk(chunk) = item {
                return Ok(Some(chunk));
            }
        }
        Ok(None)
    }

    /// The identity that the segment's head states, if the head can be read.
    fn head(&self) -> Result<Option<Segment>, ReadError> {
        Ok(self.first_chunk()?.as_ref().and_then(head_of))
    }
}

/// The identity of the segment that a head chunk states; `None` if the chunk is not a head.
pub(crate) fn head_of(chunk: &VerifiedChunk) -> Option<Segment> {
    let mut schema = None;
    let mut channel = None;
    for record in chunk.iter().map_while(Result::ok) {
        match record {
            McapRecord::Schema(s) if s.name == Segment::SCHEMA.name => schema = Some(s.id),
            McapRecord::Channel(c) if Some(c.schema_id) == schema => channel = Some(c.id),
            McapRecord::Message(m) => {
                return (Some(m.channel_id) == channel)
                    .then(|| Segment::decode(m.data).ok())
                    .flatten();
            }
            _ => {}
        }
    }
    None
}

/// Iterates over everything in a session.
pub struct Entries<'a> {
    reader: &'a SessionReader,
    /// Index of the segment that is being read, or comes next.
    segment: usize,
    open: Option<OpenScan>,
    queue: VecDeque<Entry>,
    head_seen: bool,
    /// Files that come last, as damage.
    strangers: std::slice::Iter<'a, u32>,
    roles: Roles,
    /// Sequence number of the newest message passed on of every stream that holds state.
    states: BTreeMap<u16, Option<u32>>,
}

struct OpenScan {
    segment: SegmentScan,
    scan: Scan,
    at_start: bool,
    damaged: bool,
}

impl Entries<'_> {
    /// Reads on by one chunk, one range of damage, or one segment's start or end; false at the end.
    fn advance(&mut self) -> Result<bool, ReadError> {
        let Some(file) = self.reader.files.get(self.segment) else {
            return self.stranger();
        };
        let number = file.number;
        let Some(open) = &mut self.open else {
            if file.present {
                let segment = self.reader.segment(number)?;
                let scan = segment.scan()?;
                self.open = Some(OpenScan {
                    segment,
                    scan,
                    at_start: true,
                    damaged: false,
                });
            } else {
                self.segment += 1;
                // A segment that was given up while it was empty does not count as missing.
                if file.limit != Some(0) {
                    self.queue
                        .push_back(Entry::SegmentMissing { segment: number });
                }
            }
            return Ok(true);
        };
        match open.scan.next_item().map_err(|e| open.segment.failed(e))? {
            Some(Item::Damage(damage)) => {
                open.damaged = true;
                self.push_damage(number, damage);
            }
            Some(Item::Chunk(chunk)) => {
                let head = std::mem::take(&mut open.at_start)
                    .then(|| head_of(&chunk))
                    .flatten();
                if let Some(head) = &head
                    && self.reader.is_foreign(number, head)
                {
                    let damage = open.segment.foreign()?;
                    self.push_damage(number, damage);
                    self.open = None;
                    self.segment += 1;
                    return Ok(true);
                }
                let is_head = head.is_some();
                self.push_messages(number, &chunk, is_head);
                self.head_seen |= is_head;
            }
            None => {
                let end = open.scan.end().unwrap_or(End::Open);
                let length = open.scan.position();
                if let (false, Some(damage)) = (open.damaged, file.wrong_length(length)) {
                    self.push_damage(number, damage);
                }
                self.queue.push_back(Entry::SegmentEnd {
                    segment: number,
                    end,
                });
                self.open = None;
                self.segment += 1;
            }
        }
        Ok(true)
    }

    /// Files that cannot belong to the session are reported last.
    fn stranger(&mut self) -> Result<bool, ReadError> {
        let Some(&number) = self.strangers.next() else {
            return Ok(false);
        };
        let segment = SegmentScan::open(&**self.reader.storage(), number, None, 0)?;
        let damage = segment.foreign()?;
        self.push_damage(number, damage);
        Ok(true)
    }

    fn push_damage(&mut self, segment: u32, damage: Damage) {
        self.queue.push_back(Entry::Damage { segment, damage });
    }

    fn push_messages(&mut self, segment: u32, chunk: &VerifiedChunk, is_head: bool) {
        let base = chunk.records.as_ptr() as usize;
        let mut left_out = impossible(&chunk.records, &self.roles)
            .into_iter()
            .peekable();
        for m in chunk.messages().map_while(Result::ok) {
            let payload_offset = m.data.as_ptr() as usize - base;
            if let Some(range) = left_out.next_if(|range| range.contains(&payload_offset)) {
                let at = chunk.offset + CHUNK_PREFIX as u64;
                let damage = Damage {
                    bytes: at + range.start as u64..at + range.end as u64,
                    kind: DamageKind::Impossible,
                };
                self.push_damage(segment, damage);
                continue;
            }
            match self.states.get_mut(&m.channel_id) {
                Some(seen) if is_head && seen.is_some_and(|s| s >= m.sequence) => continue,
                Some(seen) => *seen = Some(m.sequence),
                None if is_head && self.head_seen => continue,
                None => {}
            }
            let message = Message::of_chunk(segment, chunk, &m);
            self.queue.push_back(Entry::Message(message));
        }
    }
}

impl Iterator for Entries<'_> {
    type Item = Result<Entry, ReadError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            if let Some(entry) = self.queue.pop_front() {
                return Some(Ok(entry));
            }
            match self.advance() {
                Ok(true) => {}
                Ok(false) => return None,
                Err(e) => {
                    // A segment that cannot be opened or read is skipped, so that the iteration
                    // ends.
                    self.open = None;
                    self.segment += 1;
                    return Some(Err(e));
                }
            }
        }
    }
}
