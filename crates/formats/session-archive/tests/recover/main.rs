//! Recovery gives back everything that can be trusted, says exactly what it could not, and never
//! touches the source.

mod chunk_order;
mod damaged_chunks;
mod damaged_frames;
mod impossible;
mod segments;
#[path = "../support/mod.rs"]
mod support;

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;

use session_archive::layout;
use session_archive::manifest::{Manifest, State};
use session_archive::mcap::{CHUNK_PREFIX, Record, RecordIter, sealed_chunk};
use session_archive::reader::{Entry, Message, ReadError, SessionReader};
use session_archive::record::{
    ClockMap, CompressedVideo, Frame, Gap, ImuBatch, Protobuf, Record as _, paws::gap::Cause,
};
use session_archive::recover::{RecoverError, Recovery, close_cut_off, recover};
use session_archive::scan::DamageKind;
use session_archive::storage::{CrashKind, Fault, FaultKind, FaultStorage, Operation};
use session_archive::time::HostTime;
use session_archive::verify::{LostSamples, verify};
use session_archive::writer::SessionWriter;
use support::{MS, START, Sample, messages, put, record, samples, samples_at, spec, stop};

const UNIT: usize = 400;

fn open(disk: &FaultStorage) -> SessionReader {
    SessionReader::open(Arc::new(disk.clone())).expect("open")
}

/// Recovers; the source must be as it was.
fn recovered(disk: &FaultStorage) -> (Recovery, FaultStorage) {
    let before = files(disk);
    let target = FaultStorage::new();
    let result = recover(&open(disk), Arc::new(target.clone()), |_| {}).expect("recover");
    assert!(before == files(disk), "the source was touched");
    assert!(result.copy.is_sound(), "{:#?}", result.copy);
    assert_eq!(result.copy, verify(&open(&target), |_| {}).expect("verify"));
    (result, target)
}

fn files(disk: &FaultStorage) -> BTreeMap<String, Vec<u8>> {
    let paths = disk.paths().into_iter();
    paths
        .map(|p| (p.clone(), disk.content(&p).expect("content")))
        .collect()
}

fn segments(disk: &FaultStorage) -> BTreeMap<String, Vec<u8>> {
    let mut files = files(disk);
    files.retain(|path, _| path.starts_with("segments/"));
    files
}

/// What a clean close leaves of a session that holds just these samples.
fn clean(samples: &[Sample]) -> FaultStorage {
    let disk = FaultStorage::new();
    record(Arc::new(disk.clone()), samples, UNIT).expect("record");
    disk
}

/// The samples that a session holds.
fn held(disk: &FaultStorage, samples: &[Sample]) -> Vec<Sample> {
    let reader = open(disk);
    let found = messages(&reader);
    let is_there = |sample: &&Sample| {
        let expected = sample.messages(reader.manifest(), UNIT);
        found.iter().any(|m| expected[0].is(m))
    };
    samples.iter().filter(is_there).cloned().collect()
}

/// A disk with these files, which fails like this.
fn disk_with(files: &BTreeMap<String, Vec<u8>>, fault: Option<Fault>) -> FaultStorage {
    let disk = FaultStorage::with_faults(fault);
    for (path, content) in files {
        disk.set_content(path, content.clone());
    }
    disk
}

/// A chunk of a segment file.
struct ChunkAt {
    /// Its record.
    bytes: Range<usize>,
    /// The message indexes behind it.
    indexes: Range<usize>,
    /// Numbers in it, by stream, with the times of the first and last sample.
    numbers: BTreeMap<String, (u64, u64)>,
}

/// Every chunk of a segment, the head first.
fn chunks(disk: &FaultStorage, segment: u32) -> Vec<ChunkAt> {
    let manifest = open(disk).manifest().clone();
    let bytes = disk.content(&layout::segment(segment)).expect("segment");
    let mut records = RecordIter::new(&bytes[8..]);
    let mut out: Vec<ChunkAt> = Vec::new();
    let mut at = 8;
    while let Some(Ok(record)) = records.next() {
        let end = bytes.len() - records.remaining();
        match record {
            Record::Chunk(chunk) => {
                let mut numbers: BTreeMap<String, (u64, u64)> = BTreeMap::new();
                for m in chunk.messages().flatten() {
                    let stream = &manifest.streams[usize::from(m.channel_id) - 1];
                    let (first, last) = if stream.schema == Frame::SCHEMA.name {
                        let n = Frame::decode(m.data).expect("frame").number;
                        (n, n)
                    } else if stream.schema == ImuBatch::SCHEMA.name {
                        let batch = ImuBatch::decode(m.data).expect("batch");
                        let n = batch.times.len() as u64;
                        (batch.first_number, batch.first_number + n - 1)
                    } else {
                        continue;
                    };
                    let span = numbers.entry(stream.of.clone()).or_insert((first, last));
                    *span = (span.0.min(first), span.1.max(last));
                }
                out.push(ChunkAt {
                    bytes: at..end,
                    indexes: end..end,
                    numbers,
                });
            }
            Record::MessageIndex(_) => out.last_mut().expect("chunk").indexes.end = end,
            Record::DataEnd { .. } => break,
            _ => {}
        }
        at = end;
    }
    out
}

fn change(disk: &FaultStorage, segment: u32, damage: impl FnOnce(&mut Vec<u8>)) {
    let path = layout::segment(segment);
    let mut bytes = disk.content(&path).expect("segment");
    damage(&mut bytes);
    disk.set_content(&path, bytes);
}

/// Missing numbers, by stream.
type Missing = BTreeMap<String, BTreeSet<u64>>;

/// What is missing without these chunks.
fn missing(chunks: &[&ChunkAt]) -> Missing {
    let mut gone = Missing::new();
    for (stream, (first, last)) in chunks.iter().flat_map(|c| &c.numbers) {
        let numbers = gone.entry(stream.clone()).or_default();
        numbers.extend(*first..=*last);
    }
    gone
}

/// What must be reported lost without these chunks.
fn lost(samples: &[Sample], chunks: &[&ChunkAt]) -> Vec<LostSamples> {
    lost_without(samples, &missing(chunks))
}

/// What must be reported lost without these numbers: by stream, with the times of the samples
/// around, or of those at the stream's ends.
fn lost_without(samples: &[Sample], gone: &Missing) -> Vec<LostSamples> {
    let times = times(samples);
    let mut lost = Vec::new();
    for ((stream, number), time) in &times {
        let is_gone = |n: u64| gone.get(*stream).is_some_and(|g| g.contains(&n));
        if !is_gone(*number) || number.checked_sub(1).is_some_and(is_gone) {
            continue;
        }
        let last = (*number..)
            .take_while(|n| is_gone(*n))
            .last()
            .expect("last");
        let at = |n: u64| times.get(&(*stream, n)).copied();
        lost.push(LostSamples {
            stream: (*stream).to_owned(),
            first: *number,
            last,
            after: number.checked_sub(1).and_then(at).unwrap_or(*time),
            before: at(last + 1).or(at(last)).expect("time"),
        });
    }
    lost.sort_by_key(|l| (l.after, l.first));
    lost
}

/// A copy of the disk without one file.
fn without(disk: &FaultStorage, path: &str) -> FaultStorage {
    let copy = FaultStorage::new();
    for (other, content) in files(disk) {
        if other != path {
            copy.set_content(&other, content);
        }
    }
    copy
}

/// Closed in place it is what recovery makes beside it, also if the closing is cut off itself, at
/// any point, and done again.
#[test]
fn closing_in_place_is_recovery_and_can_be_cut_off_anywhere() {
    let samples = samples(3.0);
    let log = clean(&samples).log();
    let appends = (0..)
        .zip(&log)
        .filter_map(|(at, operation)| match operation {
            Operation::Append(n) => Some((at, n / 2)),
            _ => None,
        });
    let mut cuts = 0;
    for (at, keep) in appends {
        let kind = FaultKind::PowerCut;
        let disk = FaultStorage::with_fault(Fault { at, kind, keep });
        record(Arc::new(disk.clone()), &samples, UNIT).expect_err("cut");
        let cut = disk.crash(CrashKind::ProcessKilled);
        if SessionReader::open(Arc::new(cut.clone())).is_err() {
            continue;
        }
        let cut = files(&cut);
        let closed = disk_with(&cut, None);
        close_cut_off(Arc::new(closed.clone()))
            .expect("closing")
            .expect("it was open");
        let (_, beside) = recovered(&disk_with(&cut, None));
        assert!(files(&closed) == files(&beside), "cut at {at}");
        assert!(
            close_cut_off(Arc::new(closed.clone()))
                .expect("again")
                .is_none(),
            "it is closed"
        );
        for step in 0.. {
            let disk = disk_with(
                &cut,
                Some(Fault {
                    at: step,
                    kind,
                    keep: 3,
                }),
            );
            if close_cut_off(Arc::new(disk.clone())).is_ok() {
                break;
            }
            let again = disk.crash(CrashKind::ProcessKilled);
            close_cut_off(Arc::new(again.clone())).expect("closing again");
            assert!(files(&again) == files(&closed), "cut at {at}, then {step}");
        }
        cuts += 1;
    }
    assert!(cuts > 5, "{cuts}");
}

/// A full disk is where a recording often ends: closing it must not make it fuller.
#[test]
fn closing_in_place_without_space_leaves_nothing_behind() {
    let samples = samples(2.0);
    let at = clean(&samples).log().len() as u64 / 2;
    let kind = FaultKind::PowerCut;
    let disk = FaultStorage::with_fault(Fault { at, kind, keep: 0 });
    record(Arc::new(disk.clone()), &samples, UNIT).expect_err("cut");
    let cut = files(&disk.crash(CrashKind::ProcessKilled));
    let kind = FaultKind::NoSpace;
    let full = disk_with(
        &cut,
        Some(Fault {
            at: 0,
            kind,
            keep: 100,
        }),
    );
    let error = close_cut_off(Arc::new(full.clone())).expect_err("no space");
    assert!(matches!(error, RecoverError::Write(_)), "{error}");
    assert!(files(&full) == cut, "something was left");
}

#[test]
fn what_is_damaged_is_not_closed_in_place() {
    let disk = clean(&samples(2.0));
    let path = layout::segment(0);
    let mut content = disk.content(&path).expect("segment");
    let middle = content.len() / 2;
    content[middle] ^= 1;
    disk.set_content(&path, content);
    let mut manifest = open(&disk).manifest().clone();
    manifest.state = State::Recording;
    disk.set_content(layout::MANIFEST, manifest.to_bytes());
    let before = files(&disk);
    let error = close_cut_off(Arc::new(disk.clone())).expect_err("damaged");
    assert!(matches!(error, RecoverError::Damaged(_)), "{error}");
    assert!(files(&disk) == before, "it was touched");
}

/// Cut off at any chunk, with any part of the next behind it: what recovery makes is byte for
/// byte what the same chunks would have become in a session that was closed.
#[test]
fn a_recovered_prefix_is_a_clean_close_of_the_same_chunks() {
    let samples = samples(3.0);
    let disk = clean(&samples);
    let mut cuts = 0;
    for (at, operation) in (0..).zip(disk.log()) {
        let Operation::Append(n) = operation else {
            continue;
        };
        for keep in [0, 1, 48, 49, 50, n / 3, n - 1] {
            let kind = FaultKind::PowerCut;
            let disk = FaultStorage::with_fault(Fault { at, kind, keep });
            record(Arc::new(disk.clone()), &samples, UNIT).expect_err("cut");
            let cut = disk.crash(CrashKind::ProcessKilled);
            match SessionReader::open(Arc::new(cut.clone())) {
                Err(ReadError::NoSession) => continue,
                other => other.expect("open"),
            };
            let (_, target) = recovered(&cut);
            let twin = clean(&held(&target, &samples));
            // A segment that was just being opened keeps its number, and nothing else is there.
            assert_eq!(segments(&target).len(), segments(&cut).len());
            if !segments(&cut).is_empty() {
                assert!(
                    segments(&target) == segments(&twin),
                    "{operation:?} {at}, {keep} kept"
                );
            }
            cuts += 1;
        }
    }
    assert!(cuts > 50, "{cuts}");
}

#[test]
fn recovering_a_sound_session_changes_nothing() {
    let disk = clean(&samples(2.0));
    let (first, copy) = recovered(&disk);
    assert!(first.source.is_sound());
    assert_eq!(segments(&disk), segments(&copy));
    let manifest = open(&copy).manifest().clone();
    let expected = Manifest {
        state: State::Recovered,
        ..open(&disk).manifest().clone()
    };
    assert_eq!(manifest, expected);

    // Nor does recovering what was recovered, damage and all.
    let damaged = clean(&samples(3.0));
    let chunk = chunks(&damaged, 0)[2].bytes.clone();
    change(&damaged, 0, |bytes| bytes[chunk.start + 300] ^= 4);
    let (_, once) = recovered(&damaged);
    let (_, twice) = recovered(&once);
    assert!(files(&once) == files(&twice));
}

/// The time of every numbered sample.
fn times(samples: &[Sample]) -> BTreeMap<(&'static str, u64), HostTime> {
    let mut times = BTreeMap::new();
    for sample in samples {
        if let Some((stream, first, last)) = sample.numbers() {
            for (number, k) in (first..=last).zip(0..) {
                let period = if last > first { 5 * MS } else { 0 };
                times.insert((stream, number), sample.time() + k * period);
            }
        }
    }
    times
}

fn recorded_gaps(messages: &[Message], manifest: &Manifest) -> Vec<Gap> {
    let id = manifest.stream::<Gap>("").expect("stream").id;
    let gaps = messages.iter().filter(|m| m.stream == id);
    gaps.map(|m| m.decode().expect("gap")).collect()
}

#[test]
fn rig_files_are_checked() {
    let disk = clean(&samples(1.0));
    let path = layout::rig_file("rig.toml");
    for source in [without(&disk, &path), {
        let changed = disk.snapshot();
        changed.set_content(&path, b"revision = 2\n".to_vec());
        changed
    }] {
        let (result, target) = recovered(&source);
        assert_eq!(result.source.bad_rig_files, ["rig.toml"]);
        assert!(!result.source.is_sound());
        assert!(
            target.content(&path).is_none(),
            "not passed on as if it were right"
        );
    }
    let mut manifest = open(&disk).manifest().clone();
    manifest.rig[0].name = "../../elsewhere".to_owned();
    assert!(Manifest::from_bytes(&manifest.to_bytes()).is_err());
}

#[test]
fn nothing_is_written_over() {
    let disk = clean(&samples(1.0));
    let before = files(&disk);
    assert!(recover(&open(&disk), Arc::new(disk.clone()), |_| {}).is_err());
    assert!(before == files(&disk));
}

/// A message that does not match its schema is reported. No recorder of ours
/// writes one, so the chunk is made here.
#[test]
fn every_message_is_decoded() {
    let disk = FaultStorage::new();
    let mut writer = SessionWriter::create(Arc::new(disk.clone()), spec()).expect("create");
    let map = ClockMap {
        clock: "feet".to_owned(),
        ..ClockMap::default()
    };
    writer.append("feet", START, START, &map).expect("map");
    writer.poll(START + 2000 * MS).expect("poll");
    let reader = open(&disk);
    assert_eq!(verify(&reader, |_| {}).expect("verify").undecodable, 0);

    let at = messages(&reader)[0].payload_offset as usize;
    let chunk = chunks(&disk, 0).remove(1).bytes;
    change(&disk, 0, |bytes| {
        let mut records = bytes[chunk.start + CHUNK_PREFIX..chunk.end].to_vec();
        // The first field becomes an integer, and is text.
        records[at] = 0x08;
        bytes.truncate(chunk.start);
        bytes.extend(sealed_chunk(&records));
    });
    assert_eq!(verify(&open(&disk), |_| {}).expect("verify").undecodable, 1);
}
