//! Recovery gives back everything that can be trusted, says exactly what it could not, and never
//! touches the source.

mod support;

use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::Arc;

use session_archive::layout;
use session_archive::manifest::{Manifest, State};
use session_archive::mcap::{CHUNK_PREFIX, Record, RecordIter, sealed_chunk};
use session_archive::reader::{Entry, Message, ReadError, SessionReader};
use session_archive::record::{
    ClockMap, Frame, Gap, ImuBatch, Protobuf, Record as _, paws::gap::Cause,
};
use session_archive::recover::{RecoverError, Recovered, close_cut_off, recover};
use session_archive::scan::DamageKind;
use session_archive::storage::{CrashKind, Fault, FaultKind, FaultStorage, Operation};
use session_archive::time::HostTime;
use session_archive::verify::{Lost, verify};
use session_archive::writer::SessionWriter;
use support::{MS, START, Sample, messages, put, record, samples, samples_at, spec, stop};

const UNIT: usize = 400;

fn open(disk: &FaultStorage) -> SessionReader {
    SessionReader::open(Arc::new(disk.clone())).expect("open")
}

/// Recovers; the source must be as it was.
fn recovered(disk: &FaultStorage) -> (Recovered, FaultStorage) {
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

/// What must be reported lost without these chunks: by stream, with the times of the samples
/// around, or of those at the stream's ends.
fn lost(samples: &[Sample], chunks: &[&ChunkAt]) -> Vec<Lost> {
    let times = times(samples);
    let mut gone: BTreeMap<&str, BTreeSet<u64>> = BTreeMap::new();
    for (stream, (first, last)) in chunks.iter().flat_map(|c| &c.numbers) {
        gone.entry(stream).or_default().extend(*first..=*last);
    }
    let mut lost = Vec::new();
    for ((stream, number), time) in &times {
        let is_gone = |n: u64| gone.get(stream).is_some_and(|g| g.contains(&n));
        if !is_gone(*number) || number.checked_sub(1).is_some_and(is_gone) {
            continue;
        }
        let last = (*number..)
            .take_while(|n| is_gone(*n))
            .last()
            .expect("last");
        let at = |n: u64| times.get(&(*stream, n)).copied();
        lost.push(Lost {
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

fn recorded_gaps(messages: &[Message], manifest: &Manifest) -> Vec<Gap> {
    let id = manifest.stream::<Gap>("").expect("stream").id;
    let gaps = messages.iter().filter(|m| m.stream == id);
    gaps.map(|m| m.decode().expect("gap")).collect()
}

/// Damages a session of four seconds in one way; `gone` are the chunks (0 is the head) that
/// cannot survive it. Everything else must.
fn check(name: &str, damage: impl FnOnce(&mut Vec<u8>, &[ChunkAt]), gone: &[usize]) {
    let samples = samples(4.0);
    let disk = clean(&samples);
    let chunks = chunks(&disk, 0);
    assert_eq!(chunks.len(), 9);
    let whole = messages(&open(&disk));
    change(&disk, 0, |bytes| damage(bytes, &chunks));

    let (result, target) = recovered(&disk);
    assert!(!result.source.is_sound(), "{name}: not noticed");
    assert!(!result.source.damage.is_empty(), "{name}: no damage");
    let gone: Vec<&ChunkAt> = gone.iter().map(|i| &chunks[*i]).collect();
    let expected = lost(&samples, &gone);
    assert_eq!(result.source.lost, expected, "{name}");

    // The copy says so itself.
    let copy = open(&target);
    let found = messages(&copy);
    let gaps = recorded_gaps(&found, copy.manifest());
    assert_eq!(gaps.len(), expected.len(), "{name}");
    for (gap, lost) in gaps.iter().zip(&expected) {
        assert_eq!(gap.cause(), Cause::Damaged, "{name}");
        let span = (gap.first, gap.last, gap.time_before, gap.time_after);
        let (after, before) = (Some(lost.after.0), Some(lost.before.0));
        assert_eq!(span, (lost.first, lost.last, after, before), "{name}");
        assert_eq!(gap.stream, lost.stream, "{name}");
    }
    for (stream, report) in &result.copy.streams {
        let whole = report.samples + report.gaps;
        assert_eq!(whole, report.expected(), "{name}: {stream}");
    }

    // And holds everything else, byte for byte.
    let is_gone = |m: &Message| {
        let offset = m.chunk_offset as usize;
        gone.iter().any(|chunk| chunk.bytes.start == offset)
    };
    let kept = whole.iter().filter(|m| !is_gone(m));
    let of_recovery = if gaps.is_empty() { 0 } else { gaps.len() + 1 };
    let (found, added) = found.split_at(found.len() - of_recovery);
    assert_eq!(added.len(), of_recovery);
    assert!(
        kept.map(|m| (m.stream, m.sequence, m.time, &m.data))
            .eq(found
                .iter()
                .map(|m| (m.stream, m.sequence, m.time, &m.data))),
        "{name}: the copy holds something else"
    );
}

#[test]
fn a_flip_costs_the_chunk_that_it_is_in_and_no_other() {
    for i in [0, 1, 4, 8] {
        check("payload", |b, c| b[c[i].bytes.start + 200] ^= 0x10, &[i]);
        check("last byte", |b, c| b[c[i].bytes.end - 1] ^= 0x80, &[i]);
        check("opcode", |b, c| b[c[i].bytes.start] ^= 1, &[i]);
        check(
            "opcode of a data end",
            |b, c| b[c[i].bytes.start] = 0x0F,
            &[i],
        );
        check("length", |b, c| b[c[i].bytes.start + 1] ^= 1, &[i]);
        check("huge length", |b, c| b[c[i].bytes.start + 8] = 0xFF, &[i]);
        check("size", |b, c| b[c[i].bytes.start + 26] ^= 1, &[i]);
        check("checksum", |b, c| b[c[i].bytes.start + 33] ^= 1, &[i]);
        check("compression", |b, c| b[c[i].bytes.start + 37] ^= 1, &[i]);
        check(
            "records' length",
            |b, c| b[c[i].bytes.start + 41] ^= 1,
            &[i],
        );
    }
}

#[test]
fn damage_beside_the_messages_costs_no_message() {
    for i in [0, 1, 4, 8] {
        check("start time", |b, c| b[c[i].bytes.start + 9] ^= 1, &[]);
        check("end time", |b, c| b[c[i].bytes.start + 23] ^= 1, &[]);
        check("index opcode", |b, c| b[c[i].indexes.start] ^= 0x20, &[]);
        check("index as chunk", |b, c| b[c[i].indexes.start] = 0x06, &[]);
        check(
            "index as data end",
            |b, c| b[c[i].indexes.start] = 0x0F,
            &[],
        );
        check("index length", |b, c| b[c[i].indexes.start + 1] ^= 3, &[]);
        check("index entry", |b, c| b[c[i].indexes.end - 3] ^= 1, &[]);
    }
    let end = |c: &[ChunkAt]| c[8].indexes.end;
    check("magic", |b, _| b[0] = 0, &[]);
    check("header", |b, _| b[12] ^= 1, &[]);
    check("header length", |b, _| b[9] ^= 1, &[]);
    check("data end", |b, c| b[end(c)] ^= 1, &[]);
    check("data end length", |b, c| b[end(c) + 1] ^= 1, &[]);
    check("data checksum", |b, c| b[end(c) + 9] ^= 1, &[]);
    check("summary", |b, c| b[end(c) + 100] ^= 1, &[]);
    check(
        "footer",
        |b, _| b.iter_mut().rev().nth(20).map_or((), |b| *b ^= 1),
        &[],
    );
    check(
        "last magic",
        |b, _| b.iter_mut().last().map_or((), |b| *b ^= 1),
        &[],
    );
    check("summary gone", |b, c| b.truncate(end(c)), &[]);
    check("summary cut", |b, c| b.truncate(end(c) + 40), &[]);
    check("longer", |b, _| b.extend([0; 512]), &[]);
}

#[test]
fn blocks_and_ends_that_are_gone() {
    // Zeros where the disk lost a block: over the seam of two chunks, and inside one.
    check(
        "seam",
        |b, c| b[c[3].bytes.end - 2000..][..4096].fill(0),
        &[3, 4],
    );
    check(
        "inside",
        |b, c| b[c[3].bytes.start + 100..][..4096].fill(0),
        &[3],
    );
    check("the magic and the head", |b, _| b[..4096].fill(0), &[0]);
    // Blocks that are not there at all, so that everything behind has moved.
    let cut = |b: &mut Vec<u8>, r: Range<usize>| drop(b.drain(r));
    check(
        "inside, removed",
        |b, c| cut(b, c[5].bytes.start + 100..c[5].bytes.start + 612),
        &[5],
    );
    // Where chunk 5 said it would end there is now the middle of chunk 6, which is whole.
    check(
        "much removed",
        |b, c| cut(b, c[5].bytes.start + 100..c[5].bytes.start + 3100),
        &[5],
    );
    check(
        "seam, removed",
        |b, c| cut(b, c[5].bytes.end - 100..c[6].bytes.start + 400),
        &[5, 6],
    );
    check(
        "a chunk, removed",
        |b, c| cut(b, c[5].bytes.start..c[5].indexes.end),
        &[5],
    );
    check("a record, removed", |b, c| cut(b, c[5].bytes.clone()), &[5]);
    // Bytes that do not belong there.
    check(
        "inserted",
        |b, c| drop(b.splice(c[6].bytes.start..c[6].bytes.start, [7; 1000])),
        &[],
    );
    check(
        "cut in the last chunk",
        |b, c| b.truncate(c[8].bytes.end - 1),
        &[8],
    );
    check(
        "cut in a chunk",
        |b, c| b.truncate(c[6].bytes.start + 3000),
        &[6, 7, 8],
    );
    check(
        "cut between chunks",
        |b, c| b.truncate(c[6].indexes.end),
        &[7, 8],
    );
    check(
        "cut to the magic",
        |b, _| b.truncate(8),
        &[0, 1, 2, 3, 4, 5, 6, 7, 8],
    );
    check(
        "cut to nothing",
        |b, _| b.clear(),
        &[0, 1, 2, 3, 4, 5, 6, 7, 8],
    );
    // Two kinds simultaneously.
    check(
        "everywhere",
        |b, c| {
            b[c[1].bytes.start + 60] ^= 1;
            b[c[3].bytes.start + 1] ^= 0xFF;
            b[c[8].bytes.end - 1] ^= 1;
            let n = b.len();
            b[n - 12] ^= 1;
        },
        &[1, 3, 8],
    );
}

/// Cut off, so that no checksum over the whole file helps: a header that contradicts the chunk's
/// content is noticed all the same, and costs nothing.
#[test]
fn a_wrong_header_in_a_session_that_was_cut_off() {
    let whole = clean(&samples(3.0));
    let chunks = chunks(&whole, 0);
    let disk = whole.snapshot();
    disk.set_content(layout::MANIFEST, {
        let mut manifest = open(&whole).manifest().clone();
        manifest.state = State::Recording;
        manifest.segments.clear();
        manifest.extents.clear();
        manifest.to_bytes()
    });
    let at = chunks[3].bytes.start;
    change(&disk, 0, |bytes| {
        bytes.truncate(chunks[5].indexes.end);
        bytes[at + 10] ^= 1;
    });
    let (result, target) = recovered(&disk);
    let kinds: Vec<_> = result.source.damage.iter().map(|d| d.damage.kind).collect();
    assert_eq!(kinds, [DamageKind::Header]);
    change(&disk, 0, |bytes| bytes[at + 10] ^= 1);
    assert_eq!(messages(&open(&target)).len(), messages(&open(&disk)).len());
}

/// Two minutes in three segments, with a clock map in each.
fn long() -> (Vec<Sample>, FaultStorage) {
    let samples = samples_at([500 * MS, 500 * MS], 125.0);
    let disk = FaultStorage::new();
    let mut writer = SessionWriter::create(Arc::new(disk.clone()), spec()).expect("create");
    for sample in &samples {
        let since = sample.time() - START;
        if matches!(sample, Sample::Mark { .. }) && since % (50_000 * MS) == 0 {
            let map = ClockMap {
                clock: "feet".to_owned(),
                version: (since / (50_000 * MS)) as u32 + 1,
                ..ClockMap::default()
            };
            writer
                .append("feet", sample.time(), sample.time(), &map)
                .expect("map");
        }
        put(&mut writer, sample, 40).expect("put");
    }
    writer.close(stop(START)).expect("close");
    assert_eq!(writer.manifest().segments.len(), 3);
    (samples, disk)
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

fn clock_versions(reader: &SessionReader) -> Vec<u32> {
    let id = reader
        .manifest()
        .stream::<ClockMap>("feet")
        .expect("stream")
        .id;
    let all = messages(reader);
    let maps = all.iter().filter(|m| m.stream == id);
    maps.map(|m| m.decode::<ClockMap>().expect("map").version)
        .collect()
}

#[test]
fn a_missing_segment_is_lost_by_number_and_its_state_is_not() {
    let (samples, disk) = long();
    for segment in 0..3 {
        let gone = chunks(&disk, segment);
        let source = without(&disk, &layout::segment(segment));
        let (result, target) = recovered(&source);
        assert_eq!(result.source.missing_segments, [segment]);
        let all: Vec<&ChunkAt> = gone.iter().collect();
        assert_eq!(result.source.lost, lost(&samples, &all));
        assert_eq!(segments(&target).len(), 3, "numbers stay what they were");
        // What a later head repeats is not lost; of the first minute's two maps that is the second.
        let known: &[u32] = if segment == 0 { &[2, 3] } else { &[1, 2, 3] };
        assert_eq!(clock_versions(&open(&source)), known, "segment {segment}");
        assert_eq!(clock_versions(&open(&target)), known, "segment {segment}");
    }
}

#[test]
fn a_damaged_head_is_made_again_with_the_state_so_far() {
    let (_, disk) = long();
    change(&disk, 2, |bytes| bytes[3000] ^= 1);
    let (result, target) = recovered(&disk);
    assert_eq!(result.source.lost, []);
    let alone = FaultStorage::new();
    let path = layout::segment(2);
    alone.set_content(&path, target.content(&path).expect("segment"));
    let alone = open(&alone);
    assert_eq!(alone.manifest().cameras.len(), 2);
    assert_eq!(clock_versions(&alone), [3]);
}

#[test]
fn a_session_without_its_manifest() {
    let (_, disk) = long();
    let whole = messages(&open(&disk)).len();
    let path = layout::MANIFEST;
    let content = disk.content(path).expect("manifest");
    let torn = disk.snapshot();
    torn.set_content(path, content[..content.len() / 2].to_vec());
    let changed = disk.snapshot();
    let text = String::from_utf8(content).expect("text");
    changed.set_content(
        path,
        text.replace("\"rate_hz\": 30", "\"rate_hz\": 31").into(),
    );
    for (source, note) in [
        (without(&disk, path), "missing"),
        (torn, "no checksum"),
        (changed, "does not match"),
    ] {
        let (result, target) = recovered(&source);
        let found = result.source.manifest_note.expect("note");
        assert!(found.contains(note), "{found}");
        assert_eq!(messages(&open(&target)).len(), whole);
        assert_eq!(segments(&target), segments(&disk));
        let (was, is) = (
            open(&disk).manifest().clone(),
            open(&target).manifest().clone(),
        );
        assert_eq!((was.cameras, was.extents), (is.cameras, is.extents));
        assert_eq!(is.state, State::Recovered);
    }
}

/// The heads of a recovered copy fit the copy, whose segments have other lengths: they would be
/// used if its manifest were lost.
#[test]
fn a_recovered_copy_stands_without_its_manifest() {
    let (_, disk) = long();
    let at = chunks(&disk, 0)[20].bytes.start;
    change(&disk, 0, |bytes| bytes[at + 100] ^= 1);
    let (_, copy) = recovered(&disk);
    let bare = without(&copy, layout::MANIFEST);
    let (result, _) = recovered(&bare);
    assert_eq!(result.source.damage, []);
    assert_eq!(messages(&open(&bare)).len(), messages(&open(&copy)).len());
}

/// Without a manifest, the heads alone tell that a segment was given up and what of it counts.
#[test]
fn bytes_of_a_segment_that_was_given_up_do_not_count() {
    let samples = samples(3.0);
    let log = clean(&samples).log();
    let is_large = |o: &Operation| matches!(o, Operation::Append(n) if *n > 5000);
    let summary = log.iter().rposition(is_large).expect("summary");
    let last_chunk = log[..summary].iter().rposition(is_large).expect("chunk") as u64;
    let fault = Fault {
        at: last_chunk + 1,
        kind: FaultKind::InputOutput,
        keep: 0,
    };
    let disk = FaultStorage::with_faults([fault]);
    record(Arc::new(disk.clone()), &samples, UNIT).expect("record");
    let disk = disk.snapshot();
    let segments = open(&disk).manifest().segments.clone();
    assert_eq!(segments.len(), 2);
    // The bad place remains taken, or the file system would give it to the next segment.
    let kept = disk.content(&layout::segment(0)).expect("segment").len() as u64;
    assert!(kept > segments[0].bytes, "{kept} {segments:?}");
    let whole = messages(&open(&disk)).len();
    assert_eq!(whole, messages(&open(&clean(&samples))).len());
    assert!(verify(&open(&disk), |_| {}).expect("verify").is_sound());
    let source = without(&disk, layout::MANIFEST);
    let (result, target) = recovered(&source);
    assert_eq!(result.source.streams["feet"].repeated, 0);
    assert_eq!(messages(&open(&target)).len(), whole);
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

#[test]
fn damage_is_an_entry_like_any_other() {
    let disk = clean(&samples(3.0));
    let at = chunks(&disk, 0)[3].bytes.clone();
    change(&disk, 0, |bytes| bytes[at.start + 77] ^= 1);
    let reader = open(&disk);
    let mut damage = Vec::new();
    for entry in reader.entries() {
        if let Entry::Damage { segment, damage: d } = entry.expect("read") {
            damage.push((segment, d.bytes));
        }
    }
    assert_eq!(damage, [(0, at.start as u64..at.end as u64)]);
}

/// Another session of the same rig: the same streams, and numbers that go on.
fn other() -> FaultStorage {
    let disk = FaultStorage::new();
    let mut spec = spec();
    spec.session_id = "0192aa00-0000-7000-8000-000000000002".to_owned();
    let mut writer = SessionWriter::create(Arc::new(disk.clone()), spec).expect("create");
    for sample in samples(1.0) {
        put(&mut writer, &sample, UNIT).expect("put");
    }
    writer.close(stop(START)).expect("close");
    disk
}

/// Every checksum of such a segment holds, and it is not what was recorded.
#[test]
fn a_segment_of_another_session_or_number_is_damage() {
    let (_, disk) = long();
    let mine = disk.content(&layout::segment(1)).expect("segment");
    let theirs = other().content(&layout::segment(0)).expect("segment");
    for (number, content) in [(0, &theirs), (1, &theirs), (0, &mine)] {
        let disk = disk.snapshot();
        disk.set_content(&layout::segment(number), content.clone());
        let (result, copy) = recovered(&disk);
        let damage = &result.source.damage;
        assert_eq!(damage.len(), 1, "{damage:?}");
        assert_eq!(damage[0].segment, number);
        assert_eq!(damage[0].damage.kind, DamageKind::Foreign);
        assert_eq!(damage[0].damage.bytes, 0..content.len() as u64);
        assert!(result.source.streams["feet"].lost > 0);
        assert_eq!(result.source.streams["feet"].repeated, 0);
        // Nothing of it is in the copy: those that were in their place are.
        let bytes = |disk: &FaultStorage| -> Vec<Vec<u8>> {
            let messages = messages(&open(disk)).into_iter();
            messages
                .filter(|m| m.segment != number)
                .map(|m| m.data.to_vec())
                .collect()
        };
        let (kept, whole) = (bytes(&copy), bytes(&disk));
        assert_eq!(kept[..whole.len()], whole);
    }
}

/// A whole file of the same session and number, that somebody made in another way.
#[test]
fn a_closed_segment_has_the_length_that_the_manifest_says() {
    let disk = clean(&samples(3.0));
    let shorter = clean(&samples(1.0));
    let path = layout::segment(0);
    disk.set_content(&path, shorter.content(&path).expect("segment"));
    let report = verify(&open(&disk), |_| {}).expect("verify");
    let kinds: Vec<_> = report.damage.iter().map(|d| d.damage.kind).collect();
    assert_eq!(kinds, [DamageKind::Length]);
    let disk = clean(&samples(1.0));
    let longer = clean(&samples(3.0));
    disk.set_content(&path, longer.content(&path).expect("segment"));
    let report = verify(&open(&disk), |_| {}).expect("verify");
    let kinds: Vec<_> = report.damage.iter().map(|d| d.damage.kind).collect();
    assert_eq!(kinds, [DamageKind::Length]);
}

/// A file with a number far away costs nothing, with the manifest and without.
#[test]
fn a_stray_file_does_not_make_a_million_segments() {
    let disk = clean(&samples(1.0));
    disk.set_content(&layout::segment(999_999), b"not ours".to_vec());
    for manifest in [true, false] {
        let disk = match manifest {
            true => disk.snapshot(),
            false => without(&disk, layout::MANIFEST),
        };
        assert_eq!(open(&disk).segment_numbers().count(), 1);
        let (result, copy) = recovered(&disk);
        let damage = &result.source.damage;
        assert_eq!((damage.len(), damage[0].segment), (1, 999_999));
        assert_eq!(damage[0].damage.kind, DamageKind::Foreign);
        assert_eq!(damage[0].damage.bytes, 0..8);
        assert_eq!(segments(&copy).len(), 1);
    }
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
