//! Every byte of a small session changed, and every length of it cut: whatever is returned was
//! written, what is not is reported to the last sample, and memory remains within what the files
//! hold, whatever their headers claim.

mod support;

use std::collections::BTreeMap;
use std::sync::Arc;

use counting_allocator::{CountingAllocator, peak_of};
use session_archive::layout;
use session_archive::manifest::Manifest;
use session_archive::mcap::{CHUNK_PREFIX, MAGIC, Record, RecordIter, op, sealed_chunk};
use session_archive::reader::{Message, SessionReader};
use session_archive::record::{Gap, ImuBatch, Protobuf};
use session_archive::recover::recover;
use session_archive::scan::{Damage, Item, Scan};
use session_archive::storage::FaultStorage;
use session_archive::verify::{Report, verify};
use support::{MS, Sample, messages, record, samples_at};

#[global_allocator]
static ALLOCATOR: CountingAllocator = CountingAllocator;

/// A closed session of a second and a half; what it holds, by place.
struct SessionByPlace {
    disk: FaultStorage,
    messages: BTreeMap<(u64, u32), Message>,
    report: Report,
}

impl SessionByPlace {
    fn new() -> Self {
        let disk = FaultStorage::new();
        let mut samples = samples_at([150 * MS, 250 * MS], 1.5);
        // A few IMU batches at the start are enough; they are most of the bytes.
        samples.retain(|s| !matches!(s, Sample::Imu { first, .. } if *first >= 60));
        record(Arc::new(disk.clone()), &samples, 40).expect("record");
        let reader = SessionReader::open(Arc::new(disk.clone())).expect("open");
        let messages = messages(&reader)
            .into_iter()
            .map(|m| ((m.chunk_offset, m.payload_offset), m))
            .collect();
        let report = verify(&reader, |_| {}).expect("verify");
        assert!(report.is_sound());
        Self {
            disk,
            messages,
            report,
        }
    }

    fn segment(&self) -> Vec<u8> {
        self.disk.content(&layout::segment(0)).expect("segment")
    }

    /// The disk with other content in one file.
    fn with(&self, path: &str, content: Vec<u8>) -> FaultStorage {
        let disk = self.disk.snapshot();
        disk.set_content(path, content);
        disk
    }

    /// Reads a damaged copy: all that it returns is what was written, in order.
    fn check(&self, disk: &FaultStorage, case: &str) -> Report {
        let reader = SessionReader::open(Arc::new(disk.clone())).expect("open");
        let mut last = None;
        for m in messages(&reader) {
            let place = (m.chunk_offset, m.payload_offset);
            assert!(last < Some(place), "{case}: out of order");
            last = Some(place);
            let written = &self.messages[&place];
            assert_eq!(
                (m.stream, m.sequence, m.time, m.published, &m.data),
                (
                    written.stream,
                    written.sequence,
                    written.time,
                    written.published,
                    &written.data
                ),
                "{case}: returned something else"
            );
        }
        let report = verify(&reader, |_| {}).expect("verify");
        assert!(!report.is_sound(), "{case}: not noticed");
        report
    }

    /// Every sample is there or reported lost.
    fn check_lost(&self, report: &Report, case: &str) {
        for (name, whole) in &self.report.streams {
            let found = &report.streams[name];
            assert_eq!(
                (found.first, found.last),
                (whole.first, whole.last),
                "{case}"
            );
            assert_eq!(
                found.samples + found.lost,
                whole.samples,
                "{case}: {name} does not add up"
            );
            let spans = report.lost.iter().filter(|l| l.stream == *name);
            let lost: u64 = spans.map(|l| l.last - l.first + 1).sum();
            assert_eq!(lost, found.lost, "{case}: {name}");
        }
    }
}

/// What a byte can turn into.
fn changed(byte: u8, pattern: usize, offset: usize) -> u8 {
    match pattern {
        0 => byte ^ (1 << (offset % 8)),
        1 => byte ^ 0xFF,
        2 => 0,
        _ => 0xFF,
    }
}

#[test]
fn every_byte_of_a_segment_changed() {
    let written = SessionByPlace::new();
    let original = written.segment();
    assert!(original.len() < 50_000, "{}", original.len());
    for pattern in 0..4 {
        for offset in 0..original.len() {
            let byte = changed(original[offset], pattern, offset);
            // The head and the summary are most of the file, and much alike.
            let bulk = pattern > 0 && offset % 5 > 0;
            if byte == original[offset] || (bulk && is_bulk(&original, offset)) {
                continue;
            }
            let mut content = original.clone();
            content[offset] = byte;
            let case = format!("byte {offset} as {byte:#04x}");
            let disk = written.with(&layout::segment(0), content);
            let report = written.check(&disk, &case);
            written.check_lost(&report, &case);
        }
    }
}

/// Whether a byte is in the inside of the head or the summary.
fn is_bulk(segment: &[u8], offset: usize) -> bool {
    let mut records = RecordIter::new(&segment[MAGIC.len()..]);
    let (mut head, mut end) = (0..0, segment.len());
    while let Some(Ok(record)) = records.next() {
        let at = segment.len() - records.remaining();
        match record {
            Record::Chunk(chunk) if head.is_empty() => head = at - chunk.records.len()..at,
            Record::DataEnd { .. } => {
                end = at;
                break;
            }
            _ => {}
        }
    }
    head.contains(&offset) || (end..segment.len() - 40).contains(&offset)
}

#[test]
fn a_segment_cut_at_every_length() {
    let written = SessionByPlace::new();
    let original = written.segment();
    for length in 0..original.len() {
        let case = format!("cut to {length}");
        let disk = written.with(&layout::segment(0), original[..length].to_vec());
        let report = written.check(&disk, &case);
        written.check_lost(&report, &case);
    }
}

#[test]
fn damaged_sessions_are_recovered() {
    let written = SessionByPlace::new();
    let original = written.segment();
    for offset in (0..original.len()).step_by(37) {
        for cut in [false, true] {
            let mut content = original.clone();
            match cut {
                false => content[offset] ^= 0x5A,
                true => content.truncate(offset),
            }
            let disk = written.with(&layout::segment(0), content);
            let reader = SessionReader::open(Arc::new(disk)).expect("open");
            let target = FaultStorage::new();
            let recovered = recover(&reader, Arc::new(target), |_| {}).expect("recover");
            assert!(recovered.copy.is_sound(), "{offset}: {recovered:#?}");
        }
    }
}

#[test]
fn every_byte_and_every_length_of_the_manifest() {
    let written = SessionByPlace::new();
    let original = written.disk.content(layout::MANIFEST).expect("manifest");
    let whole = Manifest::from_bytes(&original).expect("manifest");
    let damaged = |content: Vec<u8>, case: String, open: bool| {
        assert!(
            Manifest::from_bytes(&content).is_err(),
            "{case}: not noticed"
        );
        // Opening reads the segments; once in a while is enough.
        if open {
            let disk = written.with(layout::MANIFEST, content);
            let reader = SessionReader::open(Arc::new(disk.clone())).expect("open");
            assert!(reader.manifest_note().is_some(), "{case}");
            assert_eq!(reader.manifest().cameras, whole.cameras);
            let report = written.check(&disk, &case);
            assert_eq!(report.messages, written.report.messages, "{case}");
        }
    };
    for pattern in 0..4 {
        for offset in 0..original.len() {
            let mut content = original.clone();
            content[offset] = changed(original[offset], pattern, offset);
            if content[offset] != original[offset] {
                damaged(
                    content,
                    format!("byte {offset}, {pattern}"),
                    offset % 29 == 0,
                );
            }
        }
    }
    for length in 0..original.len() {
        damaged(
            original[..length].to_vec(),
            format!("cut to {length}"),
            length % 29 == 0,
        );
    }
}

#[test]
fn every_byte_of_a_rig_file() {
    let written = SessionByPlace::new();
    let path = layout::rig_file("rig.toml");
    let original = written.disk.content(&path).expect("file");
    for offset in 0..original.len() {
        let mut content = original.clone();
        content[offset] ^= 1;
        let report = written.check(&written.with(&path, content), "rig file");
        assert_eq!(report.bad_rig_files, ["rig.toml"]);
    }
}

/// Everything a scan says of these bytes, and the most memory it held.
fn scan(bytes: &[u8]) -> (usize, Vec<Damage>, usize) {
    let file = Arc::new(bytes.to_vec());
    let ((chunks, damage), peak) = peak_of(|| {
        let mut scan = Scan::new(file, None, 0).expect("scan");
        let (mut chunks, mut damage) = (0, Vec::new());
        while let Some(item) = scan.next_item().expect("memory does not fail") {
            match item {
                Item::Chunk(_) => chunks += 1,
                Item::Damage(d) => damage.push(d),
            }
        }
        (chunks, damage)
    });
    (chunks, damage, peak)
}

/// A file that begins well and goes on with a record that claims to be `length` long.
fn claiming(opcode: u8, length: u64, body: &[u8]) -> Vec<u8> {
    let mut bytes = MAGIC.to_vec();
    bytes.push(opcode);
    bytes.extend(length.to_le_bytes());
    bytes.extend(body);
    bytes
}

#[test]
fn what_headers_claim_is_not_allocated() {
    let lengths = [
        0,
        1,
        40,
        1 << 20,
        63 << 20,
        1 << 32,
        1 << 40,
        u64::MAX - 8,
        u64::MAX,
    ];
    for opcode in 0..=0x10 {
        for length in lengths {
            for filler in [0x00, 0x01, 0x06, 0xFF] {
                let bytes = claiming(opcode, length, &[filler; 5000]);
                let (chunks, damage, peak) = scan(&bytes);
                // A chunk of nothing is the one thing that zeros can be.
                let empty = opcode == op::CHUNK && length == 40 && filler == 0;
                assert_eq!(chunks, usize::from(empty));
                assert!(!damage.is_empty());
                assert!(peak < 100_000, "{opcode:#04x}, {length}: {peak} bytes");
            }
        }
    }
    // Counts and string lengths within a record.
    for opcode in 0..=0x10 {
        for body in [[0xFF; 64], [0x7F; 64]] {
            let (result, peak) = peak_of(|| Record::parse(opcode, &body).map(drop));
            assert!(peak < 1000, "{opcode:#04x}: {peak} bytes, {result:?}");
        }
    }
}

#[test]
fn what_protobuf_claims_is_not_allocated() {
    for field in 1..=15_u8 {
        for wire in 0..8 {
            // A length of 2^60 and nothing behind it.
            let mut bytes = vec![field << 3 | wire];
            bytes.extend([0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x0F]);
            let (_, peak) = peak_of(|| {
                let _ = ImuBatch::decode(&bytes[..]);
                let _ = Gap::decode(&bytes[..]);
            });
            assert!(
                peak < 10_000,
                "field {field}, wire type {wire}: {peak} bytes"
            );
        }
    }
}

#[test]
fn damage_does_not_make_reading_hold_more() {
    let written = SessionByPlace::new();
    let original = written.segment();
    let (_, _, whole) = scan(&original);
    for offset in (0..original.len()).step_by(3) {
        let mut bytes = original.clone();
        bytes[offset] ^= 0xFF;
        let (_, _, peak) = scan(&bytes);
        // A window to search through, and the chunk that is found in it.
        let bound = whole + bytes.len() + (64 << 10) + 4096;
        assert!(
            peak <= bound,
            "byte {offset}: {peak} bytes, {whole} when whole"
        );
    }
}

/// Thousands of chunk headers that all look right make the search no longer than the file allows.
#[test]
fn a_search_through_false_starts_ends() {
    let mut bytes = MAGIC.to_vec();
    bytes.extend([0xAA; 100]);
    let total = 2_000_000_usize;
    while bytes.len() < total {
        // Claims everything up to the end of the file; the checksum never matches.
        let size = (total + 1000 - bytes.len() - CHUNK_PREFIX) as u64;
        bytes.push(op::CHUNK);
        bytes.extend((size + 40).to_le_bytes());
        bytes.extend([0; 16]);
        bytes.extend(size.to_le_bytes());
        bytes.extend([1, 2, 3, 4, 0, 0, 0, 0]);
        bytes.extend(size.to_le_bytes());
    }
    bytes.resize(total + 1000, 0);
    // A budget of four times the file, and not twenty thousand times.
    let (chunks, damage, _) = scan(&bytes);
    assert_eq!((chunks, damage.len()), (0, 1));
}

/// A chunk whose checksum holds over bytes that are no records: no writer of ours makes it, and
/// nothing in it is used.
#[test]
fn a_signed_chunk_of_nonsense_is_damage() {
    let written = SessionByPlace::new();
    let mut bytes = written.segment();
    let nonsense = sealed_chunk(&[0x05, 200, 0, 0, 0, 0, 0, 0, 0, 1, 2, 3]);
    let (before, _, _) = scan(&bytes);
    let mut records = RecordIter::new(&bytes[MAGIC.len()..]);
    assert!(matches!(records.next(), Some(Ok(Record::Header(_)))));
    let at = bytes.len() - records.remaining();
    bytes.splice(at..at, nonsense.iter().copied());
    let (chunks, damage, _) = scan(&bytes);
    assert_eq!(chunks, before);
    assert_eq!(damage[0].bytes, at as u64..(at + nonsense.len()) as u64);
}
