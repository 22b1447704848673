//! An encoder that cannot keep up, in real time. The only test of this file, since it uses the
//! whole machine.

use capture_daemon::run::{StopFlag, record};
use capture_daemon::sources::synthetic::read_counter;
use harness::contents::{Contents, open};
use harness::rig::{Rig, in_real_time};
use session_archive::record::paws::event::Kind;
use session_archive::record::paws::gap::Cause;
use session_archive::verify::verify;

/// Frames are queued in front of an encoder that is too slow and encoded after the stop; load
/// shedding leaves frames out on purpose. None is dropped for lack of memory.
#[test]
fn queued_frames_are_encoded_after_the_stop_of_an_overload() {
    // Several times the capacity of one thread, and less than the queue limit: 182 of 256 MB.
    let rig = Rig {
        width: 1344,
        height: 752,
        rate_hz: 60.0,
        encoder: "x265enc",
        ..Rig::small(1)
    };
    if let Err(reason) = video::discover::trial(rig.encoder, rig.width, rig.height) {
        return eprintln!("skipped: {}: {reason}", rig.encoder);
    }
    let folder = tempfile::tempdir().expect("folder");
    let mut config = rig.config(folder.path()).expect("configuration");
    // At this quality a fast machine is overloaded several times as well: hardly a coefficient
    // becomes zero.
    config.encoder.quality_db = 50.0;
    let options = in_real_time(2.0, folder.path());
    let finished = record(&config, &options, &StopFlag::new(), Box::new(|_| {}));
    let finished = finished.expect("recording");
    assert_eq!(finished.error, None);
    let report = verify(&open(&finished.session).expect("open"), |_| {}).expect("verify");
    assert!(report.is_sound(), "{report:?}");
    let contents = Contents::read(&finished.session).expect("contents");
    let (stored, samples) = (
        contents.check_numbers("left_shoulder").expect("numbers"),
        contents
            .check_numbers("left_shoulder/imu")
            .expect("numbers"),
    );
    let gaps = contents.gaps_of("left_shoulder");
    println!(
        "{stored} of {} frames are stored",
        stored + finished.missing
    );
    // Load was shed, and each step is recorded in the session: a single camera of x265enc has two.
    let steps: Vec<&str> = contents
        .events
        .iter()
        .filter(|(_, event)| event.source == "encoders" && event.kind == Kind::Fault as i32)
        .map(|(_, event)| event.text.as_str())
        .collect();
    println!("given up: {steps:?}");
    assert!(
        steps
            .first()
            .is_some_and(|text| text.ends_with("quality lowered")),
        "{steps:?}"
    );
    let is_halved = steps
        .iter()
        .any(|text| text.ends_with("half the frame rate of all cameras"));
    let frames = &contents.frames["left_shoulder"];
    let newest = frames.last().expect("frames").record.number;
    for (first, last, cause) in &gaps {
        match Cause::try_from(*cause) {
            Ok(Cause::LoadShed) => assert!(is_halved, "{first} to {last} were shed: {steps:?}"),
            // On a very slow machine the stop does not wait for all queued frames.
            Ok(Cause::Late) => assert!(*first > newest, "{first} to {last} came too late"),
            // An encoder without output for two seconds is replaced.
            Ok(Cause::EncoderRestart) => {}
            other => panic!("{first} to {last}: {other:?}"),
        }
    }
    assert_eq!(
        finished.missing,
        gaps.iter().map(|gap| gap.1 - gap.0 + 1).sum::<u64>()
    );
    // IMU samples are never shed.
    assert!(contents.gaps_of("left_shoulder/imu").is_empty());
    assert!(stored > 0 && samples > 0, "{stored}, {samples}");
    let checked = contents.decode("left_shoulder", |frame, image| {
        assert_eq!(read_counter(image), Some(frame.number));
        Ok(())
    });
    checked.expect("decoding");
    contents.check_times().expect("times");
}
