//! An encoder that cannot keep up, in real time. Alone in its file: it takes the whole machine.

use capture_daemon::sources::synthetic::read_counter;
use session_archive::record::paws::gap::Cause;
use session_archive::verify::verify;
use tests::contents::{Contents, open};
use tests::rig::{Rig, in_real_time};
use video::encoder::MAX_IN_FLIGHT;

#[test]
fn an_encoder_that_is_too_slow_loses_whole_frames_and_says_so() {
    // Several times what one thread can do.
    let rig = Rig {
        width: 1344,
        height: 752,
        rate_hz: 120.0,
        encoder: "x265enc",
        ..Rig::small(1)
    };
    if let Err(reason) = video::discover::trial(rig.encoder, rig.width, rig.height) {
        return eprintln!("skipped: {}: {reason}", rig.encoder);
    }
    let folder = tempfile::tempdir().expect("folder");
    let finished = rig
        .record(&in_real_time(1.5, folder.path()))
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
    assert!(finished.missing > 0, "the encoder was not too slow");
    // What was inside the encoder when the session had to be closed came too late.
    let causes = [Cause::EncoderOverload as i32, Cause::Late as i32];
    assert!(gaps.iter().all(|gap| causes.contains(&gap.2)), "{gaps:?}");
    assert!(gaps.iter().any(|gap| gap.2 == causes[0]), "{gaps:?}");
    let late = gaps
        .iter()
        .filter(|gap| gap.2 == causes[1])
        .map(|gap| gap.1 - gap.0 + 1);
    assert!(late.sum::<u64>() <= MAX_IN_FLIGHT as u64, "{gaps:?}");
    assert_eq!(
        finished.missing,
        gaps.iter().map(|gap| gap.1 - gap.0 + 1).sum::<u64>()
    );
    // IMU samples never give way, and both streams have the same length.
    assert!(contents.gaps_of("left_shoulder/imu").is_empty());
    let seconds = (stored + finished.missing) as f64 / rig.rate_hz;
    let of_imu = samples as f64 / rig.imu_rate_hz;
    assert!(
        seconds >= 1.4 && (seconds - of_imu).abs() < 0.15,
        "{seconds} s, IMU {of_imu} s"
    );
    let checked = contents.decode("left_shoulder", |frame, picture| {
        assert_eq!(read_counter(picture), Some(frame.number));
        Ok(())
    });
    checked.expect("decoding");
    contents.check_times().expect("times");
}
