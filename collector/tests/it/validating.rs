//! Validation: a good session passes, and every fault is found with metric and verdict.

use std::fs;
use std::path::Path;

use collector::commands::validate::{Options, ValidatedSession, validate};
use session_archive::handoff::Verdict::{Fail, Pass, Warn};
use session_health::TABLE;

use crate::support::{MS, Session, capture};

fn validated(folder: &Path) -> ValidatedSession {
    let options = Options::default();
    capture(|console| validate(folder, &options, console))
        .0
        .unwrap()
}

/// Validates a session with a fault; returns the findings that are not a pass, as (verdict, metric,
/// stream).
fn beyond(
    seconds: f64,
    spoil: impl FnOnce(&mut Session),
) -> Vec<(session_archive::handoff::Verdict, String, String)> {
    let folder = tempfile::tempdir().unwrap();
    let mut session = Session::good(seconds);
    spoil(&mut session);
    session.write(folder.path());
    beyond_in(folder.path())
}

fn beyond_in(folder: &Path) -> Vec<(session_archive::handoff::Verdict, String, String)> {
    let validation = validated(folder).validation;
    let findings = validation.findings.into_iter();
    findings
        .filter(|f| f.verdict != Pass)
        .map(|f| (f.verdict, f.metric, f.of))
        .collect()
}

fn expect(
    found: &[(session_archive::handoff::Verdict, String, String)],
    expected: &[(session_archive::handoff::Verdict, &str, &str)],
) {
    let found: Vec<_> = found
        .iter()
        .map(|(v, m, o)| (*v, m.as_str(), o.as_str()))
        .collect();
    assert_eq!(found, expected);
}

#[test]
fn a_good_session_passes_with_every_metric_measured() {
    let folder = tempfile::tempdir().unwrap();
    Session::good(3.0).write(folder.path());
    let validation = validated(folder.path()).validation;
    assert_eq!(validation.verdict, Pass, "{:?}", validation.reasons);
    // Those of a calibration need a walk, and decoded images.
    let needs_more = |metric: &str| metric == "camera.undecoded" || metric.starts_with("calib.");
    for row in TABLE.iter().filter(|row| !needs_more(row.metric)) {
        let measured = validation.findings.iter().any(|f| f.metric == row.metric);
        assert!(measured, "{} was not measured", row.metric);
    }
    let of = |metric: &str, of: &str| {
        let mut findings = validation.findings.iter();
        findings
            .find(|f| f.metric == metric && f.of == of)
            .unwrap()
            .value
    };
    assert_eq!(of("camera.longest_gap", "left_shoulder"), 33_333_333.0);
    assert_eq!(
        of("rig.misalignment", "left_shoulder and right_shoulder"),
        20_000.0
    );
    assert_eq!(of("rig.free_misalignment", "feet"), 12.0e6);
    assert_eq!(of("stream.start_offset", "feet"), 12.0e6);
}

#[test]
fn validation_is_deterministic() {
    let folder = tempfile::tempdir().unwrap();
    Session::good(1.0).write(folder.path());
    let bytes = || validated(folder.path()).validation.to_bytes().unwrap();
    assert_eq!(bytes(), bytes());
}

#[test]
fn missing_frames_warn_or_fail_by_fraction() {
    // 1 of 300 is more than 0.1 %, and the gap of two periods is fine.
    let found = beyond(10.0, |s| s.drop_frames(0, 200, 200, true));
    expect(&found, &[(Warn, "camera.dropped", "left_shoulder")]);
    let found = beyond(10.0, |s| s.drop_frames(0, 200, 204, true));
    expect(
        &found,
        &[
            (Fail, "camera.dropped", "left_shoulder"),
            (Warn, "camera.longest_gap", "left_shoulder"),
        ],
    );
    // The slower camera: three lost make 267 ms.
    let found = beyond(10.0, |s| s.drop_frames(2, 150, 152, true));
    expect(
        &found,
        &[
            (Fail, "camera.dropped", "feet"),
            (Fail, "camera.longest_gap", "feet"),
        ],
    );
}

#[test]
fn left_right_time_offset_above_the_limit_warns() {
    let apart = |ns: i64| {
        beyond(5.0, move |s| {
            let feet = s.frames(2).zip([1, -1].into_iter().cycle());
            feet.for_each(|(frame, side)| frame.eyes_apart_ns = Some(side * ns));
        })
    };
    expect(&apart(900_000), &[]);
    expect(&apart(1_100_000), &[(Warn, "camera.eyes_apart", "feet")]);
}

#[test]
fn frames_lost_without_a_gap_record_are_damage() {
    let found = beyond(10.0, |s| s.drop_frames(0, 200, 200, false));
    expect(
        &found,
        &[
            (Fail, "session.damage", "session"),
            (Warn, "camera.dropped", "left_shoulder"),
        ],
    );
}

#[test]
fn camera_without_frames_fails() {
    let found = beyond(2.0, |s| s.stereo_frames.retain(|p| p.camera != 2));
    assert!(
        found.contains(&(Fail, "camera.dropped".into(), "feet".into())),
        "{found:?}"
    );
}

#[test]
fn irregular_frame_periods_are_found() {
    // Every tenth frame of the device is late.
    let jitter = |late: i64| {
        beyond(5.0, move |s| {
            for frame in s.frames(2).filter(|f| f.number % 10 == 5) {
                frame.device_ticks += late;
                frame.time += late;
            }
        })
    };
    expect(&jitter(200_000), &[]);
    expect(
        &jitter(300_000),
        &[(Warn, "camera.period_deviation", "feet")],
    );
    expect(
        &jitter(600_000),
        &[(Fail, "camera.period_deviation", "feet")],
    );
    // A refined clock map changes times, not the camera's regularity.
    let refined = beyond(5.0, |s| {
        for frame in s.frames(2).filter(|f| f.number > 110) {
            frame.time -= MS;
        }
    });
    expect(&refined, &[]);
}

#[test]
fn a_camera_at_half_its_rate_fails() {
    let found = beyond(5.0, |s| s.spec.cameras[2].rate_hz = 30.0);
    expect(&found, &[(Fail, "camera.rate", "feet")]);
    let found = beyond(5.0, |s| s.spec.cameras[2].rate_hz = 15.6);
    expect(&found, &[(Warn, "camera.rate", "feet")]);
}

#[test]
fn non_increasing_times_fail() {
    let found = beyond(3.0, |s| {
        let frame = s.frames(2).nth(5).unwrap();
        frame.time -= 67 * MS;
    });
    expect(&found, &[(Fail, "camera.non_monotonic", "feet")]);
    let found = beyond(3.0, |s| s.imu[5].times[7] = s.imu[5].times[6]);
    expect(&found, &[(Fail, "imu.non_monotonic", "feet/imu")]);
}

#[test]
fn frozen_images_are_found() {
    let freeze = |n: u64| {
        beyond(4.0, move |s| {
            for frame in s.frames(2).filter(|f| (110..110 + n).contains(&f.number)) {
                frame.frozen = true;
            }
        })
    };
    expect(&freeze(1), &[(Warn, "camera.frozen", "feet")]);
    expect(&freeze(20), &[(Fail, "camera.frozen", "feet")]);
}

#[test]
fn a_bad_payload_is_found() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = Session::good(2.0);
    // The same number twice: the second is rejected.
    let twice = session.stereo_frames[7].clone();
    session.stereo_frames.insert(8, twice);
    session.write(folder.path());
    let found = beyond_in(folder.path());
    assert!(
        found.contains(&(Fail, "camera.bad".into(), "left_shoulder".into())),
        "{found:?}"
    );
}

#[test]
fn damage_and_a_cut_are_distinguished() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = Session::with_units(3.0, 1000);
    session.closed = false;
    session.write(folder.path());
    expect(
        &beyond_in(folder.path()),
        &[(Warn, "session.unclosed", "session")],
    );
    let segment = folder.path().join("segments/000000.mcap");
    let mut bytes = fs::read(&segment).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&segment, bytes).unwrap();
    let found = beyond_in(folder.path());
    assert!(
        found.contains(&(Fail, "session.damage".into(), "session".into())),
        "{found:?}"
    );
}

#[test]
fn an_altered_rig_file_is_damage() {
    let folder = tempfile::tempdir().unwrap();
    Session::good(2.0).write(folder.path());
    fs::write(folder.path().join("rig/rig.toml"), b"revision = 2\n").unwrap();
    expect(
        &beyond_in(folder.path()),
        &[(Fail, "session.damage", "session")],
    );
}

#[test]
fn misaligned_cameras_are_found() {
    let late = |ns: i64| {
        beyond(3.0, move |s| {
            for frame in s.frames(1) {
                frame.time += ns;
            }
            for set in &mut s.sets {
                for member in set
                    .members
                    .iter_mut()
                    .filter(|m| m.camera == "right_shoulder")
                {
                    member.time += ns;
                }
            }
        })
    };
    let of = "left_shoulder and right_shoulder";
    expect(&late(200_000), &[]);
    expect(&late(300_000), &[(Warn, "rig.misalignment", of)]);
    expect(&late(600_000), &[(Fail, "rig.misalignment", of)]);
    let apart = |ns: i64| {
        beyond(3.0, move |s| {
            for set in &mut s.sets {
                for member in set.members.iter_mut().filter(|m| m.camera == "feet") {
                    member.time = set.time + ns;
                }
            }
        })
    };
    expect(&apart(33 * MS), &[]);
    expect(&apart(40 * MS), &[(Warn, "rig.free_misalignment", "feet")]);
    expect(&apart(70 * MS), &[(Fail, "rig.free_misalignment", "feet")]);
}

#[test]
fn imu_faults_are_found() {
    let without = |numbers: std::ops::Range<usize>| {
        beyond(4.0, move |s| {
            let lost = s.imu.drain(numbers).collect::<Vec<_>>();
            s.gaps.push(session_archive::record::Gap {
                stream: "feet/imu".to_owned(),
                first: lost[0].first_number,
                last: lost[lost.len() - 1].first_number + 19,
                cause: 1,
                time_before: Some(lost[0].times[0] - 5 * MS),
                ..Default::default()
            });
        })
    };
    expect(
        &without(10..11),
        &[
            (Fail, "imu.dropped", "feet/imu"),
            (Fail, "imu.longest_gap", "feet/imu"),
        ],
    );
    let late = |ticks: i64| {
        beyond(4.0, move |s| {
            for batch in &mut s.imu {
                batch.device_ticks[3] += ticks;
            }
        })
    };
    // One tick is 39 us.
    expect(&late(2), &[]);
    expect(&late(4), &[(Warn, "imu.period_deviation", "feet/imu")]);
    expect(&late(6), &[(Fail, "imu.period_deviation", "feet/imu")]);
    let found = beyond(4.0, |s| s.spec.imus[0].rate_hz = 400.0);
    expect(&found, &[(Warn, "imu.rate", "feet/imu")]);
    let found = beyond(4.0, |s| {
        for batch in &mut s.imu[4..8] {
            batch.gyro_counts = vec![7; 60];
            batch.accel_counts = vec![9; 60];
        }
    });
    expect(&found, &[(Warn, "imu.stuck_value", "feet/imu")]);
    let found = beyond(4.0, |s| s.imu[3].first_number = 0);
    assert!(
        found.contains(&(Fail, "imu.bad".into(), "feet/imu".into())),
        "{found:?}"
    );
}

#[test]
fn late_starts_and_early_ends_are_found() {
    let found = beyond(5.0, |s| {
        s.stereo_frames
            .retain(|p| p.camera != 2 || p.frame.number >= 130);
    });
    assert!(
        found.contains(&(Warn, "stream.start_offset".into(), "feet".into())),
        "{found:?}"
    );
    let found = beyond(5.0, |s| {
        s.stereo_frames
            .retain(|p| p.camera != 2 || p.frame.number < 125);
    });
    expect(&found, &[(Fail, "stream.end_offset", "feet")]);
}

#[test]
fn health_records_are_evaluated() {
    let degraded = |step: &'static str| {
        beyond(4.0, move |s| {
            s.health[2].1.degradation = step.to_owned();
        })
    };
    expect(&degraded("normal"), &[]);
    // Only the phone's preview is affected.
    expect(&degraded("lower preview"), &[]);
    for step in ["lower bitrate", "lower frame rate"] {
        expect(&degraded(step), &[(Warn, "session.degraded", "session")]);
    }
    let tied = |offset_ns: i64| {
        beyond(4.0, move |s| {
            for (_, health) in &mut s.health {
                let tie = health.streams[3].frame_sync.as_mut().unwrap();
                tie.offset_ns = offset_ns;
            }
        })
    };
    expect(&tied(-3_000_000), &[]);
    expect(&tied(9_000_000), &[(Warn, "imu.frame_sync", "feet/imu")]);
    expect(&tied(-33_000_000), &[(Warn, "imu.frame_sync", "feet/imu")]);
}

#[test]
fn unreliable_clocks_and_missing_calibration_warn() {
    let sigma = |ns: u64| beyond(2.0, move |s| s.frames(2).for_each(|f| f.sigma_ns = ns));
    expect(&sigma(3_000_000), &[(Warn, "stream.clock_sigma", "feet")]);
    expect(&sigma(30_000_000), &[(Fail, "stream.clock_sigma", "feet")]);
    let found = beyond(12.0, |s| s.frames(1).for_each(|f| f.time_unreliable = true));
    expect(
        &found,
        &[(Warn, "stream.unreliable_time", "right_shoulder")],
    );
    let found = beyond(12.0, |s| {
        s.imu.iter_mut().for_each(|b| b.time_unreliable = true)
    });
    expect(&found, &[(Warn, "stream.unreliable_time", "feet/imu")]);
    // Times may be unreliable until a clock has converged.
    let found = beyond(12.0, |s| {
        s.frames(1).take(64).for_each(|f| f.time_unreliable = true)
    });
    expect(&found, &[]);
    let found = beyond(2.0, |s| {
        s.calibrations.remove("feet/right");
    });
    expect(&found, &[(Warn, "camera.calibration", "feet")]);
    let found = beyond(2.0, |s| s.transforms = None);
    expect(&found, &[(Warn, "rig.transforms", "rig")]);
    let without = |child: &'static str| {
        beyond(2.0, move |s| {
            let transforms = s.transforms.as_mut().unwrap();
            transforms.transforms.retain(|t| t.child_frame_id != child);
        })
    };
    expect(&without("feet/right"), &[(Warn, "rig.transforms", "rig")]);
    expect(&without("feet/left"), &[(Warn, "rig.transforms", "rig")]);
    let found = beyond(2.0, |s| s.sets.clear());
    expect(&found, &[(Warn, "rig.frame_sets", "rig")]);
}

#[test]
fn calibrations_of_other_sizes_fail_and_padding_warns() {
    // Images of this size with a calibration of another one.
    let check_sizes = |images: [u32; 2], calibration: [u32; 2]| {
        beyond(2.0, move |s| {
            let camera = s.spec.cameras.iter_mut().find(|c| c.name == "feet");
            let camera = camera.unwrap();
            (camera.width, camera.height) = (2 * images[0], images[1]);
            for (eye, size) in [("left", images), ("right", calibration)] {
                let calibration = s.calibrations.get_mut(&format!("feet/{eye}")).unwrap();
                [calibration.width, calibration.height] = size;
            }
        })
    };
    for size in [[64, 48], [63, 47]] {
        expect(&check_sizes(size, size), &[]);
    }
    // Images with a repeated last row or column, or both, and the calibration without it.
    let padding = [(Warn, "camera.calibration_padding", "feet")];
    for calibration in [[63, 48], [64, 47], [63, 47]] {
        expect(&check_sizes([64, 48], calibration), &padding);
    }
    let other_size = [(Fail, "camera.calibration_size", "feet")];
    for (images, calibration) in [
        ([64, 48], [1344, 376]),
        // One pixel, but no padding: the calibration is the larger one, or of even size.
        ([64, 48], [65, 48]),
        ([64, 48], [64, 49]),
        ([63, 48], [64, 48]),
        ([63, 48], [62, 48]),
        ([64, 48], [63, 49]),
        ([64, 48], [u32::MAX, 48]),
    ] {
        expect(&check_sizes(images, calibration), &other_size);
    }
}

#[test]
fn calibration_of_another_size_names_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = Session::good(2.0);
    session.calibrations.get_mut("feet/right").unwrap().width = 65;
    session.write(folder.path());
    let findings = validated(folder.path()).validation.findings;
    let is_size = |f: &&session_health::Finding| f.metric == "camera.calibration_size";
    let found = findings.iter().filter(is_size).find(|f| f.verdict == Fail);
    let text = &found.unwrap().text;
    for part in [
        "pixels: 1 (feet/right 65x48, expected 64x48; remedy: a calibration for images of this size",
        "`paws calib cameras BOARDS --target board.toml --out calibration`",
    ] {
        assert!(text.contains(part), "no {part} in {text}");
    }
}

#[test]
fn missing_calibration_names_the_remedy() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = Session::good(2.0);
    session.calibrations.remove("feet/right");
    session.transforms = None;
    session.write(folder.path());
    let validation = validated(folder.path()).validation;
    for (metric, what) in [
        ("camera.calibration", "feet/right"),
        ("rig.transforms", "feet"),
    ] {
        let found = validation.findings.iter();
        let found: Vec<_> = found
            .filter(|f| f.metric == metric && f.verdict == Warn)
            .collect();
        let [finding] = found[..] else {
            panic!("{metric}: {found:?}");
        };
        for part in [
            what,
            "`paws calib cameras BOARDS --target board.toml --out calibration`",
            "`paws reconstruct run SESSION --calibration calibration --out SCENE`",
        ] {
            assert!(finding.text.contains(part), "no {part} in {}", finding.text);
        }
    }
}

#[test]
fn limits_can_be_changed() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = Session::good(10.0);
    session.drop_frames(0, 200, 200, true);
    session.write(folder.path());
    let mut options = Options::default();
    options.limits.set("camera.dropped=0.02,0.05").unwrap();
    let moved = capture(|console| validate(folder.path(), &options, console)).0;
    assert_eq!(moved.unwrap().validation.verdict, Pass);
}

#[test]
fn summary_lists_losses_by_cause_and_events() {
    let folder = tempfile::tempdir().unwrap();
    let mut session = Session::good(4.0);
    session.drop_frames(0, 120, 121, true);
    session.drop_frames(0, 140, 140, true);
    session.write(folder.path());
    let summary = validated(folder.path()).validation.summary;
    assert_eq!(summary.losses.len(), 1);
    let loss = &summary.losses[0];
    assert_eq!((loss.samples, loss.gaps), (3, 2));
    assert_eq!(loss.cause, "encoder overload");
    let marks: Vec<_> = summary
        .events
        .iter()
        .map(|e| (e.kind.as_str(), e.after_ns))
        .collect();
    assert_eq!(marks, [("start", 0), ("mark", 2000 * MS)]);
    assert_eq!(summary.streams[0].missing, 3);
}
