//! Recovers a whole session from one that was cut off or damaged.
//!
//! Recovery only reads the source. It writes a new session beside it: every chunk whose checksum
//! held is copied byte for byte, every segment gets its summary, and what is missing without a gap
//! record gets one with cause `CAUSE_DAMAGED`. Of a chunk whose checksum does not hold, everything
//! but the damaged frames is copied if the checksums of its access units prove it sound
//! (`salvage.rs`) and they bring no fault that the source does not have (a number twice, as of a
//! chunk of which a sound copy is elsewhere), else nothing. Nothing that failed its checksum is
//! copied, so no fresh checksum is ever put over damaged bytes; nor is a message that no recorder
//! can have written (`impossible.rs`). The copy is verified before it is called good.
//!
//! Where nothing is damaged and only the end is cut off, the segments are, byte for byte, those
//! that a clean close of the same chunks would have left. A chunk that was only partly written is
//! not salvaged.
//!
//! [`close_cut_off`] does the same in place, for the recorder that finds its own session cut off:
//! where nothing is damaged, the segments that were open are rewritten beside themselves and put in
//! their place in one step.

use std::collections::BTreeMap;
use std::io;
use std::sync::Arc;

use bytes::Bytes;

use crate::impossible::{impossible, without};
use crate::layout;
use crate::manifest::{Extent, Manifest, SegmentEntry, SegmentState, State, Stop, is_state};
use crate::mcap::{ChunkBuilder, RECORD_HEADER, SegmentEncoder, sealed_chunk};
use crate::reader::{Message, ReadError, SegmentScan, SessionReader, head_of};
use crate::record::{Event, Gap, Protobuf, Segment, paws};
use crate::roles::Roles;
use crate::salvage::salvage;
use crate::scan::{CHUNK_LIMIT, Damage, DamageKind, Item, VerifiedChunk};
use crate::storage::{self, Storage};
use crate::time::HostTime;
use crate::verify::{Check, LostSamples, Report, Vacant, check, rig_file, verify};
use crate::writer::{LIBRARY, PROFILE, head_chunk};

/// Appended to the name of a segment that is rewritten.
const CLOSING: &str = ".closing";

/// Why a session could not be recovered. The source is as it was.
#[derive(Debug, thiserror::Error)]
pub enum RecoverError {
    /// The source cannot be read.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The copy cannot be written: free the disk or choose another folder, and start again with
    /// an empty one.
    #[error("writing the recovered copy")]
    Write(#[source] io::Error),
    /// More than the end is missing: recover it into another folder.
    #[error(
        "more than the end is missing or damaged; `paws recover` makes a copy of what can be used"
    )]
    Damaged(Box<Report>),
    /// The copy is not sound; it must not be used. A defect of this program.
    #[error("the recovered copy did not pass verification")]
    NotSound(Box<Report>),
}

/// What recovery found and made.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Recovery {
    /// What was found in the source.
    pub source: Report,
    /// What the copy holds.
    pub copy: Report,
    /// Chunks whose checksum did not hold and of which messages were saved.
    pub saved_chunks: u64,
    /// Messages saved of them.
    pub saved_messages: u64,
    /// Samples that could not be recovered: the gap records that recovery wrote. Fewer than the
    /// source's, which a reader finds lost, by those that were saved.
    pub lost: Vec<LostSamples>,
}

/// Recovers a session into an empty storage.
///
/// # Errors
/// See [`RecoverError`].
///
/// ```
/// use std::sync::Arc;
///
/// use session_archive::reader::SessionReader;
/// use session_archive::recover::recover;
/// use session_archive::storage::{DiskStorage, FaultStorage};
/// # use session_archive::{layout, storage::read_all};
///
/// # let folder = DiskStorage::new(concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/v1"));
/// # let damaged = Arc::new(FaultStorage::new());
/// # for path in [layout::MANIFEST, &layout::segment(0), &layout::rig_file("rig.toml")] {
/// #     damaged.set_content(path, read_all(&folder, path)?);
/// # }
/// # let mut segment = damaged.content("segments/000000.mcap").ok_or("no segment")?;
/// # let in_an_access_unit = segment.len() / 2 + 8;
/// # segment[in_an_access_unit] ^= 1;
/// # damaged.set_content("segments/000000.mcap", segment);
/// // One bit of an image is wrong: the chunk around it fails its checksum.
/// let source = SessionReader::open(damaged)?;
/// let target = tempfile::tempdir()?;
/// let recovered = recover(&source, Arc::new(DiskStorage::new(target.path())), |_| {})?;
/// assert!(!recovered.source.is_sound());
/// assert!(recovered.copy.is_sound());
/// // All but the frame around that bit was saved, and that frame has a gap record.
/// assert_eq!((recovered.saved_chunks, recovered.lost.len()), (1, 1));
/// let camera = &recovered.copy.streams["left_shoulder"];
/// assert_eq!(camera.gaps, 1);
/// assert_eq!(camera.samples + camera.gaps, camera.expected());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn recover(
    source: &SessionReader,
    target: Arc<dyn Storage>,
    mut progress: impl FnMut(u64),
) -> Result<Recovery, RecoverError> {
    let check = check(source, &mut progress)?;
    let vacant = check.vacant();
    let report = check.finish();
    let mut copy = Copy::new(source, &*target, vacant)?;
    for number in source.segment_numbers() {
        copy.segment(number)?;
    }
    let found = std::mem::replace(&mut copy.check, Check::new(source)).finish();
    copy.finish(&found)?;
    let (saved_chunks, saved_messages) = (copy.saved_chunks, copy.saved_messages);
    let reader = SessionReader::open(target)?;
    let checked = verify(&reader, progress)?;
    if has_new_faults(&report, &checked) {
        return Err(RecoverError::NotSound(Box::new(checked)));
    }
    Ok(Recovery {
        source: report,
        copy: checked,
        saved_chunks,
        saved_messages,
        lost: found.lost,
    })
}

/// Closes a session that was cut off and is damaged nowhere else, in place; none if it was closed
/// already. The report states what was found. It may be interrupted at any point and repeated;
/// where it fails, it leaves nothing behind that takes up space.
///
/// # Errors
/// [`RecoverError::Damaged`], and then nothing has been changed; or see [`RecoverError`].
///
/// ```
/// use std::sync::Arc;
///
/// use session_archive::manifest::{Manifest, State};
/// use session_archive::record::Event;
/// use session_archive::recover::close_cut_off;
/// # use session_archive::storage::{CrashKind, FaultStorage};
/// # use session_archive::time::{CivilTime, HostTime};
/// # let spec = session_archive::writer::SessionSpec {
/// #     session_id: "0192aa00-0000-7000-8000-00000000000f".to_owned(),
/// #     name: String::new(),
/// #     software: "example".to_owned(),
/// #     started: HostTime(0),
/// #     started_civil: CivilTime(0),
/// #     chunk_ns: 500_000_000,
/// #     cameras: Vec::new(),
/// #     imus: Vec::new(),
/// #     rig: Vec::new(),
/// # };
/// # let disk = FaultStorage::new();
/// # let mut writer = session_archive::writer::SessionWriter::create(Arc::new(disk.clone()), spec)?;
/// writer.append("", HostTime(100), HostTime(100), &Event::default())?;
/// writer.poll(HostTime(2_000_000_000))?; // one chunk is on disk
/// let found = Arc::new(disk.crash(CrashKind::UnsyncedDropped)); // the power goes
///
/// let report = close_cut_off(found.clone())?.ok_or("it was closed already")?;
/// assert!(report.is_only_cut_off());
/// assert_ne!(Manifest::read(&*found)?.state, State::Recording);
/// assert!(close_cut_off(found)?.is_none());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn close_cut_off(storage: Arc<dyn Storage>) -> Result<Option<Report>, RecoverError> {
    let source = SessionReader::open(storage.clone())?;
    if source.manifest().state != State::Recording {
        return Ok(None);
    }
    let report = verify(&source, |_| {})?;
    if !report.is_only_cut_off() {
        return Err(RecoverError::Damaged(Box::new(report)));
    }
    let done = close_in_place(&source, &*storage, &report);
    if done.is_err() {
        for number in source.segment_numbers() {
            let _ = storage.remove(&beside(number));
        }
    }
    done.map(|()| Some(report))
}

fn close_in_place(
    source: &SessionReader,
    storage: &dyn Storage,
    report: &Report,
) -> Result<(), RecoverError> {
    let closed: BTreeMap<u32, SegmentEntry> = source
        .manifest()
        .segments
        .iter()
        .filter(|entry| entry.state == SegmentState::Closed)
        .map(|entry| (entry.number, entry.clone()))
        .collect();
    let mut copy = Copy::in_place(source, storage);
    let mut written = Vec::new();
    for number in source.segment_numbers() {
        match closed.get(&number) {
            Some(entry) => copy.keep(entry.clone())?,
            None => {
                // What an earlier try left.
                let _ = storage.remove(&beside(number));
                copy.segment(number)?;
                written.push(number);
            }
        }
    }
    copy.end_segment().map_err(RecoverError::Write)?;
    for number in written {
        storage
            .rename(&beside(number), &layout::segment(number))
            .map_err(RecoverError::Write)?;
    }
    copy.finish(report)
}

/// Where a segment is rewritten before it takes its place.
fn beside(number: u32) -> String {
    layout::segment(number) + CLOSING
}

/// Whether the copy has a fault that the source did not have: what was recorded wrongly (a number
/// twice, an undecodable message) with a checksum that holds is copied as it is.
fn has_new_faults(source: &Report, copy: &Report) -> bool {
    !copy.damage.is_empty()
        || !copy.missing_segments.is_empty()
        || copy.manifest_note.is_some()
        || !copy.open_segments.is_empty()
        || copy.undecodable > source.undecodable
        || !copy.lost.is_empty()
        || !copy.bad_rig_files.is_empty()
        || copy.streams.iter().any(|(name, copy)| {
            let source = source.streams.get(name).cloned().unwrap_or_default();
            copy.repeated > source.repeated
                || copy.contradicted > source.contradicted
                || copy.bad_payloads > source.bad_payloads
        })
}

struct Copy<'a> {
    source: &'a SessionReader,
    target: &'a dyn Storage,
    manifest: Manifest,
    /// Appended to the segments' names.
    suffix: &'static str,
    /// Bytes of the last segment in the source and in the copy, to see whether heads still hold.
    copied_bytes: u64,
    /// The newest message of every stream that holds state, for segments whose head is missing.
    states: BTreeMap<u16, (u32, Vec<u8>)>,
    /// The newest segment, not yet ended: the gap records go to its end.
    open: Option<(u32, SegmentEncoder, Box<dyn storage::WriteFile>)>,
    newest: HostTime,
    roles: Roles,
    /// Of everything that was copied.
    check: Check,
    /// What may be saved of damaged chunks.
    vacant: Vacant,
    saved_chunks: u64,
    saved_messages: u64,
}

impl<'a> Copy<'a> {
    fn new(
        source: &'a SessionReader,
        target: &'a dyn Storage,
        vacant: Vacant,
    ) -> Result<Self, RecoverError> {
        let manifest = Manifest {
            state: State::Recovered,
            segments: Vec::new(),
            stopped: source.manifest().stopped.clone(),
            ..source.manifest().clone()
        };
        let mut copy = Self::with(source, target, manifest, "");
        copy.vacant = vacant;
        copy.rig().map_err(RecoverError::Write)?;
        Ok(copy)
    }

    /// Segments go beside those of the source; everything else remains.
    fn in_place(source: &'a SessionReader, storage: &'a dyn Storage) -> Self {
        let manifest = Manifest {
            state: State::Recovered,
            segments: Vec::new(),
            ..source.manifest().clone()
        };
        Self::with(source, storage, manifest, CLOSING)
    }

    fn with(
        source: &'a SessionReader,
        target: &'a dyn Storage,
        manifest: Manifest,
        suffix: &'static str,
    ) -> Self {
        Self {
            source,
            target,
            suffix,
            copied_bytes: 0,
            states: BTreeMap::new(),
            open: None,
            newest: manifest.started,
            roles: Roles::new(&manifest),
            check: Check::new(source),
            vacant: Vacant::default(),
            saved_chunks: 0,
            saved_messages: 0,
            manifest,
        }
    }

    fn path(&self, number: u32) -> String {
        layout::segment(number) + self.suffix
    }

    /// A segment that needs no repair.
    fn keep(&mut self, entry: SegmentEntry) -> Result<(), RecoverError> {
        self.end_segment().map_err(RecoverError::Write)?;
        self.copied_bytes = entry.bytes;
        self.newest = self.newest.max(entry.end.unwrap_or(self.newest));
        self.manifest.segments.push(entry);
        Ok(())
    }

    /// Copies the rig's files; one that is missing or altered is left out, and its entry with it.
    fn rig(&mut self) -> io::Result<()> {
        self.target.create_dir(layout::SEGMENTS)?;
        self.target.create_dir(layout::RIG)?;
        for file in std::mem::take(&mut self.manifest.rig) {
            if let Some(content) = rig_file(&**self.source.storage(), &file) {
                let mut out = self.target.create(&layout::rig_file(&file.name))?;
                out.append(&content)?;
                out.sync_data()?;
                self.manifest.rig.push(file);
            }
        }
        self.target.sync_dir(layout::RIG)
    }

    /// Copies what can be used of one segment. A segment that has nothing keeps its number and
    /// a head, so that numbers stay what they were.
    fn segment(&mut self, number: u32) -> Result<(), RecoverError> {
        self.end_segment().map_err(RecoverError::Write)?;
        let opened = match self.source.segment(number) {
            Ok(segment) => Some(segment),
            Err(ReadError::Io { error, .. }) if error.kind() == io::ErrorKind::NotFound => None,
            Err(e) => return Err(e.into()),
        };
        let first = opened.as_ref().map(SegmentScan::first_chunk).transpose()?;
        let head = first.flatten().filter(|chunk| head_of(chunk).is_some());
        let identity = head.as_ref().and_then(head_of);
        // Nothing in a foreign file belongs to the session.
        let is_foreign = identity.is_some_and(|head| self.source.is_foreign(number, &head));
        let opened = opened.filter(|_| !is_foreign);
        let head = head.filter(|_| !is_foreign);

        let mut file = self
            .target
            .create(&self.path(number))
            .map_err(RecoverError::Write)?;
        let (mut encoder, start) = SegmentEncoder::start(PROFILE, LIBRARY);
        file.append(&start).map_err(RecoverError::Write)?;
        let head_at = head.as_ref().map(|head| head.offset);
        let mut at_start = true;
        if let Some(head) = head.map(|head| self.possible(head)) {
            self.note_states(&head);
            put(&mut *file, &mut encoder, &self.head(number, Some(&head)))?;
            at_start = false;
        }
        let mut scan = opened.as_ref().map(SegmentScan::scan).transpose()?;
        while let (Some(segment), Some(scan)) = (&opened, &mut scan) {
            let chunk = match scan.next_item().map_err(|e| segment.failed(e))? {
                Some(Item::Chunk(chunk)) if Some(chunk.offset) == head_at => continue,
                Some(Item::Chunk(chunk)) => self.possible(chunk),
                Some(Item::Damage(damage)) => {
                    let saved = self.saved(number, segment, &damage);
                    match saved.map_err(|e| segment.failed(e))? {
                        Some(chunk) => chunk,
                        None => continue,
                    }
                }
                None => break,
            };
            if std::mem::take(&mut at_start) {
                put(&mut *file, &mut encoder, &self.head(number, Some(&chunk)))?;
            }
            self.note_states(&chunk);
            Message::all(number, &chunk).for_each(|m| self.check.message(&m));
            put(&mut *file, &mut encoder, &sealed_chunk(&chunk.records))?;
        }
        if at_start {
            put(&mut *file, &mut encoder, &self.head(number, None))?;
        }
        if let Some((_, end)) = encoder.bounds() {
            self.newest = self.newest.max(HostTime(end as i64));
        }
        self.open = Some((number, encoder, file));
        Ok(())
    }

    /// The chunk without its impossible messages.
    fn possible(&self, mut chunk: VerifiedChunk) -> VerifiedChunk {
        let left_out = impossible(&chunk.records, &self.roles);
        chunk.records = without(&chunk.records, &left_out);
        chunk
    }

    /// What can be saved of a range whose checksum did not hold; nothing if it would bring a fault
    /// into the copy. A head has no frames, so there is nothing to save of one.
    fn saved(
        &mut self,
        number: u32,
        segment: &SegmentScan,
        damage: &Damage,
    ) -> io::Result<Option<VerifiedChunk>> {
        if damage.kind != DamageKind::Checksum {
            return Ok(None);
        }
        let length =
            (damage.bytes.end - damage.bytes.start).min(CHUNK_LIMIT + RECORD_HEADER as u64);
        let mut bytes = vec![0; usize::try_from(length).map_err(io::Error::other)?];
        segment
            .file()
            .read_exact_at(&mut bytes, damage.bytes.start)?;
        let saved = salvage(&Bytes::from(bytes), damage.bytes.start, &self.roles);
        let Some(saved) = saved.filter(|chunk| head_of(chunk).is_none()) else {
            return Ok(None);
        };
        let saved = self.possible(saved);
        let alone = self.check.alone(Message::all(number, &saved));
        if !self.check.admits(&alone, &mut self.vacant) {
            return Ok(None);
        }
        self.saved_chunks += 1;
        self.saved_messages += saved.messages().count() as u64;
        Ok(Some(saved))
    }

    /// The head of a segment: the one that it had, if the segment before has the same number of
    /// bytes in the copy as that head says; else one that says so, with the same state.
    fn head(&self, number: u32, first: Option<&VerifiedChunk>) -> Vec<u8> {
        let had = first.and_then(|c| head_of(c).map(|head| (c, head)));
        if let Some((chunk, head)) = &had
            && head.previous_valid_bytes == self.copied_bytes
        {
            return sealed_chunk(&chunk.records);
        }
        let identity = Segment {
            format_version: self.manifest.format_version,
            session_id: self.manifest.session_id.clone(),
            number,
            previous_valid_bytes: self.copied_bytes,
            manifest: self.source.manifest().identity(),
        };
        let messages = first.into_iter().flat_map(|c| c.messages().flatten());
        let time = messages.map(|m| HostTime(m.log_time as i64)).min();
        let states = self.states.iter();
        head_chunk(
            &identity,
            &self.manifest.streams,
            time.unwrap_or(self.newest),
            states.map(|(id, (sequence, data))| (*id, *sequence, &data[..])),
        )
    }

    fn note_states(&mut self, chunk: &VerifiedChunk) {
        for m in chunk.messages().map_while(Result::ok) {
            if self.source.stream(m.channel_id).is_some_and(is_state) {
                let known = self.states.entry(m.channel_id).or_default();
                *known = (m.sequence, m.data.to_vec());
            }
        }
    }

    fn end_segment(&mut self) -> io::Result<()> {
        let Some((number, encoder, mut file)) = self.open.take() else {
            return Ok(());
        };
        let bounds = encoder.bounds();
        let messages = encoder.counts().values().sum();
        let position = encoder.position();
        let summary = encoder.finish();
        file.append(&summary)?;
        file.sync_data()?;
        self.copied_bytes = position + summary.len() as u64;
        self.manifest.segments.push(SegmentEntry {
            number,
            state: SegmentState::Closed,
            bytes: self.copied_bytes,
            start: bounds.map(|(start, _)| HostTime(start as i64)),
            end: bounds.map(|(_, end)| HostTime(end as i64)),
            messages,
        });
        Ok(())
    }

    /// Gap records for what is lost, then the last summary, the names, and the manifest.
    fn finish(&mut self, found: &Report) -> Result<(), RecoverError> {
        if let (Some((_, encoder, file)), false) = (&mut self.open, found.lost.is_empty()) {
            let chunk = loss_chunk(&self.manifest, self.newest, &found.lost);
            put(&mut **file, encoder, &chunk)?;
        }
        for (name, stream) in found.streams.iter().filter(|(_, s)| s.expected() > 0) {
            let extent = Extent {
                first: stream.first,
                last: stream.last,
                start: stream.start,
                end: stream.end,
            };
            let known = self.manifest.extents.entry(name.clone()).or_insert(extent);
            if stream.samples > 0 {
                known.cover(extent);
            }
        }
        let write = |copy: &mut Self| {
            copy.end_segment()?;
            copy.target.sync_dir(layout::SEGMENTS)?;
            copy.manifest.stopped.get_or_insert_with(|| Stop {
                at: copy.newest,
                reason: "cut off; recovered".to_owned(),
            });
            storage::replace(copy.target, layout::MANIFEST, &copy.manifest.to_bytes())
        };
        write(self).map_err(RecoverError::Write)
    }
}

fn put(
    file: &mut dyn storage::WriteFile,
    encoder: &mut SegmentEncoder,
    chunk: &[u8],
) -> Result<(), RecoverError> {
    file.append(chunk)
        .and_then(|()| encoder.chunk(chunk).map_err(io::Error::other))
        .map_err(RecoverError::Write)
}

fn loss_chunk(manifest: &Manifest, at: HostTime, lost: &[LostSamples]) -> Vec<u8> {
    let mut chunk = ChunkBuilder::default();
    let log = at.0.max(0) as u64;
    if let Some(stream) = manifest.stream::<Gap>("") {
        for (lost, sequence) in lost.iter().zip(0..) {
            let gap = Gap {
                stream: lost.stream.clone(),
                first: lost.first,
                last: lost.last,
                cause: paws::gap::Cause::Damaged.into(),
                time_before: Some(lost.after.0),
                time_after: Some(lost.before.0),
                detail: "found damaged by recovery".to_owned(),
            };
            chunk.message(stream.id, sequence, log, log, |out| gap.encode_raw(out));
        }
    }
    if let Some(stream) = manifest.stream::<Event>("") {
        let event = Event {
            kind: paws::event::Kind::Warning.into(),
            source: "recovery".to_owned(),
            text: format!("recovered with {} ranges lost", lost.len()),
        };
        chunk.message(stream.id, 0, log, log, |out| event.encode_raw(out));
    }
    chunk.finish()
}
