//! What a power cut left of a session, compared with the whole recording and with what was reported
//! durable.
//!
//! The same recording without the cut, up to its proper end, is the reference. Every stream of what
//! is left must be a beginning of the same stream there, byte for byte. What the recorder had
//! reported durable before the cut must be in it, and recovery must make a sound copy of it. *A
//! session that does not open*, holds anything else, or misses anything that was promised, is an
//! error.

use std::collections::BTreeMap;
use std::fs;
use std::hash::{DefaultHasher, Hash as _, Hasher as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context as _, Result, bail, ensure};
use serde::{Deserialize, Serialize};
use session_archive::reader::{Entry, Message, SessionReader};
use session_archive::record::{Frame, ImuBatch, Record, Segment};
use session_archive::recover::recover;
use session_archive::scan::DamageKind;
use session_archive::storage::DiskStorage;
use session_archive::verify::verify;

/// What the recorder had said.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Promise {
    /// That it began: the session must open.
    pub started: bool,
    /// How many messages are on disk: the first ones of the recording, in the order written.
    pub messages: u64,
}

/// What was found.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ExamResult {
    /// Whether there is a session.
    pub session: bool,
    /// Messages, without those that say who a segment is.
    pub messages: u64,
    /// By numbered stream, the time of the newest sample, ns.
    pub newest: BTreeMap<String, i64>,
    /// Places that hold something else than a cut leaves at the end.
    pub damage: u64,
    /// Whether the file system had to be repaired before it could be mounted.
    pub repaired: bool,
}

/// A sample of the reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sample {
    /// When it was received, ns.
    pub arrived: i64,
    /// Its time, ns.
    pub time: i64,
}

/// A whole recording.
#[derive(Clone, Debug, Default)]
pub struct Contents {
    /// Messages by channel.
    messages: BTreeMap<u16, Vec<Row>>,
    /// By numbered stream, in order.
    pub samples: BTreeMap<String, Vec<Sample>>,
    /// Channels of all messages, in the order written.
    order: Vec<u16>,
}

/// What distinguishes a message from another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Row {
    time: i64,
    sequence: u32,
    digest: u64,
}

impl Contents {
    /// Reads a session. Damage is passed over.
    ///
    /// # Errors
    /// It does not open, the file system reports an I/O error, or a message is not what its schema
    /// says.
    pub fn read(folder: &Path) -> Result<Self> {
        Self::of(&open(folder)?)
    }

    fn of(reader: &SessionReader) -> Result<Self> {
        let mut contents = Self::default();
        for stream in &reader.manifest().streams {
            if [Frame::SCHEMA.name, ImuBatch::SCHEMA.name].contains(&stream.schema.as_str()) {
                contents.samples.insert(stream.of.clone(), Vec::new());
            }
        }
        for entry in reader.entries() {
            if let Entry::Message(message) = entry? {
                contents.take(reader, &message)?;
            }
        }
        Ok(contents)
    }

    fn take(&mut self, reader: &SessionReader, message: &Message) -> Result<()> {
        let stream = reader.stream(message.stream);
        let stream = stream.with_context(|| format!("a message of channel {}", message.stream))?;
        if stream.schema == Segment::SCHEMA.name {
            return Ok(());
        }
        self.order.push(message.stream);
        let mut hasher = DefaultHasher::new();
        message.data.hash(&mut hasher);
        let row = Row {
            time: message.time.ns(),
            sequence: message.sequence,
            digest: hasher.finish(),
        };
        self.messages.entry(message.stream).or_default().push(row);
        let Some(samples) = self.samples.get_mut(&stream.of) else {
            return Ok(());
        };
        if stream.schema == Frame::SCHEMA.name {
            let frame: Frame = message.decode()?;
            samples.push(Sample {
                arrived: frame.host_time,
                time: frame.time,
            });
        } else if stream.schema == ImuBatch::SCHEMA.name {
            let batch: ImuBatch = message.decode()?;
            let both = batch.host_times.iter().zip(&batch.times);
            samples.extend(both.map(|(arrived, time)| Sample {
                arrived: *arrived,
                time: *time,
            }));
        }
        Ok(())
    }

    /// By numbered stream, how much of what had been received at `now` a cut has taken, ns: from
    /// the newest sample that is left to the newest one received. Nothing left counts from the
    /// first sample on.
    pub fn lost(&self, newest: &BTreeMap<String, i64>, now: i64) -> BTreeMap<String, i64> {
        let lost = self.samples.iter().filter_map(|(stream, samples)| {
            let received = samples.iter().filter(|sample| sample.arrived <= now);
            let last = received.map(|sample| sample.time).max();
            let kept = newest.get(stream).copied();
            let from = kept.or_else(|| samples.first().map(|sample| sample.time))?;
            Some((stream.clone(), last.map_or(0, |last| (last - from).max(0))))
        });
        lost.collect()
    }
}

fn open(folder: &Path) -> Result<SessionReader> {
    SessionReader::open(Arc::new(DiskStorage::new(folder)))
        .with_context(|| format!("opening the session {}", folder.display()))
}

/// The session in a folder of sessions; `None` if there is none. Several sessions are an error.
///
/// # Errors
/// There are several, or the file system reports an I/O error.
pub fn only_session(archive: &Path) -> Result<Option<PathBuf>> {
    let reading = || format!("looking for a session {}", archive.display());
    let mut folders = Vec::new();
    for entry in fs::read_dir(archive).with_context(reading)? {
        let entry = entry.with_context(reading)?;
        let is_folder = entry.file_type().with_context(reading)?.is_dir();
        // mkfs.ext4 makes it.
        if is_folder && entry.file_name() != "lost+found" {
            folders.push(entry.path());
        }
    }
    ensure!(
        folders.len() <= 1,
        "found {} sessions, expected one: {}",
        folders.len(),
        archive.display()
    );
    Ok(folders.pop())
}

/// Examines what is left in a folder of sessions. `scratch` is a folder on another disk, for the
/// recovered copy.
///
/// # Errors
/// Something remains that must not, or something durable is missing.
pub fn examine(
    archive: &Path,
    reference: Option<&Contents>,
    promise: Promise,
    scratch: &Path,
) -> Result<ExamResult> {
    let Some(session) = only_session(archive)? else {
        ensure!(!promise.started, "the session is missing");
        return Ok(ExamResult::default());
    };
    let reader = match open(&session) {
        Err(_) if !promise.started => return Ok(ExamResult::default()),
        opened => opened?,
    };
    let contents = Contents::of(&reader)?;
    let count = contents.order.len() as u64;
    ensure!(
        count >= promise.messages,
        "{count} messages are left, {} were promised",
        promise.messages
    );
    if let Some(reference) = reference {
        is_beginning_of(&contents, reference)?;
        has_the_first(&contents, reference, promise.messages)?;
    }
    let report = verify(&reader, |_| {})?;
    let copy = Arc::new(DiskStorage::new(scratch));
    let recovered = recover(&reader, copy, |_| {}).context("recovering the session")?;
    ensure!(
        recovered.copy.is_sound(),
        "the recovered copy is not sound: {:?}",
        recovered.copy
    );
    let newest = contents.samples.iter();
    let damage = report.damage.iter();
    Ok(ExamResult {
        session: true,
        messages: count,
        newest: newest
            .filter_map(|(name, samples)| Some((name.clone(), samples.last()?.time)))
            .collect(),
        damage: damage
            .filter(|d| d.damage.kind != DamageKind::CutOff)
            .count() as u64,
        repaired: false,
    })
}

fn is_beginning_of(left: &Contents, reference: &Contents) -> Result<()> {
    for (stream, rows) in &left.messages {
        let whole = reference
            .messages
            .get(stream)
            .map_or(&[][..], Vec::as_slice);
        if !whole.starts_with(rows) {
            let same = rows.iter().zip(whole).take_while(|(a, b)| a == b).count();
            bail!(
                "channel {stream}: of {} messages only the first {same} are those of the recording, which has {}",
                rows.len(),
                whole.len()
            );
        }
    }
    Ok(())
}

/// Every stream has at least what it has among the first messages of the recording.
fn has_the_first(left: &Contents, reference: &Contents, messages: u64) -> Result<()> {
    let mut promised: BTreeMap<u16, usize> = BTreeMap::new();
    for stream in reference.order.iter().take(messages as usize) {
        *promised.entry(*stream).or_default() += 1;
    }
    for (stream, promised) in promised {
        let there = left.messages.get(&stream).map_or(0, Vec::len);
        ensure!(
            there >= promised,
            "channel {stream}: {promised} messages were promised, {there} are left"
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests;
