//! Sessions of the daemon in third-party readers: the official Python packages read every message,
//! and PyAV decodes the video to the same luma as our decoder, bit by bit.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use harness::contents::Contents;
use harness::rig::{Rig, in_virtual_time};
use serde_json::Value;
use session_archive::record::paws::event::Kind;

/// Hashes consecutive planes of equal length in a file.
const HASH: &str = "import hashlib, json, sys
data, size = open(sys.argv[1], 'rb').read(), int(sys.argv[2])
json.dump([hashlib.sha256(data[i:i + size]).hexdigest() for i in range(0, len(data), size)], sys.stdout)";

/// JSON output of a Python program.
fn python(interpreter: &Path, arguments: &[&str]) -> Value {
    let output = Command::new(interpreter)
        .args(arguments)
        .output()
        .expect("start python");
    let errors = String::from_utf8_lossy(&output.stderr);
    assert!(
        output.status.success(),
        "the Python reader failed: {errors}"
    );
    serde_json::from_slice(&output.stdout).expect("JSON")
}

fn check(encoder: &'static str, codec: &str) {
    let Some(interpreter) = std::env::var_os("PAWS_PYTHON").map(PathBuf::from) else {
        eprintln!("skipped: PAWS_PYTHON names no interpreter with the mcap packages");
        return;
    };
    let rig = Rig {
        width: 256,
        height: 96,
        encoder,
        ..Rig::small(2)
    };
    if let Err(reason) = video::discover::trial(encoder, rig.width, rig.height) {
        eprintln!("skipped: {encoder}: {reason}");
        return;
    }
    let folder = tempfile::tempdir().expect("folder");
    let finished = rig.record(&in_virtual_time(3.0, folder.path()));
    let session = finished.expect("recording").session;
    let ours = Contents::read(&session).expect("contents");
    let script = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../crates/formats/session-archive/tests/interop_check.py");
    let session = session.to_str().expect("a path in UTF-8");
    let script = script.to_str().expect("a path in UTF-8");
    let seen = python(&interpreter, &[script, session, "--decode"]);

    assert_eq!(seen["segments"], 1);
    let topics = seen["topics"].as_object().expect("topics");
    let list = |topic: &str, what: &str| -> Vec<Value> {
        let found = topics
            .get(topic)
            .unwrap_or_else(|| panic!("{topic} is absent"));
        found[what].as_array().expect("a list").clone()
    };
    let messages: usize = topics
        .keys()
        .map(|topic| list(topic, "messages").len())
        .sum();
    // Contents leaves out the message that identifies the segment.
    assert_eq!(messages as u64, ours.messages + 1);

    for name in rig.names() {
        let frames = &ours.frames[*name];
        assert_eq!(frames.len(), 90);
        let times: Vec<i64> = frames.iter().map(|f| f.record.time).collect();
        let (video, records) = (format!("/{name}/video"), format!("/{name}/frames"));
        for topic in [&video, &records] {
            assert_eq!(list(topic, "log_times"), times, "{topic}");
        }
        let (units, records) = (list(&video, "messages"), list(&records, "messages"));
        for ((frame, unit), theirs) in frames.iter().zip(&units).zip(&records) {
            let record = &frame.record;
            assert_eq!(unit["timestamp"], record.time);
            assert_eq!(unit["bytes"], frame.unit.len());
            assert_eq!(unit["format"], codec);
            assert_eq!(unit["frame_id"], format!("{name}/left"));
            // 64-bit integers are strings in protobuf's JSON, and zeros are left out.
            let number = theirs
                .get("number")
                .map_or("0", |n| n.as_str().expect("a string"));
            assert_eq!(number, record.number.to_string());
            assert_eq!(theirs["device_ticks"], record.device_ticks.to_string());
            assert_eq!(theirs["host_time"], record.host_time.to_string());
            assert_eq!(theirs["sigma_ns"], record.sigma_ns.to_string());
            assert_eq!(theirs["payload_crc32"], record.payload_crc32);
            assert_eq!(theirs["exposure_ns"], 4_000_000);
            assert_eq!(theirs.get("key_frame").is_some(), record.key_frame);
        }
        imu_is_the_same(
            &list(&format!("/{name}/imu/samples"), "messages"),
            &ours,
            name,
        );
        images_are_the_same(
            &interpreter,
            folder.path(),
            &seen["images"][&video],
            &ours,
            name,
        );
    }
    let events = list("/events", "messages");
    assert_eq!(events.len(), ours.events.len());
    assert_eq!(events[0]["kind"], Kind::Start.as_str_name());
    let sets = list("/frame_sets", "messages");
    assert_eq!((sets.len(), ours.sets.len()), (90, 90));
    for (theirs, set) in sets.iter().zip(&ours.sets) {
        assert_eq!(theirs["time"], set.time.to_string());
        assert_eq!(
            theirs["members"].as_array().map(Vec::len),
            Some(set.members.len())
        );
    }
}

fn imu_is_the_same(batches: &[Value], ours: &Contents, camera: &str) {
    let samples = &ours.imu[&format!("{camera}/imu")];
    let concatenated = |field: &str| -> Vec<String> {
        let values = batches
            .iter()
            .flat_map(|b| b[field].as_array().expect("a list"));
        values
            .map(|v| v.as_str().map_or_else(|| v.to_string(), str::to_owned))
            .collect()
    };
    assert_eq!(samples.len(), 600);
    let ticks: Vec<String> = samples.iter().map(|s| s.ticks.to_string()).collect();
    let times: Vec<String> = samples.iter().map(|s| s.time.0.to_string()).collect();
    assert_eq!(concatenated("device_ticks"), ticks);
    assert_eq!(concatenated("times"), times);
    let (mut gyro, mut accel) = (Vec::new(), Vec::new());
    for sample in samples {
        let capture_daemon::sources::ImuValues::Counts { gyro: g, accel: a } = sample.values else {
            panic!("the synthetic IMU delivers counts: {sample:?}");
        };
        gyro.extend(g.map(|count| count.to_string()));
        accel.extend(a.map(|count| count.to_string()));
    }
    assert_eq!(concatenated("gyro_counts"), gyro);
    assert_eq!(concatenated("accel_counts"), accel);
}

fn images_are_the_same(
    interpreter: &Path,
    folder: &Path,
    theirs: &Value,
    ours: &Contents,
    camera: &str,
) {
    let mut planes = Vec::new();
    let mut size = (0, 0);
    ours.decode(camera, |_, image| {
        size = (image.width, image.height);
        planes.extend_from_slice(image.luma()?);
        Ok(())
    })
    .expect("decoding");
    let file = folder.join("luma");
    fs::write(&file, &planes).expect("file");
    let length = (size.0 * size.1).to_string();
    let hashes = python(
        interpreter,
        &["-c", HASH, file.to_str().expect("UTF-8"), &length],
    );
    let hashes = hashes.as_array().expect("a list");
    let theirs = theirs.as_array().expect("a list");
    assert_eq!((theirs.len(), hashes.len()), (90, 90), "{camera}");
    for (i, (theirs, hash)) in theirs.iter().zip(hashes).enumerate() {
        assert_eq!(
            (&theirs["width"], &theirs["height"]),
            (&size.0.into(), &size.1.into())
        );
        assert_eq!(
            &theirs["luma_sha256"], hash,
            "{camera}: image {i} decodes to another luma"
        );
    }
}

#[test]
fn official_python_packages_read_h264_sessions() {
    check("x264enc", "h264");
}

#[test]
fn official_python_packages_read_h265_sessions() {
    check("x265enc", "h265");
}
