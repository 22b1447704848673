//! What is written is what is read, and what the format promises about its shape holds.

mod support;

use std::sync::Arc;

use session_archive::layout;
use session_archive::manifest::State;
use session_archive::mcap::{Record, RecordIter};
use session_archive::reader::{Entry, SessionReader};
use session_archive::record::{
    ClockMap, CompressedVideo, Frame, ImuBatch, Protobuf, Record as _, timestamp,
};
use session_archive::scan::End;
use session_archive::storage::{CrashKind, DiskStorage, FaultStorage, Storage};
use session_archive::time::HostTime;
use session_archive::verify::verify;
use session_archive::writer::{
    MAX_CHUNK_BYTES, MAX_CHUNK_NS, MAX_SEGMENT_NS, SessionWriter, WriteError,
};
use support::{MS, START, Sample, put, record, samples, spec, stop, unit};

#[test]
fn what_is_written_is_read() {
    let disk = FaultStorage::new();
    let samples = samples(3.0);
    record(Arc::new(disk.clone()), &samples, 300).expect("record");
    let reader = SessionReader::open(Arc::new(disk)).expect("open");
    assert_eq!(reader.manifest().state, State::Closed);
    assert_eq!(reader.manifest_note(), None);
    let manifest = reader.manifest();
    let video = manifest
        .stream::<CompressedVideo>("feet")
        .expect("stream")
        .id;
    let imu = manifest.stream::<ImuBatch>("feet/imu").expect("stream").id;
    let (mut frames, mut batches) = (Vec::new(), Vec::new());
    for entry in reader.entries() {
        match entry.expect("read") {
            Entry::Message(m) if m.stream == video => {
                let v: CompressedVideo = m.decode().expect("video");
                assert_eq!(
                    (v.frame_id.as_str(), v.format.as_str()),
                    ("feet/left", "h264")
                );
                assert_eq!(timestamp(m.time), v.timestamp.unwrap());
                frames.push((m.sequence, m.time, v.data));
            }
            Entry::Message(m) if m.stream == imu => {
                batches.push(m.decode::<ImuBatch>().expect("imu"));
            }
            Entry::SegmentEnd { end, .. } => assert_eq!(end, End::Clean),
            Entry::Message(_) => {}
            other => panic!("{other:?}"),
        }
    }
    let expected: Vec<_> = samples
        .iter()
        .filter_map(|s| match s {
            Sample::Frame {
                camera: 1,
                number,
                time,
                ..
            } => Some((*number as u32, *time, unit(1, *number, 300))),
            _ => None,
        })
        .collect();
    assert_eq!(frames.len(), expected.len());
    for (found, expected) in frames.iter().zip(&expected) {
        assert_eq!(
            (found.0, found.1, &found.2[..]),
            (expected.0, expected.1, &expected.2[..])
        );
    }
    assert_eq!(batches.len(), 30);
    assert_eq!(batches[3].first_number, 60);
    assert_eq!(batches[3].gyro_counts[59], 52);
}

#[test]
fn a_clean_session_verifies_as_sound() {
    let disk = FaultStorage::new();
    record(Arc::new(disk.clone()), &samples(3.0), 100).expect("record");
    let report = verify(&SessionReader::open(Arc::new(disk)).unwrap(), |_| {}).expect("verify");
    assert!(report.is_sound(), "{report:#?}");
    assert_eq!(report.streams["feet"].samples, 60);
    assert_eq!(report.streams["left_shoulder"].expected(), 91);
    assert_eq!(report.streams["feet/imu"].samples, 600);
}

/// Every chunk holds one epoch: the first frame of every camera in it is a key frame.
#[test]
fn every_chunk_starts_every_camera_with_a_key_frame() {
    let disk = FaultStorage::new();
    record(Arc::new(disk.clone()), &samples(5.0), 100).expect("record");
    let bytes = disk.content(&layout::segment(0)).expect("segment");
    let reader = SessionReader::open(Arc::new(disk.clone())).expect("open");
    let mut chunks = 0;
    for record in RecordIter::new(&bytes[8..bytes.len() - 8]) {
        let Record::Chunk(chunk) = record.expect("record") else {
            continue;
        };
        assert!(chunk.verify());
        let mut seen = std::collections::BTreeSet::new();
        let span = chunk.message_end_time - chunk.message_start_time;
        assert!(span <= 600 * MS as u64, "{span}");
        for record in chunk.iter() {
            let Record::Message(m) = record.expect("record") else {
                continue;
            };
            let stream = reader.stream(m.channel_id).expect("stream");
            if stream.schema == Frame::SCHEMA.name && seen.insert(stream.of.clone()) {
                let frame = Frame::decode(m.data).expect("frame");
                assert!(frame.key_frame, "chunk {chunks}, {}", stream.of);
            }
        }
        chunks += 1;
    }
    assert_eq!(chunks, 1 + 10, "the head and one chunk per half second");
}

#[test]
fn durability_is_named_and_never_ahead_of_the_disk() {
    let disk = FaultStorage::new();
    let mut writer = SessionWriter::create(Arc::new(disk.clone()), spec()).expect("create");
    let mut last = 0;
    let samples = samples(4.0);
    for sample in &samples {
        put(&mut writer, sample, 50).expect("put");
        let durable = writer.durability();
        if durable.chunks == last {
            continue;
        }
        last = durable.chunks;
        let image = disk.crash(CrashKind::UnsyncedDropped);
        let reader = SessionReader::open(Arc::new(image)).expect("open");
        let found = reader
            .entries()
            .filter(|e| matches!(e, Ok(Entry::Message(_))))
            .count() as u64;
        assert_eq!(
            found,
            durable.messages + 1,
            "all durable messages, and the head's one"
        );
        let video = reader
            .manifest()
            .stream::<CompressedVideo>("feet")
            .expect("stream")
            .id;
        let on_disk = reader
            .entries()
            .filter(|e| matches!(e, Ok(Entry::Message(m)) if m.stream == video && m.time <= durable.until))
            .count();
        let appended = samples
            .iter()
            .filter(
                |s| matches!(s, Sample::Frame { camera: 1, time, .. } if *time <= durable.until),
            )
            .count();
        assert_eq!(on_disk, appended, "until {}", durable.until);
    }
    assert!(last >= 7, "{last}");
}

#[test]
fn segments_end_after_a_minute_and_repeat_state() {
    let disk = FaultStorage::new();
    let mut writer = SessionWriter::create(Arc::new(disk.clone()), spec()).expect("create");
    let map = ClockMap {
        clock: "feet".to_owned(),
        version: 3,
        ..Default::default()
    };
    writer.append("feet", START, START, &map).expect("map");
    let samples = samples(130.0);
    for sample in &samples {
        put(&mut writer, sample, 20).expect("put");
    }
    let manifest = writer.close(stop(START + 130_000 * MS)).expect("close");
    assert_eq!(manifest.segments.len(), 3);
    for segment in &manifest.segments {
        assert!(segment.end.unwrap() - segment.start.unwrap() <= MAX_SEGMENT_NS);
    }
    let reader = SessionReader::open(Arc::new(disk.clone())).expect("open");
    let clock = reader.manifest().stream::<ClockMap>("feet").unwrap().id;
    let maps = reader
        .entries()
        .filter(|e| matches!(e, Ok(Entry::Message(m)) if m.stream == clock))
        .count();
    assert_eq!(maps, 1, "repeated state is not reported twice");
    // The last segment alone still has it.
    let alone = FaultStorage::new();
    alone.set_content(
        &layout::segment(2),
        disk.content(&layout::segment(2)).unwrap(),
    );
    let reader = SessionReader::open(Arc::new(alone)).expect("open");
    assert!(reader.manifest_note().is_some());
    assert_eq!(reader.manifest().cameras.len(), 2);
    let maps = reader
        .entries()
        .filter(|e| matches!(e, Ok(Entry::Message(m)) if m.stream == clock))
        .count();
    assert_eq!(maps, 1);
}

#[test]
fn the_same_session_gives_the_same_bytes() {
    let (a, b) = (FaultStorage::new(), FaultStorage::new());
    record(Arc::new(a.clone()), &samples(2.0), 100).expect("record");
    record(Arc::new(b.clone()), &samples(2.0), 100).expect("record");
    for path in a.paths() {
        assert_eq!(a.content(&path), b.content(&path), "{path}");
    }
}

#[test]
fn a_camera_that_stops_does_not_hold_up_the_others() {
    let disk = FaultStorage::new();
    let mut writer = SessionWriter::create(Arc::new(disk.clone()), spec()).expect("create");
    for sample in samples(6.0) {
        let silent =
            matches!(sample, Sample::Frame { camera: 1, time, .. } if time > START + 1200 * MS);
        if !silent {
            put(&mut writer, &sample, 50).expect("put");
            let Sample::Frame { time, .. } = sample else {
                continue;
            };
            let waiting = time - writer.durability().until;
            assert!(waiting <= 1100 * MS, "{waiting}");
        }
    }
    writer.close(stop(START)).expect("close");
}

/// An encoder that ignores key frame requests: chunks close nevertheless, after a second.
#[test]
fn no_chunk_waits_for_a_key_frame() {
    let disk = FaultStorage::new();
    let mut writer = SessionWriter::create(Arc::new(disk.clone()), spec()).expect("create");
    for (i, mut sample) in samples(6.0).into_iter().enumerate() {
        if let Sample::Frame { key, .. } = &mut sample {
            *key &= i < 4;
        }
        put(&mut writer, &sample, 50).expect("put");
        let waiting = sample.time() - writer.durability().until;
        assert!(waiting <= MAX_CHUNK_NS, "{waiting}");
    }
    writer.close(stop(START)).expect("close");
    let report = verify(&SessionReader::open(Arc::new(disk)).unwrap(), |_| {}).expect("verify");
    assert!(report.is_sound(), "{report:#?}");
}

/// Nothing arrives any more, or only after a leap: both open chunks are closed.
#[test]
fn nothing_waits_when_time_leaps() {
    for poll in [true, false] {
        let disk = FaultStorage::new();
        let mut writer = SessionWriter::create(Arc::new(disk.clone()), spec()).expect("create");
        let samples = samples(0.7);
        // `feet` lags, so `left_shoulder` waits in the next chunk.
        let is_late = |s: &&Sample| matches!(s, Sample::Frame { camera: 1, time, .. } if *time >= START + 500 * MS);
        for sample in samples.iter().filter(|s| !is_late(s)) {
            put(&mut writer, sample, 50).expect("put");
        }
        let appended = writer.durability().messages;
        assert_eq!(appended, 0, "both chunks are open");
        let later = START + 5000 * MS;
        if poll {
            writer.poll(later).expect("poll");
        } else {
            put(&mut writer, &Sample::Mark { time: later }, 0).expect("put");
        }
        assert_eq!(writer.durability().until, later);
    }
}

#[test]
fn a_session_is_never_written_over() {
    let folder = tempfile::tempdir().expect("tempdir");
    let storage: Arc<dyn Storage> = Arc::new(DiskStorage::new(folder.path()));
    record(storage.clone(), &samples(1.0), 10).expect("record");
    assert!(SessionWriter::create(storage, spec()).is_err());
}

/// Exports name files after streams.
#[test]
fn names_that_lead_elsewhere_are_refused() {
    for name in ["..", "a/../b", "", "left_shoulder"] {
        let mut spec = spec();
        spec.cameras[1].name = name.to_owned();
        let error = SessionWriter::create(Arc::new(FaultStorage::new()), spec).err();
        assert!(
            matches!(error, Some(WriteError::Create(_))),
            "{name}: {error:?}"
        );
    }
}

#[test]
fn wrong_calls_are_refused() {
    let mut writer = SessionWriter::create(Arc::new(FaultStorage::new()), spec()).expect("create");
    assert!(put(&mut writer, &Sample::Mark { time: HostTime(-1) }, 0).is_err());
    let frame = support::frame(1, START);
    assert!(writer.append_frame("nose", frame, &[], true).is_err());
    let long = vec![0; MAX_CHUNK_BYTES + 1];
    assert!(writer.append_frame("feet", frame, &long, true).is_err());
}
