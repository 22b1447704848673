//! Segments: chunks on disk, the next segment when one is full, and what happens when the disk
//! fails.

use std::io;

use super::SessionWriter;
use super::contents::{
    chunk_bounds, extents, gaps, is_sampled, members, messages, runs, samples, stream_of,
};
use super::head_chunk::{encode, head_chunk};
use super::open_segment::OpenSegment;
use super::spec::{Incident, LIBRARY, MAX_SEGMENT_BYTES, MAX_SEGMENT_NS, PROFILE, WriteError};
use crate::layout;
use crate::manifest::{FORMAT_VERSION, SegmentEntry, SegmentState};
use crate::mcap::{ChunkBuilder, SegmentEncoder};
use crate::record::{Event, Gap, Segment, paws};
use crate::storage;
use crate::time::HostTime;

impl SessionWriter {
    /// Puts a chunk on disk, in a new segment if the current one is full or fails.
    pub(super) fn commit(&mut self, bytes: &[u8]) -> Result<(), WriteError> {
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
    pub(super) fn open_segment(&mut self, time: HostTime) -> io::Result<()> {
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
    pub(super) fn finish_segment(&mut self) {
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
    /// only the head. Returns its number. The next segment's head and the manifest state what
    /// readers skip, so the unreliable bytes may remain: if they were cut off, the file system
    /// could allocate the same bad blocks to the next segment. They are cut off only where the disk
    /// is full.
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

    pub(super) fn write_manifest(&self) -> io::Result<()> {
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

    /// Extends the manifest's extents of the numbered streams by a chunk that is on disk.
    fn update_extents(&mut self, bytes: &[u8]) {
        let streams = &self.manifest.streams;
        for (name, more) in extents(samples(bytes, streams).chain(gaps(bytes, streams))) {
            let known = self.manifest.extents.entry(name).or_insert(more);
            known.cover(more);
        }
    }
}

/// Whether there is no room left, rather than something broken.
fn is_full(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded
    )
}
