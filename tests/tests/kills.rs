//! Random kills of a recorder at small scale; `bench kills` does a thousand.

use std::fs;
use std::path::Path;
use std::sync::{Arc, Mutex};

use capture_daemon::run::{StopFlag, record};
use capture_daemon::status::Progress;
use harness::contents::{Contents, open};
use harness::kills::{KillResult, Plan, RIG, Recorder, check, run};
use harness::program::pawsd;
use harness::rig::in_virtual_time;
use session_archive::manifest::{Manifest, SegmentState, State};
use session_archive::verify::verify;

#[test]
fn promised_data_survives_kills_at_random_times() {
    let folder = tempfile::tempdir().expect("folder");
    let named = std::env::var("PAWS_SEED")
        .ok()
        .and_then(|text| text.parse().ok());
    let plan = Plan {
        kills: 25,
        parallel: 4,
        seed: named.unwrap_or_else(|| u64::from(std::process::id())),
        after_ms: (50, 1500),
        pawsd: pawsd().expect("pawsd"),
        folder: folder.path().to_owned(),
    };
    println!("seed {}; PAWS_SEED repeats it", plan.seed);
    let (killed, failed): (Vec<_>, Vec<_>) =
        run(&plan, &|_| {}).into_iter().partition(Result::is_ok);
    if let Some(Err(first)) = failed.into_iter().next() {
        let kept = folder.keep();
        panic!("{first:?}\nits folder is {}", kept.display());
    }
    let killed: Vec<KillResult> = killed.into_iter().flatten().collect();
    assert_eq!(killed.len(), 25);
    let sum = |of: fn(&KillResult) -> u64| killed.iter().map(of).sum::<u64>();
    println!(
        "{} of {} messages were promised, {} frames and {} IMU samples compared, {} missing",
        sum(|k| k.promised),
        sum(|k| k.messages),
        sum(|k| k.frames),
        sum(|k| k.imu_samples),
        sum(|k| k.missing)
    );
    assert!(
        sum(|k| k.promised) > 0,
        "no kill came late enough to prove anything"
    );
}

#[test]
fn signal_closes_the_session() {
    let folder = tempfile::tempdir().expect("folder");
    for signal in [rustix::process::Signal::INT, rustix::process::Signal::TERM] {
        let recorder = Recorder::start(&pawsd().expect("pawsd"), folder.path()).expect("start");
        let session = recorder.wait_until_recording().expect("begin");
        recorder.wait_for_durable().expect("a chunk on disk");
        let pid = rustix::process::Pid::from_raw(recorder.id() as i32).expect("pid");
        rustix::process::kill_process(pid, signal).expect("signal");
        let (code, said) = recorder.wait().expect("end");
        assert_eq!(code, Some(check_closed(&session, &said)));
    }
}

/// Checks that [`check`] can fail: each kind of loss is caused on purpose.
#[test]
fn broken_promises_are_detected() {
    let folder = tempfile::tempdir().expect("folder");
    let config = RIG.config(folder.path()).expect("configuration");
    let promises = Arc::new(Mutex::new(Vec::new()));
    let heard = promises.clone();
    let listen = Box::new(move |progress| {
        if let Progress::Durable { until, messages } = progress {
            heard.lock().expect("promises").push((until, messages));
        }
    });
    let options = in_virtual_time(3.0, folder.path());
    let finished = record(&config, &options, &StopFlag::new(), listen).expect("recording");
    let promises = promises.lock().expect("promises").clone();
    let (until, messages) = *promises.last().expect("promises");
    let whole = Contents::read(&finished.session).expect("contents");
    let segment = finished.session.join("segments/000000.mcap");
    let bytes = fs::read(&segment).expect("segment");

    let verdict = |name: &str, bytes: &[u8], promise| {
        let copy = folder.path().join(name);
        fs::create_dir_all(copy.join("segments")).expect("folder");
        fs::create_dir_all(copy.join("rig")).expect("folder");
        let manifest = Manifest {
            state: State::Recording,
            stopped: None,
            ..manifest(&whole)
        };
        fs::write(copy.join("session.json"), manifest.to_bytes()).expect("manifest");
        fs::write(copy.join("segments/000000.mcap"), bytes).expect("segment");
        check(&copy, Some(promise), until, true).map_err(|e| format!("{e:#}"))
    };
    let killed = verdict("whole", &bytes, (until, messages)).expect("nothing is wrong");
    assert_eq!((killed.messages, killed.frames), (whole.messages, 2 * 90));
    let error = verdict("more", &bytes, (until, whole.messages + 1)).expect_err("one more");
    assert!(error.contains("promised"), "{error}");
    let error = verdict("later", &bytes, (until + 1_000_000_000, messages)).expect_err("later");
    assert!(error.contains("was promised"), "{error}");
    let half = verdict("half", &bytes[..bytes.len() / 2], promises[0]).expect("a cut is no damage");
    assert!(half.cut_off && half.messages < whole.messages, "{half:?}");
    let error = verdict("less", &bytes[..bytes.len() / 2], (until, messages)).expect_err("a cut");
    assert!(error.contains("promised"), "{error}");
    let mut flipped = bytes.clone();
    flipped[bytes.len() / 2] ^= 1;
    let error = verdict("flipped", &flipped, (until, 0)).expect_err("a flipped bit");
    assert!(error.contains("more than a truncated end"), "{error}");
}

/// The manifest during recording: segments and extents as at the start.
fn manifest(whole: &Contents) -> Manifest {
    let mut manifest = whole.manifest.clone();
    manifest.extents.clear();
    for segment in &mut manifest.segments {
        (segment.state, segment.bytes, segment.messages) = (SegmentState::Open, 0, 0);
        (segment.start, segment.end) = (None, None);
    }
    manifest
}

/// Checks that the session is closed and the recorder's last message is correct; returns the exit
/// code that follows from it.
fn check_closed(session: &Path, said: &[Progress]) -> i32 {
    let reader = open(session).expect("open");
    assert_eq!(reader.manifest().state, State::Closed);
    assert_eq!(
        reader
            .manifest()
            .stopped
            .as_ref()
            .map(|s| s.reason.as_str()),
        Some("signal")
    );
    let report = verify(&reader, |_| {}).expect("verify");
    assert!(report.is_sound(), "{report:?}");
    let Some(Progress::Finished {
        session: reported,
        reason,
        stored,
        missing,
        absent,
        error,
        ..
    }) = said.last()
    else {
        panic!("the last message was {:?}", said.last());
    };
    assert_eq!(
        (reported.as_path(), reason.as_str(), error),
        (session, "signal", &None)
    );
    let samples: u64 = report.streams.values().map(|s| s.samples).sum();
    let gaps: u64 = report.streams.values().map(|s| s.gaps).sum();
    assert_eq!((*stored, *missing), (samples, gaps));
    // On a busy machine frames may be missing.
    if *missing == 0 && absent.is_empty() {
        0
    } else {
        3
    }
}
