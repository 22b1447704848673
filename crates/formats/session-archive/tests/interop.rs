//! Our sessions through readers that are not ours: the official Python packages, by way of
//! `interop_check.py`, and the `mcap` crate.
//!
//! The Python part needs an interpreter with the packages, named by PAWS_PYTHON (`cargo xtask test`
//! sets one up), and is skipped without.

mod support;

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use serde_json::{Value, json};
use session_archive::layout;
use session_archive::manifest::Manifest;
use session_archive::reader::{Message, SessionReader};
use session_archive::record::{
    CameraCalibration, ClockMap, CompressedVideo, Event, Frame, FrameSet, FrameTransform,
    FrameTransforms, Gap, Health, ImuBatch, Quaternion, Vector3, paws, timestamp,
};
use session_archive::storage::DiskStorage;
use session_archive::time::HostTime;
use session_archive::writer::{LIBRARY, PROFILE, SessionWriter};
use support::{MS, START, messages, put, samples_at, spec, stop};

/// A session of two segments on a disk, with a message in every kind of stream.
fn record(folder: &Path) -> SessionReader {
    let storage = Arc::new(DiskStorage::new(folder));
    let mut writer = SessionWriter::create(storage.clone(), spec()).expect("create");
    let at = START;
    let calibration = CameraCalibration {
        timestamp: Some(timestamp(at)),
        frame_id: "feet/left".to_owned(),
        width: 32,
        height: 24,
        distortion_model: "plumb_bob".to_owned(),
        d: vec![0.1, -0.2, 1e-17, 0.1 + 0.2, 0.0],
        k: vec![500.25, 0.0, 16.0, 0.0, 500.75, 12.0, 0.0, 0.0, 1.0],
        ..CameraCalibration::default()
    };
    let transforms = FrameTransforms {
        transforms: vec![FrameTransform {
            timestamp: Some(timestamp(at)),
            parent_frame_id: "rig".to_owned(),
            child_frame_id: "feet/left".to_owned(),
            translation: Some(Vector3 {
                x: 0.1,
                y: -0.05,
                z: 0.0,
            }),
            rotation: Some(Quaternion {
                x: 0.5,
                y: -0.5,
                z: 0.5,
                w: -0.5,
            }),
        }],
    };
    writer
        .append("feet/left", at, at, &calibration)
        .expect("calibration");
    writer.append("", at, at, &transforms).expect("transforms");
    for sample in samples_at([250 * MS, 500 * MS], 64.0) {
        put(&mut writer, &sample, 300).expect("put");
        if sample.time() == START + 20_000 * MS {
            let at = sample.time();
            let map = ClockMap {
                clock: "feet".to_owned(),
                version: 2,
                tick_num: 78_125,
                tick_den: 2,
                model: paws::clock_map::Model::Affine.into(),
                pieces: vec![paws::clock_map::Piece {
                    ticks_from: -5,
                    ticks_ref: i64::MAX,
                    host_ref: i64::MIN,
                    rate_ppb: -1234.5678,
                    sigma_ns: u64::MAX,
                    ..Default::default()
                }],
                latency_ns: -1,
                ..ClockMap::default()
            };
            let set = FrameSet {
                number: 7,
                time: at.0,
                members: vec![paws::frame_set::Member {
                    camera: "feet".to_owned(),
                    number: 1,
                    time: at.0,
                }],
                missing: vec!["left_shoulder".to_owned()],
            };
            let gap = Gap {
                stream: "feet".to_owned(),
                first: 1,
                last: 3,
                cause: paws::gap::Cause::Disconnected.into(),
                time_before: Some(0),
                time_after: Some(-1),
                detail: "ümläut".to_owned(),
            };
            let health = Health {
                streams: vec![paws::health::Stream {
                    name: "feet".to_owned(),
                    rate_hz: 19.999,
                    silent: true,
                    ..Default::default()
                }],
                temperature_c: Some(0.0),
                ..Health::default()
            };
            writer.append("feet", at, at + 1, &map).expect("map");
            writer.append("", at, at + 2, &set).expect("set");
            writer.append("", at, at + 3, &gap).expect("gap");
            writer.append("", at, at + 4, &health).expect("health");
        }
    }
    let manifest = writer.close(stop(START)).expect("close");
    assert_eq!(manifest.segments.len(), 2);
    SessionReader::open(storage).expect("open")
}

/// The fields of a message as protobuf's JSON has them: 64-bit integers are strings, enumerators
/// their names.
fn fields(manifest: &Manifest, m: &Message) -> Value {
    fn long(n: impl ToString) -> Value {
        n.to_string().into()
    }
    fn longs(all: &[i64]) -> Value {
        all.iter().map(long).collect()
    }
    // The instant of all time stamps in these messages but the video's.
    let stamp = "1970-01-01T01:23:20Z";
    let schema = &manifest.streams[usize::from(m.stream) - 1].schema;
    match schema.as_str() {
        "foxglove.CompressedVideo" => {
            let v: CompressedVideo = m.decode().expect("video");
            assert_eq!(v.timestamp, Some(timestamp(m.time)));
            json!({ "timestamp": m.time.0, "frame_id": v.frame_id, "format": v.format,
                "bytes": v.data.len(), "crc32": crc32fast::hash(&v.data) })
        }
        "paws.Frame" => {
            let f: Frame = m.decode().expect("frame");
            json!({ "number": long(f.number), "device_ticks": long(f.device_ticks),
                "host_time": long(f.host_time), "time": long(f.time), "sigma_ns": long(f.sigma_ns),
                "payload_crc32": f.payload_crc32, "payload_bytes": f.payload_bytes,
                "key_frame": f.key_frame, "clock_map": f.clock_map })
        }
        "paws.ImuBatch" => {
            let b: ImuBatch = m.decode().expect("batch");
            json!({ "first_number": long(b.first_number), "device_ticks": longs(&b.device_ticks),
                "host_times": longs(&b.host_times), "times": longs(&b.times),
                "sigma_ns": long(b.sigma_ns), "clock_map": b.clock_map,
                "gyro_counts": b.gyro_counts, "gyro_scale": b.gyro_scale,
                "accel_counts": b.accel_counts, "accel_scale": b.accel_scale })
        }
        "paws.ClockMap" => {
            let c: ClockMap = m.decode().expect("map");
            let piece = |p: &paws::clock_map::Piece| {
                json!({ "ticks_from": long(p.ticks_from), "ticks_ref": long(p.ticks_ref),
                    "host_ref": long(p.host_ref), "rate_ppb": p.rate_ppb,
                    "sigma_ns": long(p.sigma_ns) })
            };
            json!({ "clock": c.clock, "version": c.version, "tick_num": c.tick_num,
                "tick_den": c.tick_den, "model": c.model().as_str_name(),
                "latency_ns": long(c.latency_ns),
                "pieces": c.pieces.iter().map(piece).collect::<Value>() })
        }
        "paws.FrameSet" => {
            let s: FrameSet = m.decode().expect("set");
            let member = |m: &paws::frame_set::Member| json!({ "camera": m.camera, "number": long(m.number), "time": long(m.time) });
            json!({ "number": long(s.number), "time": long(s.time), "missing": s.missing,
                "members": s.members.iter().map(member).collect::<Value>() })
        }
        "paws.Gap" => {
            let g: Gap = m.decode().expect("gap");
            json!({ "stream": g.stream, "first": long(g.first), "last": long(g.last),
                "cause": g.cause().as_str_name(), "time_before": g.time_before.map(long),
                "time_after": g.time_after.map(long), "detail": g.detail })
        }
        "paws.Event" => {
            let e: Event = m.decode().expect("event");
            json!({ "kind": e.kind().as_str_name(), "source": e.source, "text": e.text })
        }
        "paws.Health" => {
            let h: Health = m.decode().expect("health");
            let stream = |s: &paws::health::Stream| json!({ "name": s.name, "rate_hz": s.rate_hz, "silent": s.silent });
            json!({ "streams": h.streams.iter().map(stream).collect::<Value>(),
                "temperature_c": h.temperature_c })
        }
        "foxglove.CameraCalibration" => {
            let c: CameraCalibration = m.decode().expect("calibration");
            json!({ "timestamp": stamp, "frame_id": c.frame_id, "width": c.width,
                "height": c.height, "distortion_model": c.distortion_model, "D": c.d, "K": c.k })
        }
        "foxglove.FrameTransforms" => {
            let t: FrameTransforms = m.decode().expect("transforms");
            let one = |t: &FrameTransform| {
                let (p, q) = (
                    t.translation.expect("translation"),
                    t.rotation.expect("rotation"),
                );
                json!({ "timestamp": stamp, "parent_frame_id": t.parent_frame_id,
                    "child_frame_id": t.child_frame_id,
                    "translation": { "x": p.x, "y": p.y, "z": p.z },
                    "rotation": { "x": q.x, "y": q.y, "z": q.z, "w": q.w } })
            };
            json!({ "transforms": t.transforms.iter().map(one).collect::<Value>() })
        }
        other => panic!("{other}"),
    }
}

/// Leaves out what protobuf does not tell from absent: fields at their default.
fn without_defaults(value: Value) -> Option<Value> {
    match value {
        Value::Object(map) => Some(
            map.into_iter()
                .filter_map(|(k, v)| {
                    let is_optional = k.starts_with("time_") || k == "temperature_c";
                    let keep = is_optional && !v.is_null();
                    let v = if keep { Some(v) } else { without_defaults(v) };
                    v.map(|v| (k, v))
                })
                .collect::<serde_json::Map<_, _>>()
                .into(),
        ),
        Value::Array(all) if all.is_empty() => None,
        Value::Array(all) => Some(
            all.into_iter()
                .map(|v| {
                    if v.is_object() {
                        without_defaults(v)
                    } else {
                        Some(v)
                    }
                })
                .collect::<Option<_>>()?,
        ),
        v if v.is_null() || v == "" || v == "0" || v == false || v.as_f64() == Some(0.0) => None,
        v => Some(v),
    }
}

#[test]
fn the_official_python_packages_read_what_was_written() {
    let Some(python) = std::env::var_os("PAWS_PYTHON") else {
        eprintln!("skipped: PAWS_PYTHON names no interpreter with the mcap packages");
        return;
    };
    let folder = tempfile::tempdir().expect("folder");
    let reader = record(folder.path());
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/interop_check.py");
    let output = Command::new(python)
        .arg(script)
        .arg(folder.path())
        .output()
        .expect("start the interpreter");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{errors}");
    let found: Value = serde_json::from_slice(&output.stdout).expect("JSON");

    let manifest = reader.manifest();
    assert_eq!(found["segments"], manifest.segments.len());
    let files = found["files"].as_array().expect("files");
    for (file, entry) in files.iter().zip(&manifest.segments) {
        for count in ["messages", "messages_by_index", "messages_by_statistics"] {
            assert_eq!(file[count], entry.messages, "{count}");
        }
        assert_eq!(file["profile"], PROFILE);
        assert_eq!(file["library"], LIBRARY);
    }

    let mut expected: BTreeMap<&str, Vec<Message>> = BTreeMap::new();
    for m in messages(&reader) {
        let topic = &manifest.streams[usize::from(m.stream) - 1].topic;
        expected.entry(topic).or_default().push(m);
    }
    let topics = found["topics"].as_object().expect("topics");
    assert_eq!(expected.len() + 1, topics.len(), "and /segment");
    for (name, expected) in expected {
        let topic = &topics[name];
        let listed = manifest.streams.iter().find(|s| s.topic == name);
        let listed = listed.expect("stream");
        assert_eq!(topic["schema"], listed.schema);
        assert_eq!(topic["of"], listed.of);
        let all = |of: fn(&Message) -> Value| expected.iter().map(of).collect::<Value>();
        assert_eq!(topic["log_times"], all(|m| m.time.0.into()), "{name}");
        assert_eq!(
            topic["publish_times"],
            all(|m| m.published.0.into()),
            "{name}"
        );
        assert_eq!(topic["sequences"], all(|m| m.sequence.into()), "{name}");
        let theirs = topic["messages"].as_array().expect("messages");
        for (theirs, ours) in theirs.iter().zip(&expected) {
            let mut theirs = theirs.clone();
            theirs.as_object_mut().expect("an object").remove("sha256");
            let ours = without_defaults(fields(manifest, ours)).expect("an object");
            assert_eq!(theirs, ours, "{name}");
        }
    }
    let heads = topics["/segment"]["messages"].as_array().expect("heads");
    assert_eq!(heads.len(), manifest.segments.len());
    for (head, number) in heads.iter().zip(0_u64..) {
        assert_eq!(head["session_id"], manifest.session_id.as_str());
        assert_eq!(head["number"].as_u64().unwrap_or(0), number);
        let identity = head["manifest"].as_str().expect("manifest");
        let identity = Manifest::from_identity(identity).expect("identity");
        assert_eq!(identity.streams, manifest.streams);
    }
}

/// Reads a file through the crate's streaming reader with every checksum checked; counts messages.
fn count_streaming(file: &[u8]) -> u64 {
    let options = LinearReaderOptions::default()
        .with_validate_chunk_crcs(true)
        .with_validate_data_section_crc(true)
        .with_validate_summary_section_crc(true);
    let mut reader = LinearReader::new_with_options(options);
    let (mut left, mut messages) = (file, 0);
    while let Some(event) = reader.next_event() {
        match event.expect("a valid file") {
            LinearReadEvent::ReadRequest(n) => {
                let n = n.min(left.len());
                reader.insert(n).copy_from_slice(&left[..n]);
                reader.notify_read(n);
                left = &left[n..];
            }
            LinearReadEvent::Record { opcode, .. } => {
                messages += u64::from(opcode == mcap::records::op::MESSAGE);
            }
        }
    }
    messages
}

#[test]
fn the_mcap_crate_reads_what_was_written() {
    let folder = tempfile::tempdir().expect("folder");
    let reader = record(folder.path());
    let ours = messages(&reader);
    let mut found = Vec::new();
    for entry in &reader.manifest().segments {
        let path = folder.path().join(layout::segment(entry.number));
        let file = std::fs::read(path).expect("read");
        assert_eq!(file.len() as u64, entry.bytes);
        assert_eq!(count_streaming(&file), entry.messages);

        let summary = mcap::Summary::read(&file)
            .expect("summary")
            .expect("summary");
        let statistics = summary.stats.as_ref().expect("statistics");
        assert_eq!(statistics.message_count, entry.messages);
        assert_eq!(
            statistics.message_start_time as i64,
            entry.start.expect("start").0
        );
        assert_eq!(
            statistics.message_end_time as i64,
            entry.end.expect("end").0
        );
        assert_eq!(summary.channels.len(), reader.manifest().streams.len());
        let mut indexed = 0;
        for chunk in &summary.chunk_indexes {
            let indexes = summary.read_message_indexes(&file, chunk).expect("indexes");
            for (channel, entries) in indexes {
                for entry in &entries {
                    let m = summary.seek_message(&file, chunk, entry).expect("message");
                    assert_eq!((m.channel.id, m.log_time), (channel.id, entry.log_time));
                }
                indexed += entries.len() as u64;
            }
        }
        assert_eq!(indexed, entry.messages);

        let head = if entry.number == 0 { 1 } else { 1 + 3 };
        for m in mcap::MessageStream::new(&file).expect("stream").skip(head) {
            let m = m.expect("message");
            let schema = m.channel.schema.as_ref().expect("schema");
            let stream = reader.stream(m.channel.id).expect("stream");
            assert_eq!(
                (&schema.name, &schema.encoding[..], &m.channel.topic),
                (&stream.schema, "protobuf", &stream.topic)
            );
            found.push((
                m.channel.id,
                m.sequence,
                HostTime(m.log_time as i64),
                HostTime(m.publish_time as i64),
                m.data.to_vec(),
            ));
        }
    }
    assert_eq!(found.len(), ours.len());
    for (theirs, m) in found.iter().zip(&ours) {
        let ours = (m.stream, m.sequence, m.time, m.published, m.data.to_vec());
        assert_eq!(*theirs, ours);
    }
}
