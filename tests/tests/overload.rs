//! An encoder that cannot keep up, in real time. Alone in its file: it takes the whole machine.

use capture_daemon::sources::synthetic::read_counter;
use session_archive::record::paws::gap::Cause;
use session_archive::verify::verify;
use tests::contents::{Contents, open};
use tests::rig::{Rig, in_real_time};

/// Frames wait in front of an encoder that is too slow and are encoded after the stop; what is left out to relieve it
/// is left out on purpose. None is dropped for want of room.
#[test]
fn an_encoder_that_is_too_slow_gets_the_frames_that_waited_for_it() {
    // Several times what one thread can do, and less than what may wait.
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
    let finished = rig
        .record(&in_real_time(2.0, folder.path()))
        .expect("recording");
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
    // On a very slow machine the stop does not wait for all of them, and frames come too late from the source.
    let causes = [
        Cause::Spared,
        Cause::Late,
        Cause::MachineOverload,
        Cause::EncoderRestart,
    ]
    .map(i32::from);
    assert!(gaps.iter().all(|gap| causes.contains(&gap.2)), "{gaps:?}");
    assert_eq!(
        finished.missing,
        gaps.iter().map(|gap| gap.1 - gap.0 + 1).sum::<u64>()
    );
    // IMU samples never give way.
    assert!(contents.gaps_of("left_shoulder/imu").is_empty());
    assert!(stored > 0 && samples > 0, "{stored}, {samples}");
    let checked = contents.decode("left_shoulder", |frame, picture| {
        assert_eq!(read_counter(picture), Some(frame.number));
        Ok(())
    });
    checked.expect("decoding");
    contents.check_times().expect("times");
}
