//! Losses of samples: their gap records and alarms.

use super::*;

#[test]
fn every_loss_becomes_a_gap_with_its_cause() {
    let mut rig = rig(0, Bench::default());
    rig.steps(10);
    started(&mut rig);
    rig.steps(3);
    let dropped = |first, last, cause| Outgoing::Dropped {
        at: START,
        stream: "feet".to_owned(),
        first,
        last,
        cause,
        detail: "test".to_owned(),
    };
    rig.recorder.handle(dropped(
        rig.next[1],
        rig.next[1] + 1,
        Cause::EncoderOverload,
    ));
    // Two are reported, two only the device counted.
    for _ in 0..4 {
        rig.next[1] += 1;
        rig.frame(0);
        rig.clock.advance_to(rig.now() + PERIOD);
    }
    rig.steps(5);
    rig.recorder
        .handle(dropped(rig.next[1], rig.next[1], Cause::EncoderRestart));
    rig.recorder.close_now("button");
    let gaps: Vec<Gap> = rig.messages("");
    let found: Vec<_> = gaps
        .iter()
        .map(|g| (g.stream.as_str(), g.count(), g.cause()))
        .collect();
    let expected = [
        ("feet", 2, Cause::EncoderOverload),
        ("feet", 2, Cause::Device),
        ("feet", 1, Cause::EncoderRestart),
    ];
    assert_eq!(found, expected);
    let report = verify(&rig.session(), |_| {}).expect("verify");
    assert!(report.is_sound(), "{report:#?}");
    let feet = &report.streams["feet"];
    assert_eq!(feet.samples + feet.gaps, feet.expected());
    let sets: Vec<FrameSet> = rig.messages("");
    assert!(sets.iter().any(|s| s.missing == ["feet"]));
    assert!(sets.iter().any(|s| s.members.len() == 2));
}

/// Two failures in a row lose the last chunk; the gap records written instead of it must not hide
/// this.
#[test]
fn losses_while_closing_are_reported() {
    let run = |faults: Vec<Fault>| {
        let bench = Bench {
            faults,
            ..Bench::default()
        };
        let mut rig = rig(0, bench);
        rig.steps(10);
        started(&mut rig);
        rig.steps(25);
        let disk = rig.bench.disks.lock().expect("disks")[0].clone();
        let before = disk.operations() as usize;
        rig.recorder.close_now("button");
        (rig, disk.log().split_off(before), before as u64)
    };
    let (whole, log, before) = run(Vec::new());
    let append = log
        .iter()
        .position(|o| matches!(o, Operation::Append(_)))
        .expect("a chunk") as u64;
    // The chunk, and after cutting it back the segment into which it was to go instead.
    let faults = [0, 2].map(|later| Fault {
        at: before + append + later,
        kind: FaultKind::InputOutput,
        keep: 0,
    });
    let (rig, ..) = run(faults.to_vec());
    let (all, none) = whole.account();
    let (stored, missing) = rig.account();
    assert_eq!(none, 0);
    assert!(missing > 0, "{:?}", rig.progress());
    assert_eq!(stored + missing, all);
    let report = verify(&rig.session(), |_| {}).expect("verify");
    let found: u64 = report.streams.values().map(|s| s.samples).sum();
    assert_eq!(found, stored);
    assert!(rig.progress().iter().any(
        |p| matches!(p, Progress::Alarm { text, active: true } if text.contains("data are lost"))
    ));
}

/// A loss raises an alarm with its cause within two seconds, and is reported at the end as a
/// fraction of the frames.
#[test]
fn loss_is_an_alarm_and_a_fraction_of_the_cameras_frames() {
    let mut rig = rig(0, Bench::default());
    rig.steps(10);
    started(&mut rig);
    // With a key frame.
    rig.step();
    for step in 0..60 {
        if step < 30 {
            // Every other frame of one camera is lost in its encoder.
            rig.recorder.handle(Outgoing::Dropped {
                at: rig.now(),
                stream: "feet".to_owned(),
                first: rig.next[1],
                last: rig.next[1],
                cause: Cause::EncoderOverload,
                detail: "full".to_owned(),
            });
            rig.next[1] += 1;
        }
        rig.step();
        if step % 20 == 19 {
            rig.health();
        }
        if step == 29 {
            // Page and lights use this status.
            let status = rig.recorder.status();
            assert_eq!(status.concerns, [Concern::Stream].into());
            assert!(
                status.alarms[0].contains("samples are being lost"),
                "{status:?}"
            );
        }
    }
    for _ in 0..6 {
        rig.steps(20);
        rig.health();
    }
    assert_eq!(rig.recorder.status().concerns, [].into());
    let alarms: Vec<(String, bool)> = rig
        .progress()
        .into_iter()
        .filter_map(|p| match p {
            Progress::Alarm { text, active } => Some((text, active)),
            _ => None,
        })
        .collect();
    let text = "feet: samples are being lost: the machine is too slow to encode them";
    let expected = [(text.to_owned(), true), (text.to_owned(), false)];
    assert_eq!(alarms, expected);
    rig.recorder.close_now("button");
    let Some(Progress::Finished {
        streams, missing, ..
    }) = rig.progress().pop()
    else {
        panic!("the session ended");
    };
    let feet = &streams[1];
    assert_eq!((feet.missing, feet.is_camera), (30, true));
    assert_eq!(missing, 30);
    assert_eq!(feet.causes.len(), 1, "{feet}");
    let share = 30.0 / (30.0 + feet.stored as f64);
    assert_eq!(feet.missing_share(), share);
    assert!(
        feet.to_string()
            .contains("% of the frames are missing (30 of "),
        "{feet}"
    );
    assert_eq!(streams[0].missing, 0);
}

/// A frame of each of these streams that is lost in its encoder.
fn lose(rig: &mut Rig, streams: &[&str]) {
    for stream in streams {
        rig.recorder.handle(Outgoing::Dropped {
            at: rig.now(),
            stream: (*stream).to_owned(),
            first: rig.next[0],
            last: rig.next[0],
            cause: Cause::EncoderOverload,
            detail: "full".to_owned(),
        });
    }
}

#[test]
fn discarding_a_session_clears_its_alarms() {
    let mut rig = rig(0, Bench::default());
    rig.steps(10);
    started(&mut rig);
    rig.step();
    lose(&mut rig, &["feet"]);
    rig.health();
    let text = "feet: samples are being lost: the machine is too slow to encode them";
    assert_eq!(rig.recorder.status().alarms, [text]);
    rig.recorder.request(Request::Discard, "button");
    assert_eq!(rig.recorder.status().alarms, Vec::<String>::new());
    let over = Progress::Alarm {
        text: text.to_owned(),
        active: false,
    };
    assert_eq!(rig.progress().pop(), Some(over));
}

/// The disk fails while the first of two alarms is written, which ends the session and both of
/// them.
#[test]
fn loss_alarms_end_with_the_session() {
    let run = |faults: Vec<Fault>| {
        let bench = Bench {
            faults,
            ..Bench::default()
        };
        let mut rig = rig(0, bench);
        rig.steps(10);
        started(&mut rig);
        rig.steps(10);
        lose(&mut rig, &["left_shoulder", "feet"]);
        // The next message closes the chunk.
        rig.clock.advance_to(rig.now() + 10 * NS_PER_S);
        let disk = rig.bench.disks.lock().expect("disks")[0].clone();
        let before = disk.operations();
        rig.health();
        assert!(disk.operations() > before);
        (rig, before)
    };
    let (whole, before) = run(Vec::new());
    assert_eq!(whole.recorder.status().alarms.len(), 2);
    let (rig, _) = run(vec![Fault {
        at: before,
        kind: FaultKind::PowerCut,
        keep: 0,
    }]);
    assert_eq!(rig.recorder.state(), State::Fault);
    let alarms = rig.recorder.status().alarms;
    assert!(
        alarms.len() == 1 && alarms[0].contains("ended by a failure"),
        "{alarms:?}"
    );
    let mut reported: BTreeMap<String, bool> = BTreeMap::new();
    for progress in rig.progress() {
        if let Progress::Alarm { text, active } = progress {
            reported.insert(text, active);
        }
    }
    let standing: Vec<String> = reported
        .into_iter()
        .filter_map(|(text, active)| active.then_some(text))
        .filter(|text| text.contains("samples are being lost"))
        .collect();
    assert_eq!(standing, Vec::<String>::new());
}
