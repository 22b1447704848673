//! A session of format version 1, written once and checked in, remains readable for ever, also when
//! it is damaged. Never write `fixtures/v1` again: a new version of the format gets a folder of its
//! own (`examples/write_fixture.rs` wrote it).

use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

use session_archive::layout;
use session_archive::manifest::State;
use session_archive::mcap::{MAGIC, Record, RecordIter};
use session_archive::reader::{Entry, SessionReader};
use session_archive::storage::{FaultStorage, Storage};
use session_archive::verify::{Report, verify};

/// The fixture on a disk in memory.
fn fixture() -> FaultStorage {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/v1");
    let disk = FaultStorage::new();
    for path in [
        layout::MANIFEST.to_owned(),
        layout::segment(0),
        layout::rig_file("rig.toml"),
    ] {
        disk.set_content(
            &path,
            std::fs::read(folder.join(&path)).expect("the fixture"),
        );
    }
    disk
}

fn open(disk: &FaultStorage) -> SessionReader {
    SessionReader::open(Arc::new(disk.clone()) as Arc<dyn Storage>).expect("open")
}

fn checked(disk: &FaultStorage) -> Report {
    verify(&open(disk), |_| {}).expect("verify")
}

/// Messages per topic, and a hash over all of them in the order read.
fn content(disk: &FaultStorage) -> (BTreeMap<String, usize>, String) {
    let reader = open(disk);
    let mut counts = BTreeMap::new();
    let mut hasher = blake3::Hasher::new();
    for entry in reader.entries() {
        if let Entry::Message(m) = entry.expect("read") {
            let topic = reader.stream(m.stream).expect("stream").topic.clone();
            hasher.update(topic.as_bytes());
            hasher.update(&m.time.0.to_le_bytes());
            hasher.update(&m.sequence.to_le_bytes());
            hasher.update(&m.data);
            *counts.entry(topic).or_default() += 1;
        }
    }
    (counts, hasher.finalize().to_hex().to_string())
}

/// A byte in the middle of the last chunk: the head and one chunk stand before it.
fn middle_of_last_chunk(segment: &[u8]) -> usize {
    let body = &segment[MAGIC.len()..segment.len() - MAGIC.len()];
    let mut records = RecordIter::new(body);
    let mut middle = 0;
    loop {
        let start = body.len() - records.remaining();
        match records.next() {
            Some(Ok(Record::Chunk(_))) => {
                let end = body.len() - records.remaining();
                middle = MAGIC.len() + (start + end) / 2;
            }
            Some(Ok(_)) => {}
            _ => return middle,
        }
    }
}

#[test]
fn the_session_reads_as_it_did_when_it_was_written() {
    let disk = fixture();
    let reader = open(&disk);
    let manifest = reader.manifest();
    assert_eq!(reader.manifest_note(), None);
    assert_eq!(
        (manifest.format_version, manifest.state),
        (1, State::Closed)
    );
    assert_eq!(manifest.session_id, "0192aa00-0000-7000-8000-000000000001");
    assert_eq!(manifest.cameras.len(), 2);
    assert!(checked(&disk).is_sound());
    let (counts, hash) = content(&disk);
    let expected = [
        ("/events", 1),
        ("/feet/frames", 20),
        ("/feet/imu/samples", 10),
        ("/feet/video", 20),
        ("/left_shoulder/frames", 31),
        ("/left_shoulder/video", 31),
        ("/segment", 1),
    ];
    assert_eq!(
        counts,
        BTreeMap::from(expected.map(|(topic, n)| (topic.to_owned(), n)))
    );
    assert_eq!(
        hash,
        "91a924cc2a7420e22324f75c77cdfd5c7d74faa3236347c67c11f47cb8042b03"
    );
}

#[test]
fn without_its_manifest_it_reads_the_same() {
    let disk = fixture();
    let whole = content(&disk);
    disk.remove(layout::MANIFEST).expect("remove");
    assert!(open(&disk).manifest_note().is_some());
    assert_eq!(content(&disk), whole);
}

#[test]
fn cut_off_it_reads_up_to_its_last_whole_chunk() {
    let disk = fixture();
    let mut segment = disk.content(&layout::segment(0)).expect("segment");
    segment.truncate(middle_of_last_chunk(&segment));
    disk.set_content(&layout::segment(0), segment);
    let report = checked(&disk);
    assert!(!report.is_sound() && !report.damage.is_empty());
    assert_eq!(
        report.streams["left_shoulder"].samples, 16,
        "frames 0 to 15 are before 0.5 s"
    );
    assert_eq!(report.streams["feet"].samples, 10);
}

#[test]
fn with_a_flipped_bit_it_loses_one_chunk_and_says_so() {
    let disk = fixture();
    let mut segment = disk.content(&layout::segment(0)).expect("segment");
    let at = middle_of_last_chunk(&segment);
    segment[at] ^= 0x10;
    disk.set_content(&layout::segment(0), segment);
    let report = checked(&disk);
    assert!(!report.is_sound());
    assert_eq!(
        report
            .damage
            .iter()
            .filter(|d| d.damage.bytes.contains(&(at as u64)))
            .count(),
        1
    );
    assert_eq!(report.streams["left_shoulder"].samples, 16);
}
