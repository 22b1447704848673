//! Camera encoders with a real encoder at a small size.

use std::sync::{Arc, Mutex};

use super::restarts::RETRY_NS;
use super::*;
use video::capture::{Capture, CaptureEvent, CaptureSettings, Content, Delivery};
use video::encoder::Preset;
use video::{NativeFrame, PixelFormat, RawImage};

const MS: i64 = 1_000_000;
/// Room for forty small frames.
const CAPACITY: usize = 40 * 64 * 32 * 3 / 2;
/// Reached only if a thread is stuck.
const LONG: Duration = Duration::from_secs(600);

fn settings() -> EncoderSettings {
    EncoderSettings {
        element: "x264enc".to_owned(),
        width: 64,
        height: 32,
        rate_hz: 30.0,
        quality_db: 40.0,
        threads: 1,
        max_key_interval_frames: 30,
        preset: video::encoder::Preset::default(),
    }
}

fn image(n: u64, width: u32, height: u32) -> RawImage {
    let size = PixelFormat::I420.bytes(width, height).expect("even");
    let data = (0..size)
        .map(|i| (i as u64 * 7 + n * 13) as u8)
        .collect::<Vec<_>>();
    RawImage::new(width, height, PixelFormat::I420, data).expect("image")
}

/// Frames of a camera in its own buffers.
fn natives(width: u32, height: u32, count: usize) -> Vec<NativeFrame> {
    let rate_hz = 200.0;
    let chain = format!(
        "videotestsrc is-live=true ! video/x-raw,format=NV12,width={width},height={height},framerate=200/1"
    );
    let settings = CaptureSettings {
        delivery: Delivery::Native,
        ..CaptureSettings::new(&chain, width, height, rate_hz)
    };
    let mut capture = Capture::start(&settings, Arc::new(|| 0)).expect("a camera");
    let mut natives = Vec::new();
    while natives.len() < count {
        match capture.next(Duration::from_secs(60)) {
            Some(CaptureEvent::Frame(frame)) => match frame.content {
                Content::Native(native) => natives.push(native),
                other => panic!("{other:?}"),
            },
            Some(CaptureEvent::Lost(_)) => {}
            other => panic!("{other:?}"),
        }
    }
    natives
}

fn frame(number: u64) -> Frame {
    let time = 5_000 * MS + number as i64 * 33 * MS;
    Frame {
        number,
        time,
        host_time: time,
        ..Frame::default()
    }
}

/// Output: number and whether it is a key frame, or the cause of the drop.
type Outputs = Arc<Mutex<Vec<(u64, Result<bool, Cause>)>>>;

fn encoder() -> (CameraEncoder, Outputs) {
    let seen: Outputs = Arc::default();
    let out = seen.clone();
    let sink: Sink = Arc::new(move |encoded| {
        let mut out = out.lock().expect("seen");
        match encoded {
            EncoderOutput::Frame { frame, unit, key } => {
                assert!(!unit.is_empty());
                out.push((frame.number, Ok(key)));
            }
            EncoderOutput::Dropped {
                first, last, cause, ..
            } => {
                out.extend((first..=last).map(|n| (n, Err(cause))));
            }
        }
    });
    (
        CameraEncoder::new(settings(), 500 * MS, CAPACITY, sink),
        seen,
    )
}

#[test]
fn key_frames_are_at_chunk_boundaries() {
    let (mut encoder, seen) = encoder();
    for n in 0..40 {
        encoder.push_and_wait(frame(n), &image(n, 64, 32), HostTime(0));
    }
    let seen = seen.lock().expect("seen").clone();
    assert_eq!(
        seen.iter().map(|s| s.0).collect::<Vec<_>>(),
        (0..40).collect::<Vec<_>>()
    );
    let keys: Vec<u64> = seen
        .iter()
        .filter(|s| s.1 == Ok(true))
        .map(|s| s.0)
        .collect();
    assert_eq!(
        keys,
        [0, 16, 31],
        "first frames at or after 0, 500 and 1000 ms"
    );
}

/// x264enc changes its quality only at a start. Frames inside the old encoder come first.
#[test]
fn encoder_is_replaced_for_another_quality() {
    let (mut encoder, seen) = encoder();
    for n in 0..40 {
        encoder.reduce_effort(EffortReduction {
            quality: (8..24).contains(&n),
            preset: false,
        });
        let image = image(n, 64, 32);
        // Two are still inside when the chunk ends.
        if matches!(n, 14..=16 | 29..=31) {
            encoder.push(frame(n), &image, HostTime(0));
        } else {
            encoder.push_and_wait(frame(n), &image, HostTime(0));
        }
        let quality = encoder.running.as_ref().map(|r| r.effort.quality_db);
        let degraded = 16..31;
        assert_eq!(
            quality,
            Some(if degraded.contains(&n) { 36.0 } else { 40.0 })
        );
    }
    encoder.finish(RemainingFrames::Encode, LONG, HostTime(0));
    assert!(!encoder.is_failing());
    let keys = [0, 16, 31];
    let expected: Vec<_> = (0..40).map(|n| (n, Ok(keys.contains(&n)))).collect();
    assert_eq!(*seen.lock().expect("seen"), expected);
}

#[test]
fn failed_encoder_is_replaced_and_its_frames_are_reported() {
    let (mut encoder, seen) = encoder();
    encoder.push_and_wait(frame(0), &image(0, 64, 32), HostTime(0));
    encoder.push_and_wait(frame(1), &image(1, 32, 32), HostTime(0)); // not its configured size
    assert!(encoder.is_failing());
    encoder.push_and_wait(frame(2), &image(2, 64, 32), HostTime(0));
    let seen = seen.lock().expect("seen").clone();
    assert_eq!(
        seen,
        [
            (0, Ok(true)),
            (1, Err(Cause::EncoderRestart)),
            (2, Ok(true))
        ]
    );
}

#[test]
fn encoder_that_cannot_start_drops_frames_and_is_retried() {
    let (mut encoder, seen) = encoder();
    encoder.settings.element = "noenc".to_owned();
    let second = 1000 * MS;
    let push = |encoder: &mut CameraEncoder, n, now| {
        encoder.push_and_wait(frame(n), &image(n, 64, 32), HostTime(now));
    };
    push(&mut encoder, 0, second);
    push(&mut encoder, 1, second);
    encoder.settings.element = "x264enc".to_owned();
    push(&mut encoder, 2, second + RETRY_NS - 1);
    push(&mut encoder, 3, second + RETRY_NS);
    let dropped = Err(Cause::EncoderRestart);
    assert_eq!(
        *seen.lock().expect("seen"),
        [(0, dropped), (1, dropped), (2, dropped), (3, Ok(true))]
    );
}

/// An encoder that starts and fails at its first image costs a pipeline for each start.
#[test]
fn repeated_failures_back_off_and_are_reset_after_success() {
    let (mut encoder, seen) = encoder();
    let bad = |encoder: &mut CameraEncoder, n, now| {
        encoder.push_and_wait(frame(n), &image(n, 32, 32), HostTime(now));
        encoder.retry_at.0 - now
    };
    let good = |encoder: &mut CameraEncoder, n, now| {
        encoder.push_and_wait(frame(n), &image(n, 64, 32), HostTime(now));
    };
    let mut now = RETRY_NS;
    let mut pauses = Vec::new();
    for n in 0..8 {
        let pause = bad(&mut encoder, n, now);
        pauses.push(pause / RETRY_NS);
        now += pause;
    }
    assert_eq!(pauses, [0, 1, 2, 4, 8, 16, 32, 32]);
    good(&mut encoder, 8, now);
    encoder.tick(HostTime(now));
    assert!(encoder.is_failing(), "it has only just started");
    good(&mut encoder, 9, now + FAILURE_RESET_NS + 1);
    encoder.tick(HostTime(now + FAILURE_RESET_NS + 1));
    assert!(!encoder.is_failing());
    let seen = seen.lock().expect("seen");
    assert_eq!(seen.iter().filter(|s| s.1.is_ok()).count(), 2);
}

#[test]
fn number_of_stuck_encoders_is_bounded() {
    let (mut encoder, seen) = encoder();
    let (release, stuck) = std::sync::mpsc::sync_channel::<()>(0);
    let stuck = Arc::new(Mutex::new(stuck));
    for _ in 0..MAX_ENDING_ENCODERS {
        let stuck = stuck.clone();
        let ending = std::thread::spawn(move || {
            let _ = stuck.lock().expect("stuck").recv();
        });
        encoder.ending.push(ending);
    }
    encoder.tick(HostTime(0));
    let one = image(0, 64, 32);
    encoder.capacity = one.data.len();
    encoder.push(frame(0), &one, HostTime(0));
    encoder.push(frame(1), &one, HostTime(0));
    let dropped = (1, Err(Cause::EncoderRestart));
    assert_eq!(*seen.lock().expect("seen"), [dropped], "one has room");
    assert!(encoder.running.is_none());
    assert_eq!(encoder.take_fill(), 0.0, "nothing is too slow");
    drop(release);
    for ending in encoder.ending.drain(..) {
        ending.join().expect("ending");
    }
    encoder.feed(HostTime(0));
    encoder.finish(
        RemainingFrames::Encode,
        Duration::from_secs(10),
        HostTime(0),
    );
    assert_eq!(*seen.lock().expect("seen"), [dropped, (0, Ok(true))]);
}

#[test]
fn queued_frames_survive_an_encoder_restart() {
    let (mut encoder, seen) = encoder();
    let second = 1000 * MS;
    encoder.retry_at = HostTime(second);
    for n in 0..20 {
        encoder.push(frame(n), &image(n, 64, 32), HostTime(0));
    }
    encoder.tick(HostTime(second - 1));
    assert_eq!(*seen.lock().expect("seen"), []);
    encoder.tick(HostTime(second));
    assert!(encoder.is_running());
    encoder.finish(
        RemainingFrames::Encode,
        Duration::from_secs(10),
        HostTime(second),
    );
    let seen = seen.lock().expect("seen").clone();
    assert!(seen.iter().map(|s| s.0).eq(0..20), "{seen:?}");
    assert!(seen.iter().all(|s| s.1.is_ok()), "{seen:?}");
}

/// So that the draining thread can do other work meanwhile, and does not wait for an encoder that
/// may never recover.
#[test]
fn draining_does_not_block() {
    let (mut encoder, seen) = encoder();
    // Encoding a frame takes much longer than pushing it.
    (encoder.settings.width, encoder.settings.height) = (1344, 376);
    let image = image(0, 1344, 376);
    encoder.capacity = 100 * image.data.len();
    for n in 0..100 {
        encoder.push(frame(n), &image, HostTime(0));
    }
    assert!(
        !encoder.drain(HostTime(0)),
        "the encoder has no room for all"
    );
    while !encoder.drain(HostTime(0)) {
        std::thread::yield_now();
    }
    encoder.finish(
        RemainingFrames::Encode,
        Duration::from_secs(60),
        HostTime(0),
    );
    assert!(!encoder.is_running());
    let all: Vec<_> = std::mem::take(&mut *seen.lock().expect("seen"));
    assert!(all.iter().map(|s| s.0).eq(0..100), "{all:?}");
    assert!(all.iter().all(|s| s.1.is_ok()), "{all:?}");
    encoder.retry_at = HostTime(1);
    encoder.push(frame(100), &image, HostTime(0));
    assert!(encoder.drain(HostTime(0)));
    let dropped = (100, Err(Cause::EncoderRestart));
    assert_eq!(*seen.lock().expect("seen"), [dropped]);
}

/// They cannot wait, so the queue does not show the overload.
#[test]
fn rejected_native_frames_count_as_a_full_queue() {
    let (mut encoder, seen) = encoder();
    // Encoding a frame takes much longer than pushing it.
    (encoder.settings.width, encoder.settings.height) = (1344, 376);
    for (n, native) in natives(1344, 376, 40).iter().enumerate() {
        encoder.push(frame(n as u64), native, HostTime(0));
    }
    assert_eq!(encoder.take_fill(), 1.0);
    assert_eq!(encoder.take_fill(), 0.0, "none since");
    encoder.finish(
        RemainingFrames::Encode,
        Duration::from_secs(20),
        HostTime(0),
    );
    let seen = seen.lock().expect("seen");
    assert!(seen.iter().any(|s| s.1 == Err(Cause::EncoderOverload)));
}

/// However fast frames arrive: each is delivered or reported, exactly once, in order.
#[test]
fn overload_drops_and_reports_whole_frames() {
    let (mut encoder, seen) = encoder();
    // Encoding a frame takes much longer than pushing it.
    (encoder.settings.width, encoder.settings.height) = (1344, 376);
    let image = image(0, 1344, 376);
    for n in 0..100 {
        encoder.push(frame(n), &image, HostTime(0));
    }
    encoder.finish(RemainingFrames::Encode, LONG, HostTime(0));
    let mut seen = seen.lock().expect("seen").clone();
    let out: Vec<u64> = seen.iter().filter(|s| s.1.is_ok()).map(|s| s.0).collect();
    assert!(out.is_sorted());
    let dropped = seen
        .iter()
        .filter(|s| s.1 == Err(Cause::EncoderOverload))
        .count();
    assert!(dropped > 0);
    assert_eq!(out.len() + dropped, 100);
    seen.sort_unstable_by_key(|s| s.0);
    assert_eq!(
        seen.iter().map(|s| s.0).collect::<Vec<_>>(),
        (0..100).collect::<Vec<_>>()
    );
}

/// Frames that arrive faster than they are encoded are queued as long as there is room, and then
/// encoded in order.
#[test]
fn frames_queue_before_a_slow_encoder() {
    let (mut encoder, seen) = encoder();
    (encoder.settings.width, encoder.settings.height) = (1344, 376);
    let image = image(0, 1344, 376);
    encoder.capacity = 100 * image.data.len();
    for n in 0..100 {
        encoder.push(frame(n), &image, HostTime(0));
    }
    assert!(encoder.take_fill() <= 1.0 && encoder.queued_bytes() <= 108 * image.data.len());
    encoder.finish(RemainingFrames::Encode, LONG, HostTime(0));
    assert_eq!(encoder.take_fill(), 0.0);
    let seen = seen.lock().expect("seen").clone();
    assert!(seen.iter().all(|s| s.1.is_ok()), "{seen:?}");
    assert!(seen.iter().map(|s| s.0).eq(0..100));
}

/// When nobody stores them any more, queued frames are reported and not encoded.
#[test]
fn unwanted_frames_are_not_encoded_at_the_end() {
    let (mut encoder, seen) = encoder();
    (encoder.settings.width, encoder.settings.height) = (1344, 376);
    let image = image(0, 1344, 376);
    encoder.capacity = 100 * image.data.len();
    for n in 0..100 {
        encoder.push(frame(n), &image, HostTime(0));
    }
    let waiting = encoder.waiting.len();
    encoder.finish(RemainingFrames::Drop, LONG, HostTime(0));
    let seen = seen.lock().expect("seen").clone();
    assert_eq!(seen.len(), 100);
    let late = seen.iter().filter(|s| s.1 == Err(Cause::Late)).count();
    assert_eq!(late, waiting);
}

/// Overload reduces the encoder's effort at a chunk boundary, without dropping a frame.
#[test]
fn faster_preset_takes_effect_at_the_next_chunk() {
    let (mut encoder, seen) = encoder();
    encoder.settings.preset = Preset::Veryfast;
    for n in 0..40 {
        let preset = n >= 8;
        encoder.reduce_effort(EffortReduction {
            preset,
            quality: false,
        });
        encoder.push(frame(n), &image(n, 64, 32), HostTime(0));
        if let Some(running) = &encoder.running
            && encoder.waiting.is_empty()
        {
            let expected = if n < 16 {
                Preset::Veryfast
            } else {
                Preset::Ultrafast
            };
            assert_eq!(running.effort.preset, expected, "at {n}");
        }
    }
    encoder.finish(RemainingFrames::Encode, LONG, HostTime(0));
    let seen = seen.lock().expect("seen").clone();
    assert!(seen.iter().map(|s| s.0).eq(0..40), "{seen:?}");
    assert!(seen.iter().all(|s| s.1.is_ok()), "{seen:?}");
}
