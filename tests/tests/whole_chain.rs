//! Synthetic cameras through the whole daemon: every loss is accounted for, every image is that of
//! its record, and the same input gives the same bytes.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use capture_daemon::run::{RecordingSummary, StopFlag, build, record_built};
use capture_daemon::sources::synthetic::{FaultPlan, read_counter};
use capture_daemon::sources::{AnySource, Source};
use harness::contents::{Contents, StoredFrame, open};
use harness::rig::{Rig, in_virtual_time};
use session_archive::record::paws::event::Kind;
use session_archive::record::paws::gap::Cause;
use session_archive::time::{HostTime, NS_PER_S};
use session_archive::verify::verify;
use session_archive::writer::MAX_CHUNK_NS;

/// Records a rig whose cameras have faults.
fn record_faulty(
    rig: &Rig,
    faults: [FaultPlan; 3],
    seconds: f64,
    out: &Path,
) -> (RecordingSummary, HostTime) {
    let config = rig.config(out).expect("configuration");
    let mut began = HostTime(0);
    let built = |start| {
        began = start;
        let mut built = build(&config, start)?;
        for (camera, faults) in faults.into_iter().enumerate() {
            let source: Box<dyn Source> = Box::new(rig.source(camera, start)?.with_faults(faults));
            built.sources[camera] = AnySource::Scheduled(source);
        }
        Ok(built)
    };
    let finished = record_built(
        built,
        &in_virtual_time(seconds, out),
        &StopFlag::new(),
        Box::new(|_| {}),
    );
    (finished.expect("recording"), began)
}

/// A kill may lose only the current chunk, including all data in front of the writer: a stage that
/// held samples back would satisfy the writer's promise and break the recorder's.
fn no_more_than_a_chunk_waits(contents: &Contents) {
    assert!(contents.health.len() >= 9, "{}", contents.health.len());
    for (time, health) in &contents.health {
        let waits = time.since(HostTime(health.durable_until));
        assert!(waits <= MAX_CHUNK_NS, "{waits} ns at {time}");
    }
}

#[test]
fn every_fault_is_accounted_for() {
    let folder = tempfile::tempdir().expect("folder");
    let rig = Rig {
        imu_rate_hz: 100.0,
        ..Rig::small(3)
    };
    let s = |seconds: f64| (seconds * NS_PER_S as f64) as i64;
    let faults = [
        FaultPlan {
            drop_frames: vec![7, 50, 51, 52, 120],
            ..FaultPlan::default()
        },
        FaultPlan {
            camera_silence: Some(s(3.0)..s(5.5)),
            imu_silence: Some(s(6.0)..s(8.0)),
            ..FaultPlan::default()
        },
        FaultPlan {
            frozen: Some(100..180),
            end_after_frames: Some(240),
            ..FaultPlan::default()
        },
    ];
    let (finished, start) = record_faulty(&rig, faults, 10.0, folder.path());
    assert_eq!(finished.error, None);
    let report = verify(&open(&finished.session).expect("open"), |_| {}).expect("verify");
    assert!(report.is_sound(), "{report:?}");
    let contents = Contents::read(&finished.session).expect("contents");

    // Missing samples, and causes.
    let device = Cause::Device as i32;
    let gaps = [
        (
            "left_shoulder",
            vec![(7, 7, device), (50, 52, device), (120, 120, device)],
            295,
        ),
        ("left_shoulder/imu", vec![], 1000),
        ("right_shoulder", vec![(90, 164, device)], 225),
        ("right_shoulder/imu", vec![(600, 799, device)], 800),
        ("feet", vec![], 240),
        ("feet/imu", vec![], 800),
    ];
    for (stream, expected, stored) in gaps {
        assert_eq!(contents.gaps_of(stream), expected, "{stream}");
        assert_eq!(
            contents.check_numbers(stream).expect("numbers"),
            stored,
            "{stream}"
        );
    }
    assert_eq!((finished.stored, finished.missing), (3360, 280));

    // Every image shows its number, except the frozen ones, which are marked.
    for name in rig.names() {
        let mut seen = 0;
        let checked = contents.decode(name, |frame, image| {
            let frozen = *name == "feet" && (100..180).contains(&frame.number);
            assert_eq!(frame.frozen, frozen, "{name} {}", frame.number);
            let expected = if frozen { 99 } else { frame.number };
            assert_eq!(
                read_counter(image),
                Some(expected),
                "{name} {}",
                frame.number
            );
            seen += 1;
            Ok(())
        });
        checked.expect("decoding");
        assert_eq!(seen, contents.frames[*name].len());
    }

    // No time error exceeds its sigma, nor, once the clocks have converged, a fifth of a
    // millisecond.
    for (camera, name) in rig.names().iter().enumerate() {
        let truth = rig.source(camera, start).expect("source");
        for StoredFrame { record, .. } in &contents.frames[*name] {
            let error = HostTime(record.time).since(truth.frame_time(record.number));
            assert!(
                error.unsigned_abs() <= record.sigma_ns,
                "{name}: {error} ns, {record:?}"
            );
            assert!(
                record.time_unreliable || error.abs() <= 200_000,
                "{name}: {error}, {record:?}"
            );
        }
    }

    contents.check_times().expect("times");
    no_more_than_a_chunk_waits(&contents);
    alarms_come_in_time(&contents, &rig, start);
    sets_are_of_stored_frames(&contents);
}

/// The alarms of the faults above, each within two periods and a second of the last good sample,
/// and no others.
fn alarms_come_in_time(contents: &Contents, rig: &Rig, start: HostTime) {
    let frame_time = |number: f64| start + (number / rig.rate_hz * 1e9) as i64;
    let sample_time = |number: f64| start + (number / rig.imu_rate_hz * 1e9) as i64;
    // Stream, last good sample, first good one after it.
    let frozen = (frame_time(99.0), Some(frame_time(180.0)));
    let expected = [
        (
            "right_shoulder",
            "no samples",
            frame_time(89.0),
            Some(frame_time(165.0)),
        ),
        ("feet", "the image is frozen", frozen.0, frozen.1),
        (
            "right_shoulder/imu",
            "no samples",
            sample_time(599.0),
            Some(sample_time(800.0)),
        ),
        ("feet", "no samples", frame_time(239.0), None),
        ("feet/imu", "no samples", sample_time(799.0), None),
    ];
    // Arrivals are up to 2 ms late.
    const LATE_NS: i64 = 2_000_000;
    let mut found = BTreeSet::new();
    for (stream, what, good, over) in expected {
        let text = format!("{stream}: {what}");
        let mut at = |kind: Kind| {
            let mut events = contents.events.iter().zip(0..).filter(|((_, event), _)| {
                event.kind == kind as i32 && event.source == stream && event.text == text
            });
            let first = events.next().map(|((at, _), position)| (*at, position));
            assert!(events.next().is_none(), "{text}: {kind:?} twice");
            found.extend(first.map(|(_, position)| position));
            first.map(|(at, _)| at)
        };
        let rate = if stream.ends_with("/imu") {
            rig.imu_rate_hz
        } else {
            rig.rate_hz
        };
        let limit = NS_PER_S + (2.0 / rate * 1e9) as i64;
        let raised = at(Kind::Fault).unwrap_or_else(|| panic!("no alarm {text:?}"));
        let after = raised.since(good);
        assert!(
            after > limit / 2 && after <= limit + LATE_NS,
            "{text}: after {after} ns, the limit is {limit}"
        );
        let cleared = at(Kind::Cleared);
        let late = cleared.zip(over).map(|(cleared, over)| cleared.since(over));
        assert_eq!(cleared.is_some(), over.is_some(), "{text}");
        assert!(
            late.is_none_or(|late| (0..=LATE_NS).contains(&late)),
            "{text}: over {late:?}"
        );
    }
    losses_are_alarms(contents);
    let others: Vec<_> = (0..contents.events.len())
        .filter(|position| !found.contains(position))
        .map(|position| &contents.events[position].1)
        .filter(|event| event.source != "losses")
        .map(|event| event.kind)
        .collect();
    assert_eq!(
        others,
        [Kind::Start as i32, Kind::Stop as i32],
        "{:?}",
        contents.events
    );
}

/// A stream with unannounced losses raised an alarm, at most two seconds after the loss was
/// noticed, and no other stream did.
fn losses_are_alarms(contents: &Contents) {
    let alarms = contents
        .events
        .iter()
        .filter(|(_, event)| event.source == "losses" && event.kind == Kind::Fault as i32);
    let mut of_stream = BTreeMap::new();
    for (at, event) in alarms {
        let (stream, _) = event
            .text
            .split_once(':')
            .expect("a stream and what is wrong");
        of_stream
            .entry(stream.to_owned())
            .or_insert_with(Vec::new)
            .push(*at);
    }
    let mut lost = BTreeSet::new();
    for gap in contents
        .gaps
        .iter()
        .filter(|gap| gap.cause() == Cause::Device)
    {
        // Losses at the end are only known when the session is closed.
        let Some(after) = gap.time_after else {
            continue;
        };
        lost.insert(gap.stream.clone());
        let alarms = &of_stream[&gap.stream];
        let is_said = |at: &HostTime| at.0 <= after + 2 * NS_PER_S;
        assert!(alarms.iter().any(is_said), "{gap:?}: {alarms:?}");
    }
    assert_eq!(of_stream.into_keys().collect::<BTreeSet<_>>(), lost);
}

/// Each set's frames are in the session with the stated time, each frame is in at most one set, and
/// a camera is either in a set or listed as missing.
fn sets_are_of_stored_frames(contents: &Contents) {
    let stored: BTreeMap<(&str, u64), i64> = contents
        .frames
        .iter()
        .flat_map(|(name, frames)| {
            frames
                .iter()
                .map(|f| ((name.as_str(), f.record.number), f.record.time))
        })
        .collect();
    let mut used = BTreeSet::new();
    let mut without = BTreeMap::new();
    for (set, number) in contents.sets.iter().zip(0..) {
        assert_eq!(set.number, number);
        for member in &set.members {
            let key = (member.camera.as_str(), member.number);
            assert_eq!(stored.get(&key), Some(&member.time), "{key:?}");
            assert!(used.insert(key), "{key:?} is in two sets");
        }
        let members = set.members.iter().map(|m| &m.camera);
        let cameras: BTreeSet<&String> = members.chain(&set.missing).collect();
        assert_eq!(cameras.len(), 3, "{set:?}");
        assert_eq!(set.members.len() + set.missing.len(), 3, "{set:?}");
        for camera in &set.missing {
            *without.entry(camera.as_str()).or_insert(0) += 1;
        }
    }
    // Every instant at which any camera has a frame, and the cameras without one.
    assert_eq!(contents.sets.len(), 300);
    let expected = [("left_shoulder", 5), ("right_shoulder", 75), ("feet", 60)];
    assert_eq!(without, BTreeMap::from(expected));
}

#[test]
fn same_input_gives_the_same_bytes() {
    let folder = tempfile::tempdir().expect("folder");
    let rig = Rig::small(3);
    let run = |out: &str| {
        let out = folder.path().join(out);
        let finished = rig.record(&in_virtual_time(4.0, &out)).expect("recording");
        assert_eq!(finished.missing, 0);
        assert_eq!(finished.stored, 3 * (4 * 30 + 4 * 200));
        files(&out)
    };
    let (first, second) = (run("first"), run("second"));
    assert!(
        first
            .keys()
            .any(|path| path.ends_with("segments/000000.mcap")),
        "{:?}",
        first.keys()
    );
    assert_eq!(
        first.keys().collect::<Vec<_>>(),
        second.keys().collect::<Vec<_>>()
    );
    for (path, content) in &first {
        let other = &second[path];
        let differs = content.iter().zip(other).position(|(a, b)| a != b);
        assert_eq!(
            (content.len(), differs),
            (other.len(), None),
            "{}",
            path.display()
        );
    }
}

/// All files below a folder, by their path in it.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut folders = vec![folder.to_owned()];
    while let Some(inside) = folders.pop() {
        for entry in fs::read_dir(&inside).expect("folder") {
            let path = entry.expect("entry").path();
            if path.is_dir() {
                folders.push(path);
            } else {
                let name = path.strip_prefix(folder).expect("inside").to_owned();
                found.insert(name, fs::read(&path).expect("file"));
            }
        }
    }
    found
}
