//! Every operation on the disk goes wrong once, in every way, and every kind of crash image of
//! what is left is opened: nothing that was reported durable may be missing, nothing that was not
//! written may be found, and what else is missing is the chunk in the making.
//!
//! Nothing here is sampled, so there is no seed: a failure names the case that failed.

mod support;

use std::collections::BTreeMap;
use std::fmt::Debug;
use std::sync::Arc;

use session_archive::layout;
use session_archive::manifest::State;
use session_archive::reader::{Message, ReadError, SessionReader};
use session_archive::record::{Event, Gap};
use session_archive::recover::recover;
use session_archive::scan::DamageKind;
use session_archive::storage::{CrashKind, Fault, FaultKind, FaultStorage, Operation};
use session_archive::time::HostTime;
use session_archive::verify::{Report, verify};
use session_archive::writer::{Durability, MAX_CHUNK_NS, SessionWriter};
use support::{CAMERAS, MS, START, Sample, messages, put, samples_at, spec, stop};

/// Bytes of an access unit.
const UNIT: usize = 60;

const CRASHES: [CrashKind; 9] = [
    CrashKind::ProcessKilled,
    CrashKind::UnsyncedDropped,
    CrashKind::LastWriteTorn(0),
    CrashKind::LastWriteTorn(1),
    CrashKind::LastWriteTorn(40),
    CrashKind::LastWriteTorn(511),
    CrashKind::LastWriteTorn(512),
    CrashKind::LastWriteTorn(3 * 512),
    CrashKind::LastWriteTorn(4096),
];

/// Samples with frames that the encoder did not manage, now and then two in a row.
fn samples(seconds: f64) -> Vec<Sample> {
    let mut samples = support::samples(seconds);
    for sample in &mut samples {
        if let Sample::Frame {
            camera,
            number,
            time,
            key: false,
        } = *sample
            && matches!(number % 11, 4 | 7 | 8)
        {
            *sample = Sample::Gap {
                camera,
                number,
                time,
            };
        }
    }
    samples
}

/// A recording as far as it has come, and what the writer has promised.
#[derive(Default)]
struct Run<'a> {
    samples: &'a [Sample],
    created: bool,
    /// Samples that the writer was given, the one that it failed on included.
    appended: usize,
    /// Samples that the writer has reported durable.
    durable: Vec<bool>,
    durability: Durability,
    /// What it has reported lost.
    lost: Vec<Gap>,
    incidents: usize,
    /// Whether it closed the session without an error.
    closed: bool,
}

impl<'a> Run<'a> {
    /// Records until the writer fails for good or the samples end; calls `at_chunk` whenever
    /// something more has become durable.
    fn record(
        disk: &FaultStorage,
        samples: &'a [Sample],
        mut at_chunk: impl FnMut(&Self, &SessionWriter),
    ) -> Self {
        let mut run = Self {
            samples,
            durable: vec![false; samples.len()],
            ..Self::default()
        };
        let Ok(mut writer) = SessionWriter::create(Arc::new(disk.clone()), spec()) else {
            return run;
        };
        run.created = true;
        let mut fatal = false;
        for (i, sample) in samples.iter().enumerate() {
            run.appended = i + 1;
            fatal = put(&mut writer, sample, UNIT).is_err();
            let more = writer.durability().chunks > run.durability.chunks;
            run.note(&mut writer);
            if fatal {
                break;
            }
            if more {
                at_chunk(&run, &writer);
            }
        }
        match writer.close(stop(START)) {
            Ok(_) => {
                assert!(!fatal, "closed without a word after a fatal error");
                run.closed = true;
                run.note(&mut writer);
                assert!(run.durable[..run.appended].iter().all(|d| *d));
            }
            Err(e) => {
                let text = e.to_string();
                assert!(text.contains("segment") || text.contains("disk"), "{text}");
                run.note(&mut writer);
            }
        }
        run
    }

    fn note(&mut self, writer: &mut SessionWriter) {
        self.durability = writer.durability();
        let until = self.durability.until;
        for (durable, sample) in self.durable.iter_mut().zip(&self.samples[..self.appended]) {
            *durable |= sample.time() <= until;
        }
        for incident in writer.take_incidents() {
            self.incidents += 1;
            self.lost.extend(incident.lost);
        }
    }

    /// Whether the writer has said that this sample is lost.
    fn is_lost(&self, sample: &Sample) -> bool {
        sample.numbers().is_some_and(|(stream, first, last)| {
            let mut gaps = self.lost.iter();
            gaps.any(|g| g.stream == stream && g.first <= first && last <= g.last)
        })
    }

    /// Opens a crash image and holds it against what was promised.
    fn check(&self, image: &FaultStorage, case: &dyn Debug) {
        let reader = match SessionReader::open(Arc::new(image.clone())) {
            Ok(reader) => reader,
            Err(ReadError::NoSession) if !self.created => return,
            Err(e) => panic!("{case:?}: {e}"),
        };
        let found = messages(&reader);
        check_gaps(&reader, &found, case);
        let is_there = self.find(&reader, &found, case);
        self.check_missing(&is_there, case);

        let report = verify(&reader, |_| {}).expect("verify");
        self.check_report(&report, case);

        let target = FaultStorage::new();
        let recovered = recover(&reader, Arc::new(target.clone()), |_| {})
            .unwrap_or_else(|e| panic!("{case:?}: {e}"));
        assert!(recovered.copy.is_sound(), "{case:?}: {recovered:#?}");
        let copy = SessionReader::open(Arc::new(target)).expect("open the copy");
        assert_eq!(copy.manifest().state, State::Recovered);
        let again = messages(&copy);
        assert_eq!(again.len(), found.len(), "{case:?}: the copy has others");
        for (a, b) in found.iter().zip(&again) {
            assert_eq!(
                (a.stream, a.sequence, a.time, a.published, &a.data),
                (b.stream, b.sequence, b.time, b.published, &b.data),
                "{case:?}"
            );
        }
    }

    /// Which samples are there: every message found must be one that was appended, each stream in
    /// its order, and the messages of a sample are there together or not at all.
    fn find(&self, reader: &SessionReader, found: &[Message], case: &dyn Debug) -> Vec<bool> {
        let manifest = reader.manifest();
        let mut expected: BTreeMap<u16, Vec<_>> = BTreeMap::new();
        for (i, sample) in self.samples[..self.appended].iter().enumerate() {
            for message in sample.messages(manifest, UNIT) {
                expected
                    .entry(message.stream)
                    .or_default()
                    .push((i, message));
            }
        }
        let mut next: BTreeMap<u16, usize> = BTreeMap::new();
        let mut parts = vec![0; self.appended];
        for m in found {
            if self.is_from_the_writer(reader, m) {
                continue;
            }
            let of_stream = &expected[&m.stream];
            let from = next.entry(m.stream).or_default();
            let at = of_stream[*from..].iter().position(|(_, e)| e.is(m));
            let at = at.unwrap_or_else(|| panic!("{case:?}: not written, or not here: {m:?}"));
            *from += at + 1;
            parts[of_stream[*from - 1].0] += 1;
        }
        let samples = self.samples.iter().zip(parts);
        samples
            .map(|(sample, parts)| {
                let whole = sample.messages(manifest, 0).len();
                assert!(parts == 0 || parts == whole, "{case:?}: half of {sample:?}");
                parts == whole
            })
            .collect()
    }

    /// What the writer itself puts in when the disk refuses a chunk.
    fn is_from_the_writer(&self, reader: &SessionReader, m: &Message) -> bool {
        let stream = reader.stream(m.stream).expect("stream");
        match stream.topic.as_str() {
            "/gaps" => self.lost.contains(&m.decode::<Gap>().expect("gap")),
            "/events" => m.decode::<Event>().expect("event").source == "disk",
            _ => false,
        }
    }

    /// Nothing durable is missing, and what is missing is the end of each stream, no longer than
    /// a chunk.
    fn check_missing(&self, is_there: &[bool], case: &dyn Debug) {
        let mut spans: BTreeMap<&str, (HostTime, HostTime)> = BTreeMap::new();
        for (i, sample) in self.samples[..self.appended].iter().enumerate() {
            let lost = self.is_lost(sample);
            assert!(
                !(lost && is_there[i]),
                "{case:?}: said to be lost: {sample:?}"
            );
            let stream = sample.numbers().map_or("", |n| n.0);
            let missing = !is_there[i] && !lost;
            if missing {
                assert!(!self.durable[i], "{case:?}: durable, missing: {sample:?}");
                let time = sample.time();
                let span = spans.entry(stream).or_insert((time, time));
                span.1 = time;
            } else if !lost {
                let cut = spans.get(stream);
                assert!(cut.is_none(), "{case:?}: a hole before {sample:?}: {cut:?}");
            }
        }
        for (stream, (first, last)) in spans {
            assert!(
                last - first <= MAX_CHUNK_NS,
                "{case:?}: {stream} lost {first} to {last}"
            );
        }
    }

    fn check_report(&self, report: &Report, case: &dyn Debug) {
        assert_eq!(report.lost, [], "{case:?}");
        assert_eq!(report.undecodable, 0, "{case:?}");
        // A cut is known for what it is, and not taken for damage.
        for d in &report.damage {
            assert_eq!(d.damage.kind, DamageKind::CutOff, "{case:?}");
        }
        for (name, s) in &report.streams {
            assert_eq!(s.samples + s.gaps, s.expected(), "{case:?}: {name}");
            let bad = (s.repeated, s.contradicted, s.bad_payloads);
            assert_eq!(bad, (0, 0, 0), "{case:?}: {name}");
        }
        if self.closed {
            assert!(report.is_sound(), "{case:?}: {report:#?}");
            for name in CAMERAS {
                let numbers = self.samples.iter().filter_map(Sample::numbers);
                let appended = numbers.filter(|n| n.0 == name).count() as u64;
                assert_eq!(report.streams[name].expected(), appended, "{case:?}");
            }
        }
    }

    fn check_all(&self, disk: &FaultStorage, crashes: &[CrashKind], case: &dyn Debug) {
        for crash in crashes {
            self.check(&disk.crash(*crash), &(case, crash));
        }
    }
}

/// No number is in two gap records.
fn check_gaps(reader: &SessionReader, found: &[Message], case: &dyn Debug) {
    let id = reader.manifest().stream::<Gap>("").expect("stream").id;
    let gaps = found.iter().filter(|m| m.stream == id);
    let mut gaps: Vec<Gap> = gaps.map(|m| m.decode().expect("gap")).collect();
    gaps.sort_by(|a, b| (&a.stream, a.first).cmp(&(&b.stream, b.first)));
    for two in gaps.windows(2) {
        let apart = two[0].stream != two[1].stream || two[0].last < two[1].first;
        assert!(apart, "{case:?}: {two:?}");
    }
}

/// Every fault that an operation can suffer.
fn faults(at: u64, operation: Operation) -> Vec<Fault> {
    let mut keeps = match operation {
        Operation::Append(n) => vec![0, 1, n / 2, n - 1, n],
        _ => vec![0],
    };
    keeps.dedup();
    let kinds = [
        FaultKind::PowerCut,
        FaultKind::NoSpace,
        FaultKind::InputOutput,
    ];
    kinds
        .into_iter()
        .flat_map(|kind| {
            let faults = keeps.iter().map(move |&keep| Fault { at, kind, keep });
            faults.collect::<Vec<_>>()
        })
        .collect()
}

/// The operations of a recording on a disk without faults.
fn operations(samples: &[Sample]) -> Vec<Operation> {
    let disk = FaultStorage::new();
    let run = Run::record(&disk, samples, |_, _| {});
    assert!(run.closed);
    run.check(&disk, &"no fault");
    disk.log()
}

#[test]
fn every_operation_fails_in_every_way() {
    let samples = samples(2.6);
    let operations = operations(&samples);
    assert!(operations.len() > 35, "{operations:?}");
    let mut cases = 0;
    for (at, operation) in (0..).zip(operations) {
        for fault in faults(at, operation) {
            let disk = FaultStorage::with_fault(fault);
            let run = Run::record(&disk, &samples, |_, _| {});
            run.check_all(&disk, &CRASHES, &(fault, operation));
            if fault.kind == FaultKind::PowerCut {
                assert!(!run.closed);
            }
            if fault.kind == FaultKind::InputOutput && run.created {
                // The manifest comes last; nothing can stand in for that.
                let survived = run.incidents == 1 && run.lost.is_empty();
                assert_eq!(survived, run.closed, "{fault:?}, {operation:?}");
            }
            cases += 1;
        }
    }
    eprintln!("{cases} faults, {} crash images each", CRASHES.len());
}

/// A power cut after a failure that the writer has survived.
#[test]
fn power_cuts_behind_a_survived_failure() {
    let samples = samples(2.1);
    for (at, operation) in (0..).zip(operations(&samples)) {
        let keep = match operation {
            Operation::Append(n) => n / 2,
            _ => 0,
        };
        let kind = FaultKind::InputOutput;
        let fault = Fault { at, kind, keep };
        let disk = FaultStorage::with_fault(fault);
        Run::record(&disk, &samples, |run, _| {
            run.check_all(&disk, &CRASHES[..4], &(fault, operation, run.appended));
        });
    }
}

/// Several operations fail, in a row or some apart: the chunk goes into the next segment, or gap
/// records go there in place of its samples, or the writer is finished.
#[test]
fn several_failures() {
    let samples = samples(1.6);
    let operations = operations(&samples).len() as u64;
    let mut patterns: Vec<Vec<u64>> = (1..=6).map(|n| (0..n).collect()).collect();
    patterns.extend((2..=12).map(|apart| vec![0, apart]));
    patterns.extend((2..=8).map(|apart| vec![0, apart, 2 * apart]));
    let (mut moved, mut lost, mut fatal) = (0, 0, 0);
    for at in 0..operations {
        for (pattern, keep) in patterns.iter().zip([0, 700].into_iter().cycle()) {
            let faults = pattern.iter().map(|after| Fault {
                at: at + after,
                kind: FaultKind::InputOutput,
                keep,
            });
            let disk = FaultStorage::with_faults(faults);
            let run = Run::record(&disk, &samples, |_, _| {});
            run.check_all(&disk, &CRASHES[..3], &(at, pattern, keep));
            match (run.closed, run.lost.is_empty()) {
                (true, true) => moved += 1,
                (true, false) => lost += 1,
                (false, _) => fatal += usize::from(run.created),
            }
        }
    }
    eprintln!("{moved} chunks moved, {lost} replaced by gap records, {fatal} writers finished");
    assert!(moved > 30 && lost > 30 && fatal > 30);
}

/// A disk of every size, full at some point: everything durable is there, and the session is
/// closed, unless not even a manifest fits any more and the writer says so.
#[test]
fn a_full_disk_ends_in_a_valid_session() {
    // Without gaps, because a chunk must be larger than what the manifest needs.
    let samples = support::samples(3.1);
    let disk = FaultStorage::new();
    assert!(Run::record(&disk, &samples, |_, _| {}).closed);
    let size = |path: &String| disk.content(path).map_or(0, |c| c.len());
    let whole: usize = disk.paths().iter().map(size).sum();
    let manifest = size(&layout::MANIFEST.to_owned());
    let (mut created, mut closed) = (0, 0);
    for capacity in (0..whole + manifest).step_by(487) {
        let disk = FaultStorage::with_capacity(capacity);
        let run = Run::record(&disk, &samples, |_, _| {});
        run.check_all(&disk, &CRASHES[..3], &("capacity", capacity));
        if !run.created {
            continue;
        }
        created += 1;
        let reader = SessionReader::open(Arc::new(disk.clone())).expect("open");
        let paths = disk.paths();
        let used: usize = paths
            .iter()
            .map(|p| disk.content(p).map_or(0, |c| c.len()))
            .sum();
        match reader.manifest().state {
            State::Closed => closed += 1,
            _ => assert!(
                capacity - used < 2 * manifest,
                "{capacity} with {used} used"
            ),
        }
    }
    eprintln!("{closed} of {created} closed");
    assert!(2 * closed > created);
}

/// A session that rolls over into new segments, with faults around every roll.
#[test]
fn faults_where_a_segment_ends() {
    let samples = samples_at([500 * MS, 500 * MS], 125.0);
    let disk = FaultStorage::new();
    let mut segments = 0;
    let mut last = 0;
    let mut around = Vec::new();
    let run = Run::record(&disk, &samples, |_, writer| {
        let here = disk.operations();
        if writer.manifest().segments.len() > segments {
            segments = writer.manifest().segments.len();
            around.extend(last.max(2) - 2..here + 2);
        }
        last = here;
    });
    assert!(run.closed && segments == 3, "{segments} segments");
    run.check(&disk, &"no fault");
    let operations = disk.log();
    around.retain(|at| *at > 30);
    around.extend(operations.len() as u64 - 8..operations.len() as u64);
    around.dedup();
    assert!(around.len() > 30, "{around:?}");
    for at in around {
        let operation = operations[at as usize];
        for fault in faults(at, operation) {
            let disk = FaultStorage::with_fault(fault);
            let run = Run::record(&disk, &samples, |_, _| {});
            let few = [CRASHES[0], CRASHES[1], CRASHES[5]];
            run.check_all(&disk, &few, &(fault, operation));
        }
    }
}
