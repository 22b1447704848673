//! A disk that is full, fails, or loses the session's folder.

use super::*;

#[test]
fn full_disk_ends_in_a_closed_session() {
    let bench = Bench::default();
    *bench.free.lock().expect("free") = Some(10 << 30);
    let mut rig = rig(0, bench);
    rig.steps(10);
    started(&mut rig);
    rig.steps(30);
    *rig.bench.free.lock().expect("free") = Some(900 << 20);
    rig.health();
    assert_eq!(rig.recorder.state(), State::Stopping);
    rig.steps(6);
    assert_eq!(rig.recorder.state(), State::Armed);
    rig.health();
    assert_eq!(rig.recorder.status().alarms, [DISK_FULL]);
    let reader = rig.session();
    assert_eq!(
        reader.manifest().stopped.as_ref().expect("stop").reason,
        "disk full"
    );
    assert!(verify(&reader, |_| {}).expect("verify").is_sound());
    let refused = rig.recorder.start("", "button").expect_err("no space");
    assert!(refused.contains("900 MB are free"), "{refused}");
}

/// Whatever write or sync fails, permanently or once: the session can be opened, is accounted for,
/// and the failure is reported.
#[test]
fn failing_disk_ends_in_a_valid_session_and_a_clear_message() {
    let run = |fault: Option<Fault>| {
        let mut rig = rig(
            0,
            Bench {
                faults: fault.into_iter().collect(),
                ..Bench::default()
            },
        );
        rig.steps(10);
        let _ = rig.recorder.start("", "button");
        rig.steps(40);
        rig.recorder.close_now("button");
        rig
    };
    let disks = run(None).bench.disks;
    let operations = disks.lock().expect("disks")[0].operations();
    assert!(operations > 20);
    for at in 0..operations {
        for kind in [
            FaultKind::NoSpace,
            FaultKind::InputOutput,
            FaultKind::PowerCut,
        ] {
            let rig = run(Some(Fault { at, kind, keep: 17 }));
            let progress = rig.progress();
            let reported = progress.iter().any(|p| {
                matches!(p, Progress::Finished { error: Some(_), .. })
                    || matches!(p, Progress::Alarm { active: true, .. })
            });
            let disk = rig.bench.disks.lock().expect("disks").first().cloned();
            let Some(disk) = disk else {
                assert!(
                    rig.recorder.fault.is_some(),
                    "{kind:?} at {at}: no session and no word"
                );
                continue;
            };
            let reader = SessionReader::open(Arc::new(disk)).expect("open");
            let report = verify(&reader, |_| {}).expect("verify");
            assert!(report.lost.is_empty(), "{kind:?} at {at}: {report:#?}");
            let (stored, missing) = rig.account();
            let found: u64 = report.streams.values().map(|s| s.samples).sum();
            assert!(
                stored <= found,
                "{kind:?} at {at}: {stored} of {found} stored"
            );
            assert!(
                stored == found || missing > 0,
                "{kind:?} at {at}: {stored} of {found} stored, nothing missing"
            );
            if kind == FaultKind::InputOutput {
                assert_eq!(
                    report.streams["feet"].gaps, 0,
                    "one failure loses nothing: {at}"
                );
            } else {
                let whole = report.streams["feet"].samples == 40;
                assert!(
                    reported || whole || rig.recorder.fault.is_some(),
                    "{kind:?} at {at}"
                );
            }
        }
    }
}

#[test]
fn disk_alarms_end_with_their_cause() {
    let bench = Bench::default();
    let free = bench.free.clone();
    let set = |bytes| *free.lock().expect("free") = Some(bytes);
    let mut rig = rig(0, bench);
    set(10 << 30);
    rig.steps(10);
    started(&mut rig);
    rig.steps(20);
    set((1 << 30) + 1000);
    rig.health();
    assert_eq!(rig.recorder.status().alarms, [DISK_LOW]);
    assert!(rig.recorder.status().seconds_left.is_some());
    rig.recorder.close_now("button");
    set(10 << 30);
    rig.health();
    let status = rig.recorder.status();
    assert!(status.alarms.is_empty() && status.seconds_left.is_none());
    set(1 << 30);
    rig.health();
    assert_eq!(rig.recorder.status().alarms, [DISK_FULL], "before a press");
}

#[test]
fn failed_start_keeps_the_pre_roll_and_removes_the_folder() {
    let fault = Fault {
        at: 3,
        kind: FaultKind::InputOutput,
        keep: 0,
    };
    let bench = Bench {
        faults: vec![fault],
        ..Bench::default()
    };
    let mut rig = rig(1000 * MS, bench);
    rig.steps(50);
    let refused = rig.recorder.start("", "button").expect_err("the disk");
    assert!(refused.contains("cannot be created"), "{refused}");
    assert!(rig.bench.disks.lock().expect("disks").is_empty());
    let press = rig.now();
    started(&mut rig);
    rig.recorder.close_now("button");
    let frames: Vec<Frame> = rig.messages("feet");
    assert!(press.0 - frames[0].time >= 1000 * MS);
}

#[test]
fn session_ends_with_the_next_chunk_after_its_folder_is_removed() {
    let bench = Bench::default();
    let mut rig = rig(0, bench.clone());
    rig.steps(10);
    started(&mut rig);
    rig.steps(30);
    *bench.is_removed.lock().expect("is_removed") = true;
    let removed = rig.now();
    while rig.recorder.state() == State::Recording {
        rig.step();
        assert!(
            rig.now().since(removed) <= 1_000 * MS + PERIOD,
            "it continues"
        );
    }
    assert_eq!(rig.recorder.state(), State::Fault);
    let Some(Progress::Finished { error, .. }) = rig.progress().pop() else {
        panic!("the session ended");
    };
    let error = error.expect("a failure");
    assert!(error.contains("removed"), "{error}");
}
