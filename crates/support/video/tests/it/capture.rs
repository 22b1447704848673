//! Cameras that come through GStreamer, with test sources in their place.

use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use crate::PATIENCE;
use video::capture::{
    Capture, CaptureError, CaptureEvent, CaptureSettings, CapturedFrame, Cause, Content, Counts,
    Delivery, Eye, HostClock, LostFrames, QUEUE,
};
use video::{AccessUnit, Encoder, EncoderEvent, EncoderSettings, RawImage};

const LIVE: &str = "videotestsrc is-live=true";

#[expect(clippy::disallowed_methods, reason = "the clock that is compared with")]
fn monotonic_ns() -> i64 {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    time.tv_sec * 1_000_000_000 + time.tv_nsec
}

#[expect(
    clippy::disallowed_methods,
    reason = "how long it takes is the question"
)]
fn elapsed(work: impl FnOnce()) -> Duration {
    let begin = Instant::now();
    work();
    begin.elapsed()
}

fn clock() -> HostClock {
    Arc::new(monotonic_ns)
}

fn settings(chain: &str) -> CaptureSettings {
    CaptureSettings::new(chain, 64, 32, 100.0)
}

fn start(chain: &str) -> Capture {
    Capture::start(&settings(chain), clock()).unwrap()
}

/// Events of a capture until it has delivered this number of frames.
fn until(mut capture: Capture, frames: usize) -> (Vec<CaptureEvent>, Counts) {
    let mut events = Vec::new();
    while self::frames(&events).len() < frames {
        match capture.next(PATIENCE).expect("a frame") {
            event @ (CaptureEvent::Frame(_) | CaptureEvent::Lost(_)) => events.push(event),
            end => panic!("{end:?}"),
        }
    }
    (events, capture.counts())
}

/// Everything that a capture says until its end, and the end.
fn all(mut capture: Capture) -> (Vec<CaptureEvent>, CaptureEvent, Counts) {
    let mut events = Vec::new();
    loop {
        match capture.next(PATIENCE).expect("an end") {
            event @ (CaptureEvent::Frame(_) | CaptureEvent::Lost(_)) => events.push(event),
            end => return (events, end, capture.counts()),
        }
    }
}

fn frames(events: &[CaptureEvent]) -> Vec<&CapturedFrame> {
    let frames = events.iter().filter_map(|event| match event {
        CaptureEvent::Frame(frame) => Some(frame),
        _ => None,
    });
    frames.collect()
}

fn image(frame: &CapturedFrame) -> &RawImage {
    match &frame.content {
        Content::RawImage(image) => image,
        Content::Native(frame) => panic!("{frame:?}"),
    }
}

#[test]
fn times_are_exact_on_the_host_s_clock() {
    let before = monotonic_ns();
    let capture = start(&format!(
        "{LIVE} num-buffers=40 ! video/x-raw,framerate=100/1"
    ));
    assert_eq!(capture.element(), "videotestsrc");
    let (events, end, counts) = all(capture);
    assert!(matches!(end, CaptureEvent::Ended), "{end:?}");
    let frames = frames(&events);
    // On a busy machine this test itself may be late.
    assert_eq!(frames.len() as u64, counts.delivered);
    assert_eq!(counts.delivered + counts.overrun, 40);
    let base = frames[0].clock_time_ns - frames[0].pts_running_ns;
    assert!((before..monotonic_ns()).contains(&base), "{before} {base}");
    let first = (frames[0].number, frames[0].pts_running_ns);
    for frame in &frames {
        let since = (frame.number - first.0) as i64;
        assert_eq!(frame.pts_running_ns, first.1 + since * 10_000_000);
        assert_eq!(frame.clock_time_ns, base + frame.pts_running_ns);
        // A live source gives a frame when its time has come, by the same clock.
        assert!(frame.host_time_ns >= frame.clock_time_ns);
        assert!(!frame.repeated);
    }
    // Stamped as it leaves: the difference is the latency of the chain.
    let (events, ..) = all(start(&format!(
        "{LIVE} num-buffers=40 do-timestamp=true ! video/x-raw,framerate=100/1"
    )));
    let late = self::frames(&events)
        .iter()
        .map(|frame| frame.host_time_ns - frame.clock_time_ns)
        .min();
    assert!(late.is_some_and(|late| late >= 0), "{late:?}");
}

#[test]
fn frames_that_are_lost_in_front_are_holes_in_the_numbers() {
    // The nominal rate has to be that of the source: a hole behind the first frame counts only if
    // there was time.
    let settings = CaptureSettings {
        rate_hz: 200.0,
        ..settings(&format!(
            "{LIVE} num-buffers=100 ! video/x-raw,framerate=200/1 ! identity drop-probability=0.3"
        ))
    };
    let (events, _, counts) = all(Capture::start(&settings, clock()).unwrap());
    let numbers: Vec<u64> = frames(&events).iter().map(|frame| frame.number).collect();
    assert!(!numbers.is_empty() && numbers.is_sorted_by(|a, b| a < b));
    let span = numbers[numbers.len() - 1] - numbers[0] + 1;
    let came = counts.delivered + counts.overrun;
    // Of those behind the last frame that was taken, some may have been dropped as too many.
    assert!(
        (span.saturating_sub(came)..=100 - came).contains(&counts.missing),
        "{counts:?}"
    );
    // Of a hundred, some are lost in front of one that comes, but for once in 10^15 runs.
    assert!(counts.missing > 0, "{counts:?}");
    assert_eq!(counts.repeated, 0);
    let frames = frames(&events);
    for frame in &frames {
        let since = (frame.number - frames[0].number) as i64;
        assert_eq!(
            frame.pts_running_ns,
            frames[0].pts_running_ns + since * 5_000_000
        );
    }
}

#[test]
fn colours_and_layouts_arrive_as_images() {
    let mut images = Vec::new();
    for format in ["I420", "NV12", "YUY2", "UYVY"] {
        // A width that GStreamer pads.
        let chain = format!("{LIVE} num-buffers=1 pattern=smpte ! video/x-raw,format={format}");
        let settings = CaptureSettings::new(&chain, 60, 32, 30.0);
        let (events, ..) = all(Capture::start(&settings, clock()).unwrap());
        images.push(image(frames(&events)[0]).clone());
    }
    let (expected, others) = images.split_first().unwrap();
    for found in others {
        // Chroma of 4:2:2 may be rounded otherwise at edges.
        assert_eq!(found.luma().unwrap(), expected.luma().unwrap());
        let chroma = expected.data.iter().zip(&found.data);
        assert!(chroma.skip(60 * 32).all(|(a, b)| a.abs_diff(*b) <= 1));
    }
}

#[test]
fn a_failed_element_is_reported_after_the_frames() {
    let (events, end, _) = all(start(&format!(
        "{LIVE} ! video/x-raw,framerate=100/1 ! identity name=culprit error-after=5"
    )));
    // The one that fails is not let through.
    assert_eq!(frames(&events).len(), 4);
    let CaptureEvent::Failed { element, reason } = end else {
        panic!("{end:?}");
    };
    assert_eq!(element, "culprit");
    assert!(!reason.is_empty());
    // And again at every call.
    let mut capture = start(&format!("{LIVE} num-buffers=1"));
    assert!(matches!(
        capture.next(PATIENCE),
        Some(CaptureEvent::Frame(_))
    ));
    for _ in 0..3 {
        assert!(matches!(capture.next(PATIENCE), Some(CaptureEvent::Ended)));
    }
}

#[test]
fn a_device_that_is_not_there_is_gone() {
    let (events, end, _) = all(start("v4l2src device=/dev/video-that-is-not-there"));
    assert!(events.is_empty());
    let CaptureEvent::Gone { element, reason } = end else {
        panic!("{end:?}");
    };
    assert!(element.starts_with("v4l2src"), "{element}");
    assert!(reason.contains("/dev/video-that-is-not-there"), "{reason}");
}

#[test]
fn what_cannot_work_is_refused_with_a_reason() {
    let refused = |settings: &CaptureSettings| Capture::start(settings, clock()).unwrap_err();
    for (chain, reason) in [
        ("no-such-camera", "no-such-camera"),
        ("videotestsrc pattern=no-such-pattern", "pattern"),
        ("videotestsrc ! fakesink", "link"),
        ("", "empty"),
        ("!", "syntax"),
        ("identity", "source"),
        ("videotestsrc ! video/x-raw,width=32", "width=(int)64"),
        ("videotestsrc ! jpegenc ! image/jpeg", "jpegenc"),
    ] {
        let error = refused(&settings(chain));
        assert!(matches!(error, CaptureError::Chain { .. }), "{error}");
        assert!(error.to_string().contains(reason), "{chain}: {error}");
    }
    for rate_hz in [0.0, -1.0, f64::NAN, 2000.0] {
        let settings = CaptureSettings {
            rate_hz,
            ..settings(LIVE)
        };
        assert!(matches!(refused(&settings), CaptureError::Settings(_)));
    }
    let odd = CaptureSettings::new(LIVE, 63, 32, 30.0);
    assert!(matches!(refused(&odd), CaptureError::Settings(_)));
    let native_eyes = CaptureSettings {
        right_chain: Some(LIVE.into()),
        delivery: Delivery::Native,
        ..settings(LIVE)
    };
    assert!(matches!(refused(&native_eyes), CaptureError::Settings(_)));
    // Only known once the chain runs.
    let failed = |chain: &str| match all(start(chain)).1 {
        CaptureEvent::Failed { reason, .. } => reason,
        other => panic!("{other:?}"),
    };
    let reason = failed("videotestsrc num-buffers=10");
    assert!(reason.contains("is-live"), "{reason}");
    // One that finds out when it sees the frames.
    let reason = failed(&format!("{LIVE} ! video/x-raw,width=32 ! decodebin"));
    assert!(reason.contains("64"), "{reason}");
}

#[test]
fn a_camera_that_says_nothing_holds_nobody_up() {
    let mut capture = start("appsrc is-live=true format=time");
    let took = elapsed(|| {
        assert!(capture.next(Duration::from_millis(50)).is_none());
        assert!(capture.next(Duration::ZERO).is_none());
    });
    assert!(took >= Duration::from_millis(50));
    drop(capture);
    // Stuck in a driver, as it looks from outside: a frame that takes an hour.
    let mut capture = start(&format!("{LIVE} ! identity sleep-time=3600000000"));
    assert!(capture.next(Duration::from_millis(200)).is_none());
    drop(capture);
}

#[test]
fn a_taker_that_is_late_loses_new_frames_and_knows_which() {
    let mut capture = start(&format!(
        "{LIVE} num-buffers=60 ! video/x-raw,framerate=200/1"
    ));
    let mut events = Vec::new();
    // The first frame, then nothing while 20 more come, then everything.
    events.push(capture.next(PATIENCE).unwrap());
    let (never, gate) = (std::sync::Condvar::new(), Mutex::new(()));
    while capture.counts().overrun < 20 {
        let guard = gate.lock().unwrap();
        drop(never.wait_timeout(guard, Duration::from_millis(5)).unwrap());
    }
    let (rest, end, counts) = all(capture);
    events.extend(rest);
    assert!(matches!(end, CaptureEvent::Ended));
    assert_eq!(counts.overrun + counts.delivered, 60);
    assert_eq!(counts.missing, 0);
    // Every number exactly once, in order, as a frame or as lost.
    let mut next = 0;
    for event in &events {
        match event {
            CaptureEvent::Frame(frame) => {
                assert_eq!(frame.number, next);
                next += 1;
            }
            &CaptureEvent::Lost(LostFrames { first, last, cause }) => {
                assert_eq!((first, cause), (next, Cause::Overrun));
                assert!(last >= first);
                next = last + 1;
            }
            other => panic!("{other:?}"),
        }
    }
    assert_eq!(next, 60);
    // What waited is what came first, also if this test was late for the first one.
    assert!(
        events[..QUEUE]
            .iter()
            .all(|event| matches!(event, CaptureEvent::Frame(_)))
    );
}

#[test]
fn a_start_can_be_put_off_and_given_up() {
    let delayed = CaptureSettings {
        start_delay: Duration::from_millis(300),
        ..settings(LIVE)
    };
    let before = monotonic_ns();
    let mut capture = Capture::start(&delayed, clock()).unwrap();
    let Some(CaptureEvent::Frame(frame)) = capture.next(PATIENCE) else {
        panic!("no frame");
    };
    assert!(frame.clock_time_ns - before >= 300_000_000);
    let never = CaptureSettings {
        start_delay: Duration::from_secs(3600),
        ..settings(LIVE)
    };
    drop(Capture::start(&never, clock()).unwrap());
}

/// Two eyes in different greys, with chroma; a number of frames of each, -1 for no end.
fn eyes(count: i32, left: &str, right: &str) -> CaptureSettings {
    CaptureSettings {
        right_chain: Some(format!(
            "{LIVE} pattern=blue num-buffers={count} ! video/x-raw,format=NV12,framerate=100/1 {right}"
        )),
        eye_delay: Duration::from_millis(30),
        ..settings(&format!(
            "{LIVE} pattern=red num-buffers={count} ! video/x-raw,format=I420,framerate=100/1 {left}"
        ))
    }
}

#[test]
fn two_eyes_become_one_frame() {
    let (events, counts) = until(Capture::start(&eyes(-1, "", ""), clock()).unwrap(), 50);
    let frames = frames(&events);
    let both = image(frames[0]);
    assert_eq!((both.width, both.height), (64, 32));
    let (left, right) = video::raw_image::split(both).unwrap();
    let solid = |image: &RawImage, plane: std::ops::Range<usize>| {
        let plane = &image.data[plane];
        assert!(plane.iter().all(|&value| value == plane[0]));
        plane[0]
    };
    let (luma, cr) = (0..32 * 32, 32 * 32 * 5 / 4..32 * 32 * 3 / 2);
    assert!(solid(&left, luma.clone()) > solid(&right, luma));
    // Red is left, blue is right.
    assert!(solid(&left, cr.clone()) > 200 && solid(&right, cr) < 128);
    let apart = frames[0].eyes_apart_ns.unwrap();
    assert!(apart.abs() <= 5_000_000, "{apart}");
    for frame in &frames {
        // Both sources are exact, so the same frames belong together all the time.
        assert_eq!(frame.eyes_apart_ns, Some(apart));
    }
    assert_eq!(counts.missing, 0);
    let (_, end, _) = all(Capture::start(&eyes(20, "", ""), clock()).unwrap());
    assert!(matches!(end, CaptureEvent::Ended), "{end:?}");
}

#[test]
fn eyes_with_lost_frames_are_still_paired_rightly() {
    let drop = "! identity drop-probability=0.2";
    let (events, counts) = until(Capture::start(&eyes(-1, drop, drop), clock()).unwrap(), 80);
    let frames = frames(&events);
    let apart = frames[0].eyes_apart_ns;
    assert!(frames.iter().all(|frame| frame.eyes_apart_ns == apart));
    assert!(frames.is_sorted_by(|a, b| a.number < b.number));
    let mut total = 0;
    for event in &events {
        if let &CaptureEvent::Lost(LostFrames { first, last, cause }) = event {
            assert!(frames.iter().all(|f| !(first..=last).contains(&f.number)));
            if matches!(cause, Cause::NoPartner(Eye::Left | Eye::Right)) {
                total += last - first + 1;
            }
        }
    }
    // Where one eye's frame comes, the other's is missing with probability 0.2: that none of them
    // is reported between 80 pairs has a probability below 1e-13.
    assert!((1..=counts.unpaired).contains(&total), "{counts:?} {total}");
}

#[test]
fn an_eye_that_fails_ends_both() {
    let (_, end, _) =
        all(Capture::start(&eyes(-1, "", "! identity error-after=20"), clock()).unwrap());
    assert!(matches!(end, CaptureEvent::Failed { .. }), "{end:?}");
    let uneven = CaptureSettings {
        width: 66,
        ..eyes(-1, "", "")
    };
    assert!(Capture::start(&uneven, clock()).is_err());
}

/// From the camera into the encoder without a copy, over a restart of the camera, with the daemon's
/// own times.
#[test]
fn native_frames_are_encoded_over_a_restart() {
    let settings = CaptureSettings {
        delivery: Delivery::Native,
        ..settings(&format!(
            "{LIVE} pattern=ball num-buffers=40 ! video/x-raw,format=NV12,framerate=30/1"
        ))
    };
    let encode = EncoderSettings {
        element: "x264enc".into(),
        width: 64,
        height: 32,
        rate_hz: 100.0,
        quality_db: 42.0,
        threads: 1,
        max_key_interval_frames: 1000,
        preset: video::encoder::Preset::default(),
    };
    let units: Arc<Mutex<Vec<AccessUnit>>> = Arc::default();
    let mut encoder = None;
    let mut given = Vec::new();
    let mut digests = std::collections::HashSet::new();
    for _ in 0..2 {
        let (events, end, counts) = all(Capture::start(&settings, clock()).unwrap());
        assert!(matches!(end, CaptureEvent::Ended), "{end:?}");
        assert_eq!(counts.delivered + counts.overrun, 40);
        // On a busy machine few are taken, but some of each.
        assert!(counts.delivered > 0);
        for frame in frames(&events) {
            let Content::Native(native) = &frame.content else {
                panic!("a frame");
            };
            digests.insert(native.digest().unwrap());
            let encoder = encoder.get_or_insert_with(|| {
                let collecting = units.clone();
                let on_output = move |event| match event {
                    EncoderEvent::AccessUnit(unit) => collecting.lock().unwrap().push(unit),
                    EncoderEvent::Failed(reason) => panic!("{reason}"),
                };
                Encoder::start_native(&encode, native.format(), Box::new(on_output)).unwrap()
            });
            // Not the frame's own time: what the clock map made of it.
            let time = frame.clock_time_ns - 12_345_678 + given.len() as i64;
            let key = given.len() % 50 == 0;
            encoder.push(time, native, key).unwrap();
            given.push((time, key));
        }
    }
    encoder.unwrap().finish(PATIENCE).unwrap();
    let units = units.lock().unwrap();
    let found: Vec<(i64, bool)> = units.iter().map(|unit| (unit.pts_ns, unit.key)).collect();
    assert_eq!(found, given);
    assert!(digests.len() > given.len() / 3, "{} digests", digests.len());
}
