//! Readers that are not ours open our sessions: the official Python packages (through the
//! interpreter that `PAWS_PYTHON` names; `cargo xtask test` makes one) and the `mcap` crate.

mod support;

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use serde_json::Value;
use session_archive::layout;
use session_archive::reader::{Entry, SessionReader};
use session_archive::storage::{DiskStorage, FaultStorage};
use support::{MS, START, Sample, record, samples, unit};

/// What the Python packages see of a session, or nothing where there is no Python.
fn seen_by_python(session: &Path) -> Option<Value> {
    let Some(python) = std::env::var_os("PAWS_PYTHON") else {
        eprintln!("skipped: PAWS_PYTHON names no interpreter with the mcap packages");
        return None;
    };
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/interop_check.py");
    let output = Command::new(python)
        .arg(script)
        .arg(session)
        .output()
        .expect("start python");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "the Python reader says: {errors}");
    Some(serde_json::from_slice(&output.stdout).expect("JSON"))
}

#[test]
fn the_official_python_packages_read_what_was_written() {
    let folder = tempfile::tempdir().expect("tempdir");
    let samples = samples(3.0);
    record(Arc::new(DiskStorage::new(folder.path())), &samples, 400).expect("record");
    let Some(seen) = seen_by_python(folder.path()) else {
        return;
    };
    assert_eq!(seen["segments"], 1);
    let topic = |name: &str| &seen["topics"][name];
    for (camera, name) in ["left_shoulder", "feet"].iter().enumerate() {
        let expected: Vec<_> = samples
            .iter()
            .filter_map(|s| match s {
                Sample::Frame {
                    camera: c,
                    number,
                    time,
                    ..
                } if *c == camera => Some((*number, *time)),
                _ => None,
            })
            .collect();
        let video = topic(&format!("/{name}/video"));
        let frames = topic(&format!("/{name}/frames"));
        assert_eq!(video["schema"], "foxglove.CompressedVideo");
        assert_eq!(frames["schema"], "paws.Frame");
        let times: Vec<i64> = serde_json::from_value(video["log_times"].clone()).expect("times");
        assert_eq!(times, expected.iter().map(|(_, t)| t.0).collect::<Vec<_>>());
        for (i, (number, time)) in expected.iter().enumerate() {
            let (v, f) = (&video["messages"][i], &frames["messages"][i]);
            let payload = unit(camera as u64, *number, 400);
            assert_eq!(v["timestamp"], time.0);
            assert_eq!(v["bytes"], payload.len());
            assert_eq!(v["frame_id"], format!("{name}/left"));
            // 64-bit integers are strings in protobuf's JSON.
            assert_eq!(f["number"], number.to_string());
            assert_eq!(f["time"], time.0.to_string());
            assert_eq!(f["payload_crc32"], crc32fast::hash(&payload));
        }
    }
    let imu = &topic("/feet/imu/samples")["messages"];
    assert_eq!(imu.as_array().map(Vec::len), Some(30));
    assert_eq!(imu[3]["first_number"], "60");
    assert_eq!(imu[3]["gyro_counts"][59], 52);
    assert_eq!(imu[3]["times"][1], (START.0 + 305 * MS).to_string());
    assert_eq!(topic("/events")["messages"][0]["kind"], "KIND_MARK");
    assert_eq!(topic("/segment")["messages"][0]["format_version"], 1);
}

/// The crate's own reader, with its checksum validation on, sees the messages that ours sees.
#[test]
fn the_mcap_crate_reads_what_we_read() {
    let disk = FaultStorage::new();
    record(Arc::new(disk.clone()), &samples(3.0), 400).expect("record");
    let bytes = disk.content(&layout::segment(0)).expect("segment");
    let options = mcap::read::Options::ValidateChunkCrcs.into();
    let stream = mcap::MessageStream::new_with_options(&bytes, options).expect("open");
    let theirs: Vec<_> = stream
        .map(|m| {
            let m = m.expect("message");
            (
                m.channel.topic.clone(),
                m.sequence,
                m.log_time,
                m.data.to_vec(),
            )
        })
        .collect();
    let reader = SessionReader::open(Arc::new(disk)).expect("open");
    let topics: BTreeMap<u16, String> = reader
        .manifest()
        .streams
        .iter()
        .map(|s| (s.id, s.topic.clone()))
        .collect();
    let ours: Vec<_> = reader
        .entries()
        .filter_map(|e| match e.expect("read") {
            Entry::Message(m) => Some((
                topics[&m.stream].clone(),
                m.sequence,
                m.time.0 as u64,
                m.data.to_vec(),
            )),
            _ => None,
        })
        .collect();
    assert_eq!(theirs.len(), ours.len());
    assert!(theirs == ours);
    let summary = mcap::Summary::read(&bytes)
        .expect("summary")
        .expect("there is one");
    let stats = summary.stats.expect("statistics");
    assert_eq!(stats.message_count, ours.len() as u64);
    assert_eq!(stats.channel_count as usize, topics.len());
    assert_eq!(summary.chunk_indexes.len(), stats.chunk_count as usize);
}
