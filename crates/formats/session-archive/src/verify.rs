//! Checking a session: what is there, what is missing, and whether every missing sample is
//! accounted for.
//!
//! One pass over the whole session, every checksum checked, every message decoded, but no frame.
//! Loss that the recorder noted (gap records) and loss that it did not (damage, a cut) are reported
//! separately; recovery writes gap records for the second kind.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::layout;
use crate::manifest::{Extent, RigFile, State};
use crate::reader::{Entry, Message, ReadError, SessionReader};
use crate::record::{
    CameraCalibration, ClockMap, CompressedVideo, Event, Frame, FrameSet, FrameTransforms, Gap,
    Health, ImuBatch, Record, Segment,
};
use crate::scan::{Damage, DamageKind, End};
use crate::storage::{self, Storage};
use crate::time::HostTime;

/// Consecutive samples that are missing without a gap record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Lost {
    /// The stream, as gap records name it.
    pub stream: String,
    /// First missing number.
    pub first: u64,
    /// Last missing number.
    pub last: u64,
    /// Time of the sample before.
    pub after: HostTime,
    /// Time of the sample behind.
    pub before: HostTime,
}

/// What is known of one numbered stream.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct StreamReport {
    /// First number: of a sample, in a gap record, or by the manifest.
    pub first: u64,
    /// Last number: of a sample, in a gap record, or by the manifest.
    pub last: u64,
    /// Samples present.
    pub samples: u64,
    /// Samples missing by gap records.
    pub gaps: u64,
    /// Samples missing without a gap record.
    pub lost: u64,
    /// Samples whose number was there before.
    pub repeated: u64,
    /// Samples that are present although a gap record says that they are missing.
    pub contradicted: u64,
    /// Frames whose access unit is missing or does not match its checksum.
    pub bad_payloads: u64,
    /// Time of the first sample.
    pub start: HostTime,
    /// Time of the last sample. Samples that a cut has taken are later.
    pub end: HostTime,
}

impl StreamReport {
    /// Samples that should be there: every number from the first to the last.
    pub fn expected(&self) -> u64 {
        if self.samples == 0 && self.gaps == 0 && self.lost == 0 {
            0
        } else {
            (self.last - self.first).saturating_add(1)
        }
    }
}

/// Damage in one segment.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct SegmentDamage {
    /// The segment.
    pub segment: u32,
    /// Range and cause.
    #[serde(flatten)]
    pub damage: Damage,
}

/// Everything found in a session.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Report {
    /// The session's identifier.
    pub session_id: String,
    /// Why the manifest had to be rebuilt, if it had to.
    pub manifest_note: Option<String>,
    /// Whether the recorder closed the session.
    pub closed: bool,
    /// Bytes of the segments.
    pub bytes: u64,
    /// Messages that can be read.
    pub messages: u64,
    /// Segments that are not there.
    pub missing_segments: Vec<u32>,
    /// Files of `rig/` that are not there or not what the manifest says, by name.
    pub bad_rig_files: Vec<String>,
    /// Bytes that cannot be used.
    pub damage: Vec<SegmentDamage>,
    /// Messages that are not what their schema says.
    pub undecodable: u64,
    /// The numbered streams: cameras and IMUs.
    pub streams: BTreeMap<String, StreamReport>,
    /// Samples missing without a gap record, by time.
    pub lost: Vec<Lost>,
    /// Segments that ended without a summary although nothing is damaged: cut off, or given up.
    pub open_segments: Vec<u32>,
}

impl Report {
    /// Whether only the end is missing, as after a power cut: nothing else is wrong with it.
    pub fn is_only_cut_off(&self) -> bool {
        let last = self.damage.iter().map(|d| d.segment).max();
        let mut closed = self.clone();
        closed.closed = true;
        closed
            .damage
            .retain(|d| d.damage.kind != DamageKind::CutOff || Some(d.segment) != last);
        !self.closed && closed.is_sound()
    }

    /// Whether everything that was recorded is there and accounted for. Loss that the recorder
    /// noted does not make a session unsound; an unclosed one is not sound.
    pub fn is_sound(&self) -> bool {
        self.closed
            && self.manifest_note.is_none()
            && self.missing_segments.is_empty()
            && self.bad_rig_files.is_empty()
            && self.damage.is_empty()
            && self.undecodable == 0
            && self.lost.is_empty()
            && self
                .streams
                .values()
                .all(|s| s.repeated == 0 && s.contradicted == 0 && s.bad_payloads == 0)
    }
}

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
pub fn verify(reader: &SessionReader, mut progress: impl FnMut(u64)) -> Result<Report, ReadError> {
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
    Ok(check.finish())
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

/// A numbered stream while it is being read.
#[derive(Default)]
struct Numbers {
    report: StreamReport,
    /// Holes between consecutive samples: numbers, and the times around them.
    holes: Vec<(u64, u64, HostTime, HostTime)>,
    gaps: Vec<(u64, u64)>,
    newest: Option<(u64, HostTime)>,
    /// What the manifest says was on disk.
    extent: Option<Extent>,
}

impl Numbers {
    fn samples(&mut self, first: u64, count: u64, start: HostTime, end: HostTime) {
        let last = first.saturating_add(count.saturating_sub(1));
        match self.newest {
            None => {
                self.report.first = first;
                self.report.start = start;
            }
            Some((newest, _)) if first <= newest => {
                self.report.repeated += count;
                return;
            }
            Some((newest, time)) if first > newest.saturating_add(1) => {
                self.holes
                    .push((newest.saturating_add(1), first - 1, time, start));
            }
            Some(_) => {}
        }
        self.report.samples += count;
        self.report.last = last;
        self.report.end = end;
        self.newest = Some((last, end));
    }

    /// Subtracts the gap records from the missing numbers; returns the losses that no gap record
    /// explains.
    fn settle(self, name: &str) -> (StreamReport, Vec<Lost>) {
        let gaps = union(self.gaps);
        let mut report = self.report;
        let sampled = (report.samples > 0).then_some((report.first, report.last));
        let known = self.extent.map(|e| (e.first, e.last));
        let all = || gaps.iter().copied().chain(sampled).chain(known);
        let (Some(first), Some(last)) = (all().map(|r| r.0).min(), all().map(|r| r.1).max()) else {
            return (report, Vec::new());
        };
        let mut missing = self.holes;
        if let Some((first_sample, last_sample)) = sampled {
            let (start, end) = (report.start, report.end);
            if first < first_sample {
                let after = self.extent.map_or(start, |e| e.start.min(start));
                missing.push((first, first_sample - 1, after, start));
            }
            if last > last_sample {
                let before = self.extent.map_or(end, |e| e.end.max(end));
                missing.push((last_sample + 1, last, end, before));
            }
        } else {
            let (after, before) = self
                .extent
                .map_or_else(Default::default, |e| (e.start, e.end));
            missing.push((first, last, after, before));
        }
        let count = |a: u64, b: u64| (b - a).saturating_add(1);
        let mut unsampled: u64 = 0;
        let mut lost = Vec::new();
        for (from, to, after, before) in missing {
            unsampled = unsampled.saturating_add(count(from, to));
            for (a, b) in subtract((from, to), &gaps) {
                report.lost = report.lost.saturating_add(count(a, b));
                lost.push(Lost {
                    stream: name.to_owned(),
                    first: a,
                    last: b,
                    after,
                    before,
                });
            }
        }
        let gap_numbers = gaps.iter().map(|&(a, b)| count(a, b));
        report.gaps = gap_numbers.fold(0, u64::saturating_add);
        // Every gap has to lie within what is missing.
        report.contradicted = report.gaps.saturating_sub(unsampled - report.lost);
        (report.first, report.last) = (first, last);
        (report, lost)
    }
}

/// Sorted, disjoint ranges that cover the same numbers.
pub(crate) fn union(mut ranges: Vec<(u64, u64)>) -> Vec<(u64, u64)> {
    ranges.retain(|(a, b)| a <= b);
    ranges.sort_unstable();
    let mut out: Vec<(u64, u64)> = Vec::new();
    for (a, b) in ranges {
        match out.last_mut() {
            Some(last) if a <= last.1.saturating_add(1) => last.1 = last.1.max(b),
            _ => out.push((a, b)),
        }
    }
    out
}

/// What of `range` is in none of the sorted, disjoint `covers`.
fn subtract(range: (u64, u64), covers: &[(u64, u64)]) -> Vec<(u64, u64)> {
    let (mut from, to) = range;
    let mut out = Vec::new();
    let start = covers.partition_point(|c| c.1 < from);
    for &(a, b) in &covers[start..] {
        if a > to {
            break;
        }
        if a > from {
            out.push((from, a - 1));
        }
        from = b.saturating_add(1);
        if from > to || b == u64::MAX {
            return out;
        }
    }
    if from <= to {
        out.push((from, to));
    }
    out
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
    kinds: BTreeMap<u16, (Kind, String)>,
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
            kinds,
            report: Report::default(),
            numbers,
            awaiting: BTreeMap::new(),
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges() {
        assert_eq!(
            union(vec![(5, 7), (1, 2), (3, 3), (9, 8)]),
            [(1, 3), (5, 7)]
        );
        let covers = [(1, 3), (5, 7)];
        assert_eq!(subtract((0, 9), &covers), [(0, 0), (4, 4), (8, 9)]);
        assert_eq!(subtract((1, 7), &covers), [(4, 4)]);
        assert_eq!(subtract((2, 3), &covers), []);
        assert_eq!(subtract((8, 8), &covers), [(8, 8)]);
        assert_eq!(subtract((0, u64::MAX), &[(3, u64::MAX)]), [(0, 2)]);
    }

    #[test]
    fn every_hole_is_explained_or_lost() {
        let mut n = Numbers::default();
        for (number, time) in [(10, 0), (11, 1), (15, 5), (16, 6), (20, 10)] {
            n.samples(number, 1, HostTime(time), HostTime(time));
        }
        n.gaps = vec![(12, 13), (17, 19), (21, 22)];
        let (report, lost) = n.settle("feet");
        assert_eq!((report.first, report.last, report.samples), (10, 22, 5));
        assert_eq!((report.gaps, report.lost, report.contradicted), (7, 1, 0));
        assert_eq!(
            report.samples + report.gaps + report.lost,
            report.expected()
        );
        assert_eq!(lost.len(), 1);
        assert_eq!((lost[0].first, lost[0].last), (14, 14));
        assert_eq!((lost[0].after, lost[0].before), (HostTime(1), HostTime(5)));
    }

    #[test]
    fn what_the_manifest_had_is_lost_at_the_ends() {
        let mut n = Numbers {
            extent: extent(5, 20),
            gaps: vec![(6, 6), (9, 9), (19, 19)],
            ..Numbers::default()
        };
        for number in [10, 11] {
            let time = HostTime(number as i64 * 10);
            n.samples(number, 1, time, time);
        }
        let (report, lost) = n.settle("feet");
        assert_eq!((report.first, report.last, report.samples), (5, 20, 2));
        assert_eq!((report.gaps, report.contradicted), (3, 0));
        let spans: Vec<_> = lost.iter().map(|l| (l.first, l.last)).collect();
        assert_eq!(spans, [(5, 5), (7, 8), (12, 18), (20, 20)]);
        assert_eq!(
            report.samples + report.gaps + report.lost,
            report.expected()
        );
        assert_eq!(
            (lost[3].after, lost[3].before),
            (HostTime(110), HostTime(200))
        );
        // Nothing of the stream is left at all.
        let n = Numbers {
            extent: extent(5, 20),
            ..Numbers::default()
        };
        let (report, lost) = n.settle("feet");
        assert_eq!((report.lost, report.expected(), lost.len()), (16, 16, 1));
    }

    fn extent(first: u64, last: u64) -> Option<Extent> {
        Some(Extent {
            first,
            last,
            start: HostTime(first as i64 * 10),
            end: HostTime(last as i64 * 10),
        })
    }

    #[test]
    fn a_gap_over_a_present_sample_is_a_contradiction() {
        let mut n = Numbers::default();
        for number in [1, 2, 4] {
            n.samples(number, 1, HostTime(0), HostTime(0));
        }
        n.gaps = vec![(2, 3)];
        let (report, _) = n.settle("feet");
        assert_eq!(report.contradicted, 1);
    }
}
