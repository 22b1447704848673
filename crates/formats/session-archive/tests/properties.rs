//! What holds for any input: reading never panics and never invents anything, and whatever is
//! written is what is read.

mod support;

use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, OnceLock};

use proptest::collection::vec;
use proptest::prelude::*;
use session_archive::layout;
use session_archive::manifest::{Imu, Manifest};
use session_archive::mcap::{ChunkBuilder, Record, RecordIter, SegmentEncoder, sealed_chunk};
use session_archive::reader::{Entry, SessionReader};
use session_archive::record::{
    ClockMap, CompressedVideo, Event, Frame, Gap, ImuBatch, Protobuf, Record as _, timestamp,
};
use session_archive::recover::recover;
use session_archive::scan::{End, Item, Scan};
use session_archive::storage::FaultStorage;
use session_archive::time::HostTime;
use session_archive::verify::verify;
use session_archive::writer::{
    MAX_CHUNK_BYTES, MAX_CHUNK_NS, MAX_SEGMENT_BYTES, MAX_SEGMENT_NS, SessionWriter,
};
use support::numbers::check_numbers;
use support::{MS, START, camera, messages, record, samples, spec, stop, unit};

fn config(cases: u32) -> ProptestConfig {
    ProptestConfig {
        cases,
        failure_persistence: None,
        ..ProptestConfig::default()
    }
}

/// A scan of any bytes ends, and its ranges lie one behind the other inside the file.
fn scan(bytes: &[u8]) {
    let mut scan = Scan::new(Arc::new(bytes.to_vec()), None, 0).expect("scan");
    let mut position = 0;
    while let Some(item) = scan.next_item().expect("memory does not fail") {
        match item {
            Item::Chunk(chunk) => {
                assert!(chunk.offset >= position);
                position = chunk.offset + chunk.length;
                assert!(chunk.messages().all(|m| m.is_ok()));
            }
            Item::Damage(d) => assert!(d.bytes.start <= d.bytes.end),
        }
        assert!(position <= bytes.len() as u64);
    }
    assert!(scan.end().is_some());
}

/// Whatever is in the folder: opening, reading, verifying and recovering it ends without a panic,
/// and a copy that is called good is.
fn survive(disk: &FaultStorage) -> Option<Contents> {
    let reader = SessionReader::open(Arc::new(disk.clone())).ok()?;
    let found = messages(&reader);
    let report = verify(&reader, |_| {}).expect("memory does not fail");
    let target = FaultStorage::new();
    let recovered = recover(&reader, Arc::new(target.clone()), |_| {}).expect("recover");
    assert_eq!(recovered.source, report);
    assert_eq!(recovered.copy.lost, []);
    assert_eq!(recovered.copy.damage, []);
    let copy = SessionReader::open(Arc::new(target)).expect("open");
    check_numbers(&reader, &copy);
    Some(
        found
            .into_iter()
            .map(|m| (m.stream, m.data.to_vec()))
            .collect(),
    )
}

/// Stream and payload of every message in a session.
type Contents = BTreeSet<(u16, Vec<u8>)>;

/// A small session, and what is in it.
fn session() -> &'static (FaultStorage, Contents) {
    static SESSION: OnceLock<(FaultStorage, Contents)> = OnceLock::new();
    SESSION.get_or_init(|| {
        let disk = FaultStorage::new();
        record(Arc::new(disk.clone()), &samples(1.2), 30).expect("record");
        let whole = survive(&disk).expect("open");
        (disk, whole)
    })
}

/// One thing that happens to a file; positions are fractions of its length.
#[derive(Clone, Debug)]
enum Mutation {
    Overwrite(f64, Vec<u8>),
    Insert(f64, Vec<u8>),
    Delete(f64, usize),
    /// Bytes from the first place, once more at the second.
    Repeat(f64, usize, f64),
    Cut(f64),
    Remove,
}

impl Mutation {
    fn apply(&self, bytes: &mut Vec<u8>) {
        let n = bytes.len();
        let at = |f: f64| ((f * n as f64) as usize).min(n);
        match self {
            Self::Overwrite(f, with) => {
                for (b, w) in bytes[at(*f)..].iter_mut().zip(with) {
                    *b = *w;
                }
            }
            Self::Insert(f, with) => drop(bytes.splice(at(*f)..at(*f), with.iter().copied())),
            Self::Delete(f, count) => drop(bytes.drain(at(*f)..(at(*f) + count).min(n))),
            Self::Repeat(f, count, to) => {
                let part = bytes[at(*f)..(at(*f) + count).min(n)].to_vec();
                drop(bytes.splice(at(*to)..at(*to), part));
            }
            Self::Cut(f) => bytes.truncate(at(*f)),
            Self::Remove => {}
        }
    }
}

fn mutation() -> impl Strategy<Value = Mutation> {
    let at = || 0.0..1.0_f64;
    prop_oneof![
        4 => (at(), vec(any::<u8>(), 1..20)).prop_map(|(f, b)| Mutation::Overwrite(f, b)),
        1 => (at(), vec(Just(0_u8), 512..4097)).prop_map(|(f, b)| Mutation::Overwrite(f, b)),
        2 => (at(), vec(any::<u8>(), 1..2000)).prop_map(|(f, b)| Mutation::Insert(f, b)),
        2 => (at(), 1..6000_usize).prop_map(|(f, n)| Mutation::Delete(f, n)),
        2 => (at(), 1..20_000_usize, at()).prop_map(|(f, n, t)| Mutation::Repeat(f, n, t)),
        1 => at().prop_map(Mutation::Cut),
        1 => Just(Mutation::Remove),
    ]
}

/// Does this to the files of the session, of which the segment is most (0 to 5), and returns a
/// message that is read then and was not in it.
fn new_message(mutations: &[(usize, Mutation)]) -> Option<(u16, Vec<u8>)> {
    let (disk, whole) = session();
    let disk = disk.snapshot();
    let paths = [
        layout::segment(0),
        layout::MANIFEST.to_owned(),
        layout::rig_file("rig.toml"),
    ];
    let mut files: BTreeMap<String, Vec<u8>> = disk
        .paths()
        .into_iter()
        .map(|p| (p.clone(), disk.content(&p).expect("content")))
        .collect();
    for (which, mutation) in mutations {
        let path = &paths[which.saturating_sub(5)];
        match mutation {
            Mutation::Remove => drop(files.remove(path)),
            other => {
                if let Some(bytes) = files.get_mut(path) {
                    other.apply(bytes);
                }
            }
        }
    }
    let changed = FaultStorage::new();
    for (path, content) in files {
        changed.set_content(&path, content);
    }
    survive(&changed)?.into_iter().find(|m| !whole.contains(m))
}

/// The last of three chunks lies in front of the head once more, and the one in its place is
/// damaged in an access unit.
#[test]
fn a_damaged_chunk_of_which_a_sound_one_lies_in_front() {
    let mutations = [
        (0, Mutation::Repeat(0.374_817_308_259_318_7, 15_138, 0.0)),
        (0, Mutation::Overwrite(0.743_479_358_456_893_8, vec![0])),
    ];
    assert_eq!(new_message(&mutations), None);
}

proptest! {
    #![proptest_config(config(1000))]

    #[test]
    fn any_bytes_are_scanned(bytes in vec(any::<u8>(), 0..3000), magic: bool) {
        let mut file = if magic { session_archive::mcap::MAGIC.to_vec() } else { Vec::new() };
        file.extend(bytes);
        scan(&file);
        // A record is an opcode of a byte, a length of eight and its body; an error is the last
        // item.
        let items = RecordIter::new(&file).count();
        prop_assert!(items <= file.len() / 9 + 1, "{} items in {} bytes", items, file.len());
    }

    #[test]
    fn any_body_of_any_record_is_parsed(opcode in 0..=16_u8, body in vec(any::<u8>(), 0..300)) {
        if let Ok(record) = Record::parse(opcode, &body) {
            prop_assert_eq!(record.opcode(), opcode);
        }
    }

    #[test]
    fn any_bytes_as_a_manifest(bytes in vec(any::<u8>(), 0..500), text in ".{0,200}") {
        prop_assert!(Manifest::from_bytes(&bytes).is_err());
        prop_assert!(Manifest::from_bytes(text.as_bytes()).is_err());
        prop_assert!(Manifest::from_identity(&text).is_err());
    }

    #[test]
    fn a_manifest_is_what_was_written(
        name in ".{0,60}",
        reason in "[\"\\\\\n\r\t{}:, ]{0,30}crc32",
        rate in 0.001..1e6_f64,
        started: i64,
    ) {
        let (disk, _) = session();
        let bytes = disk.content(layout::MANIFEST).expect("manifest");
        let mut manifest = Manifest::from_bytes(&bytes).expect("manifest");
        manifest.name = name;
        manifest.stopped.as_mut().expect("stopped").reason = reason;
        manifest.cameras[0].rate_hz = rate;
        manifest.started = HostTime(started);
        prop_assert_eq!(Manifest::from_bytes(&manifest.to_bytes()).expect("read"), manifest);
    }

    /// Whatever is done to the files of a session, nothing is returned that was not in it.
    #[test]
    fn a_mutated_session_returns_nothing_new(
        mutations in vec((0..8_usize, mutation()), 1..5),
    ) {
        prop_assert_eq!(new_message(&mutations), None);
    }

    #[test]
    fn a_chunk_sealed_again_is_the_same(
        contents in vec((1..9_u16, any::<u32>(), any::<u64>(), vec(any::<u8>(), 0..200)), 0..40),
    ) {
        let mut builder = ChunkBuilder::default();
        for (channel, sequence, time, data) in &contents {
            builder.message(*channel, *sequence, *time, *time / 2, |out| out.extend(data));
        }
        prop_assert_eq!(builder.messages(), contents.len() as u64);
        prop_assert_eq!(builder.start_time(), contents.iter().map(|c| c.2).min());
        let bytes = builder.finish();
        prop_assert!(builder.is_empty());

        let Ok((Record::Chunk(chunk), indexes)) = Record::split(&bytes) else {
            panic!("no chunk");
        };
        prop_assert!(chunk.verify());
        prop_assert_eq!(sealed_chunk(chunk.records), bytes.clone());
        let found: Vec<_> = chunk.messages().map(|m| m.expect("message")).collect();
        for (m, (channel, sequence, time, data)) in found.iter().zip(&contents) {
            prop_assert_eq!(
                (m.channel_id, m.sequence, m.log_time, m.publish_time, m.data),
                (*channel, *sequence, *time, *time / 2, &data[..])
            );
        }
        // Every index entry leads to its message.
        let mut indexed = 0;
        for record in RecordIter::new(indexes) {
            let Record::MessageIndex(index) = record.expect("record") else {
                panic!("no message index");
            };
            for (time, offset) in index.records {
                let Ok((Record::Message(m), _)) = Record::split(&chunk.records[offset as usize..])
                else {
                    panic!("no message");
                };
                prop_assert_eq!((m.channel_id, m.log_time), (index.channel_id, time));
                indexed += 1;
            }
        }
        prop_assert_eq!(indexed, contents.len());
    }

    /// The summary is made from the chunks alone, and says where they are.
    #[test]
    fn a_segment_ends_with_what_is_in_it(
        chunks in vec(vec((1..5_u16, 0..1_000_000_u64), 1..10), 0..8),
    ) {
        let (mut encoder, mut file) = SegmentEncoder::start("p", "l");
        let mut starts = Vec::new();
        for chunk in &chunks {
            let mut builder = ChunkBuilder::default();
            for (channel, time) in chunk {
                builder.message(*channel, 0, *time, *time, |_| {});
            }
            let bytes = builder.finish();
            starts.push(file.len() as u64);
            encoder.chunk(&bytes).expect("chunk");
            file.extend(bytes);
            prop_assert_eq!(encoder.position(), file.len() as u64);
        }
        prop_assert_eq!(encoder.chunk_count(), chunks.len());
        file.extend(encoder.finish());
        scan(&file);
        let mut indexed = Vec::new();
        let mut messages = None;
        for record in RecordIter::new(&file[8..file.len() - 8]) {
            match record.expect("record") {
                Record::ChunkIndex(index) => indexed.push(index.chunk_start_offset),
                Record::Statistics(s) => messages = Some(s.message_count),
                _ => {}
            }
        }
        prop_assert_eq!(indexed, starts);
        prop_assert_eq!(messages, Some(chunks.iter().map(|c| c.len() as u64).sum()));
    }

    #[test]
    fn frames_and_imu_batches_come_back(
        number: u64,
        times in vec(any::<i64>(), 0..30),
        counts in vec(any::<i32>(), 0..90),
        values in vec(any::<f64>(), 0..90),
        kernel: Option<i64>,
        exposure: Option<u32>,
    ) {
        let frame = Frame {
            number,
            kernel_time: kernel,
            exposure_ns: exposure,
            time: times.first().copied().unwrap_or_default(),
            payload_crc32: counts.first().copied().unwrap_or_default() as u32,
            ..Frame::default()
        };
        prop_assert_eq!(Frame::decode(&frame.encode_to_vec()[..]).expect("frame"), frame);
        let batch = ImuBatch {
            first_number: number,
            device_ticks: times.clone(),
            host_times: times.iter().map(|t| t.wrapping_mul(3)).collect(),
            times,
            gyro_counts: counts,
            accel: values,
            ..ImuBatch::default()
        };
        // Floating-point values are compared as bytes: the raw bits count.
        let bytes = batch.encode_to_vec();
        let again = ImuBatch::decode(&bytes[..]).expect("batch");
        prop_assert_eq!(again.encode_to_vec(), bytes);
        prop_assert_eq!(again.times, batch.times);
        prop_assert_eq!(again.gyro_counts, batch.gyro_counts);
    }
}

/// One call to the writer.
#[derive(Clone, Debug)]
enum Call {
    /// Camera, step of the number, step of the time, key frame, bytes.
    Frame(usize, u64, i64, bool, usize),
    /// IMU, step of the number, step of the time, samples.
    Imu(usize, u64, i64, usize),
    Gap(usize, u64),
    Mark(i64),
    Clock(usize),
    Poll(i64),
}

fn call() -> impl Strategy<Value = Call> {
    // Times go back now and then, and leap once in a while.
    let step = || {
        prop_oneof![
            20 => 0..120 * MS,
            2 => -300 * MS..0,
            1 => 0..3000 * MS,
        ]
    };
    prop_oneof![
        12 => (0..3_usize, 1..3_u64, step(), any::<bool>(), 0..400_usize)
            .prop_map(|(c, n, t, k, b)| Call::Frame(c, n, t, k, b)),
        4 => (0..2_usize, 1..3_u64, step(), 1..30_usize)
            .prop_map(|(i, n, t, s)| Call::Imu(i, n, t, s)),
        1 => (0..3_usize, 1..5_u64).prop_map(|(c, n)| Call::Gap(c, n)),
        1 => step().prop_map(Call::Mark),
        1 => (0..3_usize).prop_map(Call::Clock),
        1 => step().prop_map(Call::Poll),
    ]
}

/// Every segment spans a minute at most, and every chunk what [`MAX_CHUNK_NS`] says: no message in
/// it waited longer, by the times of those that were appended before its last sample. (That one
/// may leap; it is what closes the chunk.)
fn check_limits(reader: &SessionReader) {
    let span = |times: &[u64]| {
        let bounds = times.iter().max().zip(times.iter().min());
        bounds.map_or(0, |(end, start)| (end - start) as i64)
    };
    for number in reader.segment_numbers() {
        let mut scan = reader.segment(number).expect("open").scan().expect("scan");
        let mut chunks: Vec<Vec<u64>> = Vec::new();
        while let Some(item) = scan.next_item().expect("memory does not fail") {
            let Item::Chunk(chunk) = item else {
                panic!("{item:?}");
            };
            assert!(chunk.length <= 2 * MAX_CHUNK_BYTES as u64 + 4096);
            let times = chunk.messages().map(|m| m.expect("message").log_time);
            chunks.push(times.collect());
        }
        assert!(scan.position() < MAX_SEGMENT_BYTES);
        // The first is the head.
        let chunks = &chunks[1..];
        for times in chunks {
            let waited = &times[..times.len().saturating_sub(2)];
            assert!(span(waited) < MAX_CHUNK_NS, "{times:?}");
        }
        if chunks.len() > 1 {
            assert!(span(&chunks.concat()) <= MAX_SEGMENT_NS);
        }
    }
}

proptest! {
    #![proptest_config(config(400))]

    /// Any sequence of calls: each stream is read as it was written, nothing is left out, and
    /// every segment and chunk keeps the limits.
    #[test]
    fn what_is_written_is_read(
        cameras in 0..4_usize,
        imus in 0..3_usize,
        chunk_ms in 1..1200_i64,
        calls in vec(call(), 0..250),
    ) {
        let names = ["left_shoulder", "right_shoulder", "feet"];
        let mut spec = spec();
        spec.chunk_ns = chunk_ms * MS;
        spec.cameras = names[..cameras.min(3)].iter().map(|n| camera(n, 30.0)).collect();
        let imu = |name: &str| Imu { name: name.to_owned(), ..spec.imus[0].clone() };
        spec.imus = ["feet/imu", "left_shoulder/imu"][..imus.min(2)].iter().map(|n| imu(n)).collect();

        let disk = FaultStorage::new();
        let mut writer = SessionWriter::create(Arc::new(disk.clone()), spec.clone()).expect("create");
        let mut expected: BTreeMap<u16, Vec<(HostTime, Vec<u8>)>> = BTreeMap::new();
        let mut add = |writer: &SessionWriter, schema: &str, of: &str, time, data| {
            let streams = &writer.manifest().streams;
            let stream = streams.iter().find(|s| s.schema == schema && s.of == of).expect("stream");
            expected.entry(stream.id).or_default().push((time, data));
        };
        let mut now = START + 10_000 * MS;
        let mut numbers: BTreeMap<String, u64> = BTreeMap::new();
        for call in calls {
            match call {
                Call::Frame(c, n, dt, key, bytes) => {
                    let Some(name) = spec.cameras.get(c).map(|c| c.name.clone()) else { continue };
                    now = now + dt;
                    let number = numbers.entry(name.clone()).or_insert(7);
                    *number += n;
                    let data = unit(c as u64, *number, bytes);
                    let frame = Frame {
                        payload_crc32: crc32fast::hash(&data),
                        payload_bytes: data.len() as u32,
                        key_frame: key,
                        ..support::frame(*number, now)
                    };
                    let video = CompressedVideo {
                        timestamp: Some(timestamp(now)),
                        frame_id: format!("{name}/left"),
                        data: data.clone().into(),
                        format: "h264".to_owned(),
                    };
                    add(&writer, Frame::SCHEMA.name, &name, now, frame.encode_to_vec());
                    add(&writer, CompressedVideo::SCHEMA.name, &name, now, video.encode_to_vec());
                    writer
                        .append_frame(&name, support::frame(*number, now), &data, key)
                        .expect("frame");
                }
                Call::Imu(i, n, dt, samples) => {
                    let Some(name) = spec.imus.get(i).map(|i| i.name.clone()) else { continue };
                    now = now + dt;
                    let number = numbers.entry(name.clone()).or_insert(0);
                    *number += n;
                    let batch = ImuBatch {
                        first_number: *number,
                        device_ticks: vec![1; samples],
                        host_times: vec![now.0; samples],
                        times: (0..samples as i64).map(|k| now.0 + k).collect(),
                        gyro_counts: vec![-3; 3 * samples],
                        accel: vec![9.81; 3 * samples],
                        ..ImuBatch::default()
                    };
                    *number += samples as u64 - 1;
                    add(&writer, ImuBatch::SCHEMA.name, &name, now, batch.encode_to_vec());
                    writer.append(&name, now, now, &batch).expect("batch");
                }
                Call::Gap(c, n) => {
                    let Some(name) = spec.cameras.get(c).map(|c| c.name.clone()) else { continue };
                    let number = numbers.entry(name.clone()).or_insert(7);
                    let gap = Gap {
                        stream: name,
                        first: *number + 1,
                        last: *number + n,
                        ..Gap::default()
                    };
                    *number += n;
                    add(&writer, Gap::SCHEMA.name, "", now, gap.encode_to_vec());
                    writer.append("", now, now, &gap).expect("gap");
                }
                Call::Mark(dt) => {
                    now = now + dt;
                    let event = Event { text: now.to_string(), ..Event::default() };
                    add(&writer, Event::SCHEMA.name, "", now, event.encode_to_vec());
                    writer.append("", now, now, &event).expect("event");
                }
                Call::Clock(c) => {
                    let Some(name) = spec.cameras.get(c).map(|c| c.name.clone()) else { continue };
                    let map = ClockMap { clock: name.clone(), samples: now.0 as u64, ..ClockMap::default() };
                    add(&writer, ClockMap::SCHEMA.name, &name, now, map.encode_to_vec());
                    writer.append(&name, now, now, &map).expect("map");
                }
                Call::Poll(dt) => writer.poll(now + dt).expect("poll"),
            }
        }
        let appended: usize = expected.values().map(Vec::len).sum();
        let manifest = writer.close(stop(now)).expect("close");
        prop_assert_eq!(writer.durability().messages, appended as u64);
        prop_assert!(writer.take_incidents().is_empty());

        let reader = SessionReader::open(Arc::new(disk.clone())).expect("open");
        prop_assert_eq!(reader.manifest(), &manifest);
        let mut found: BTreeMap<u16, Vec<(HostTime, Vec<u8>)>> = BTreeMap::new();
        for m in messages(&reader) {
            found.entry(m.stream).or_default().push((m.time, m.data.to_vec()));
        }
        prop_assert_eq!(found, expected);
        for entry in reader.entries() {
            match entry.expect("read") {
                Entry::SegmentEnd { end, .. } => prop_assert_eq!(end, End::Clean),
                Entry::Message(_) => {}
                other => prop_assert!(false, "{:?}", other),
            }
        }
        check_limits(&reader);
        let report = verify(&reader, |_| {}).expect("verify");
        for (name, s) in &report.streams {
            prop_assert_eq!(s.samples + s.gaps + s.lost, s.expected(), "{}", name);
            prop_assert_eq!((s.repeated, s.contradicted, s.bad_payloads), (0, 0, 0), "{}", name);
        }
        prop_assert_eq!((&report.damage[..], report.undecodable), (&[][..], 0));

        // The same calls give the same bytes after recovery, which knows only the chunks.
        let target = FaultStorage::new();
        recover(&reader, Arc::new(target.clone()), |_| {}).expect("recover");
        if report.lost.is_empty() {
            for segment in reader.segment_numbers() {
                let path = layout::segment(segment);
                prop_assert!(disk.content(&path) == target.content(&path), "{}", path);
            }
        }
    }
}
