//! Checking a session: what is there, what is missing, and whether every missing sample is
//! accounted for.
//!
//! One pass over the whole session, every checksum checked, every message decoded, but no frame.
//! Loss that the recorder noted (gap records) and loss that it did not (damage, a cut) are reported
//! separately; recovery writes gap records for the second kind.

use std::collections::BTreeMap;
use std::sync::Arc;

use crate::layout;
use crate::manifest::{RigFile, State};
use crate::reader::{Entry, Message, ReadError, SessionReader};
use crate::record::{
    CameraCalibration, ClockMap, CompressedVideo, Event, Frame, FrameSet, FrameTransforms, Gap,
    Health, ImuBatch, Record, Segment,
};
use crate::scan::End;
use crate::storage::{self, Storage};
use crate::time::HostTime;

mod numbers;
mod ranges;
mod report;
mod vacant;

pub(crate) use ranges::union;
pub use report::{LostSamples, Report, SegmentDamage, StreamReport};
pub(crate) use vacant::Vacant;

use numbers::Numbers;

/// Checks a session; `progress` is called with the bytes of each message read.
///
/// # Errors
/// The file system reports an I/O error. What the session holds is never an error.
///
/// ```
/// use std::sync::Arc;
///
/// use session_archive::reader::SessionReader;
/// use session_archive::storage::DiskStorage;
/// use session_archive::verify::verify;
///
/// # let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/fixtures/v1");
/// let reader = SessionReader::open(Arc::new(DiskStorage::new(folder)))?;
/// let report = verify(&reader, |_| {})?;
/// assert!(report.is_sound());
/// let imu = &report.streams["feet/imu"];
/// assert_eq!((imu.samples, imu.expected(), imu.lost), (200, 200, 0));
/// # Ok::<(), session_archive::reader::ReadError>(())
/// ```
pub fn verify(reader: &SessionReader, progress: impl FnMut(u64)) -> Result<Report, ReadError> {
    check(reader, progress).map(Check::finish)
}

/// Counts everything in a session.
///
/// # Errors
/// As for [`verify`].
pub(crate) fn check(
    reader: &SessionReader,
    mut progress: impl FnMut(u64),
) -> Result<Check, ReadError> {
    let manifest = reader.manifest();
    let mut check = Check::new(reader);
    check.report = Report {
        session_id: manifest.session_id.clone(),
        manifest_note: reader.manifest_note().map(str::to_owned),
        closed: manifest.state != State::Recording,
        bytes: reader.bytes()?,
        bad_rig_files: bad_rig_files(reader),
        ..Report::default()
    };
    for entry in reader.entries() {
        match entry? {
            Entry::Message(m) => {
                progress(m.data.len() as u64);
                check.message(&m);
            }
            Entry::Damage { segment, damage } => {
                check.report.damage.push(SegmentDamage { segment, damage });
            }
            Entry::SegmentEnd { segment, end } => {
                if end == End::Open {
                    check.report.open_segments.push(segment);
                }
            }
            Entry::SegmentMissing { segment } => check.report.missing_segments.push(segment),
        }
    }
    Ok(check)
}

fn bad_rig_files(reader: &SessionReader) -> Vec<String> {
    let files = reader.manifest().rig.iter();
    files
        .filter(|file| rig_file(&**reader.storage(), file).is_none())
        .map(|file| file.name.clone())
        .collect()
}

/// Content of a file in `rig/`, if it is there and what the manifest says.
pub fn rig_file(storage: &dyn Storage, file: &RigFile) -> Option<Vec<u8>> {
    let content = storage::read_all(storage, &layout::rig_file(&file.name)).ok()?;
    (blake3::hash(&content).to_hex().as_str() == file.blake3).then_some(content)
}

/// What a channel carries.
#[derive(Clone, Copy)]
enum Kind {
    Video,
    Frame,
    Imu,
    Gap,
    /// Another message, with a check against its schema.
    Other(fn(&Message) -> bool),
}

/// Whether a message of this schema can be decoded; of a schema that is not known here, yes.
fn decodes_as(schema: &str) -> fn(&Message) -> bool {
    fn decodes<R: Record>(m: &Message) -> bool {
        m.decode::<R>().is_ok()
    }
    match schema {
        name if name == Segment::SCHEMA.name => decodes::<Segment>,
        name if name == Event::SCHEMA.name => decodes::<Event>,
        name if name == Health::SCHEMA.name => decodes::<Health>,
        name if name == FrameSet::SCHEMA.name => decodes::<FrameSet>,
        name if name == FrameTransforms::SCHEMA.name => decodes::<FrameTransforms>,
        name if name == ClockMap::SCHEMA.name => decodes::<ClockMap>,
        name if name == CameraCalibration::SCHEMA.name => decodes::<CameraCalibration>,
        _ => |_| true,
    }
}

/// Counts the messages of a session one after the other.
pub(crate) struct Check {
    kinds: Arc<BTreeMap<u16, (Kind, String)>>,
    report: Report,
    numbers: BTreeMap<String, Numbers>,
    /// The newest frame record of each camera whose access unit has not come yet.
    awaiting: BTreeMap<String, Frame>,
}

impl Check {
    pub(crate) fn new(reader: &SessionReader) -> Self {
        let kinds = reader.manifest().streams.iter().map(|s| {
            let kind = match s.schema.as_str() {
                name if name == CompressedVideo::SCHEMA.name => Kind::Video,
                name if name == Frame::SCHEMA.name => Kind::Frame,
                name if name == ImuBatch::SCHEMA.name => Kind::Imu,
                name if name == Gap::SCHEMA.name => Kind::Gap,
                name => Kind::Other(decodes_as(name)),
            };
            (s.id, (kind, s.of.clone()))
        });
        let kinds: BTreeMap<_, _> = kinds.collect();
        let mut numbers: BTreeMap<String, Numbers> = BTreeMap::new();
        for (kind, of) in kinds.values() {
            if matches!(kind, Kind::Frame | Kind::Imu) {
                numbers.entry(of.clone()).or_default();
            }
        }
        for (of, extent) in &reader.manifest().extents {
            numbers.entry(of.clone()).or_default().extent = Some(*extent);
        }
        Self {
            kinds: Arc::new(kinds),
            report: Report::default(),
            numbers,
            awaiting: BTreeMap::new(),
        }
    }

    /// Counts these messages alone, of the same session.
    pub(crate) fn alone(&self, messages: impl Iterator<Item = Message>) -> Self {
        let mut alone = Self {
            kinds: self.kinds.clone(),
            report: Report::default(),
            numbers: BTreeMap::new(),
            awaiting: BTreeMap::new(),
        };
        messages.for_each(|m| alone.message(&m));
        alone
    }

    /// The numbers that are vacant in everything that was counted.
    pub(crate) fn vacant(&self) -> Vacant {
        Vacant::new(&self.numbers)
    }

    /// Whether the messages of `chunk`, counted alone, bring no fault if they come next; if so,
    /// their numbers are no longer vacant.
    pub(crate) fn admits(&self, chunk: &Self, vacant: &mut Vacant) -> bool {
        let is_sound = |(name, numbers): (&String, &Numbers)| {
            let newest = self.numbers.get(name).and_then(Numbers::newest);
            let report = &numbers.report;
            (report.repeated, report.bad_payloads) == (0, 0)
                && (numbers.newest().is_none() || !self.awaiting.contains_key(name))
                && vacant.fits(name, newest, numbers)
        };
        let is_decodable = chunk.report.undecodable == 0 && chunk.awaiting.is_empty();
        let admits = is_decodable && chunk.numbers.iter().all(is_sound);
        if admits {
            for (name, numbers) in &chunk.numbers {
                vacant.take(name, numbers);
            }
        }
        admits
    }

    pub(crate) fn message(&mut self, m: &Message) {
        self.report.messages += 1;
        let Some((kind, of)) = self.kinds.get(&m.stream) else {
            self.report.undecodable += 1;
            return;
        };
        let (kind, of) = (*kind, of.clone());
        let understood = match kind {
            Kind::Video => self.video(&of, m),
            Kind::Frame => self.frame(of, m),
            Kind::Imu => self.imu(&of, m),
            Kind::Gap => m.decode::<Gap>().is_ok_and(|gap| {
                self.numbers
                    .entry(gap.stream)
                    .or_default()
                    .gaps
                    .push((gap.first, gap.last));
                gap.first <= gap.last
            }),
            Kind::Other(decodes) => decodes(m),
        };
        self.report.undecodable += u64::from(!understood);
    }

    fn frame(&mut self, of: String, m: &Message) -> bool {
        let Ok(frame) = m.decode::<Frame>() else {
            return false;
        };
        let time = HostTime(frame.time);
        let numbers = self.numbers.entry(of.clone()).or_default();
        numbers.samples(frame.number, 1, time, time);
        if self.awaiting.insert(of, frame).is_some() {
            numbers.report.bad_payloads += 1;
        }
        true
    }

    fn video(&mut self, of: &str, m: &Message) -> bool {
        let Ok(video) = m.decode::<CompressedVideo>() else {
            return false;
        };
        let matches = self.awaiting.remove(of).is_some_and(|frame| {
            frame.number as u32 == m.sequence
                && frame.payload_bytes as usize == video.data.len()
                && frame.payload_crc32 == crc32fast::hash(&video.data)
        });
        if !matches {
            self.numbers
                .entry(of.to_owned())
                .or_default()
                .report
                .bad_payloads += 1;
        }
        true
    }

    fn imu(&mut self, of: &str, m: &Message) -> bool {
        let Ok(batch) = m.decode::<ImuBatch>() else {
            return false;
        };
        let n = batch.times.len();
        let vectors = |counts: usize, values: usize| {
            (counts == 3 * n && values == 0) || (counts == 0 && values == 3 * n)
        };
        let whole = batch.device_ticks.len() == n
            && batch.host_times.len() == n
            && vectors(batch.gyro_counts.len(), batch.gyro.len())
            && vectors(batch.accel_counts.len(), batch.accel.len());
        let (Some(start), Some(end), true) = (batch.times.first(), batch.times.last(), whole)
        else {
            return false;
        };
        self.numbers.entry(of.to_owned()).or_default().samples(
            batch.first_number,
            n as u64,
            HostTime(*start),
            HostTime(*end),
        );
        true
    }

    pub(crate) fn finish(mut self) -> Report {
        for of in self.awaiting.keys() {
            self.numbers
                .entry(of.clone())
                .or_default()
                .report
                .bad_payloads += 1;
        }
        for (name, numbers) in self.numbers {
            let (stream, lost) = numbers.settle(&name);
            self.report.streams.insert(name, stream);
            self.report.lost.extend(lost);
        }
        self.report.lost.sort_by_key(|l| (l.after, l.first));
        self.report
    }
}
