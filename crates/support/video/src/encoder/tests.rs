//! Tests of what only this crate can see: where the pixels are.

use std::sync::Mutex;

use super::*;
use crate::capture::{Capture, CaptureEvent, CaptureSettings, Content, Delivery};
use crate::{NativeFrame, annexb};

/// Reached only when something hangs.
const LONG: Duration = Duration::from_secs(600);

fn settings(element: &str) -> EncoderSettings {
    EncoderSettings {
        element: element.into(),
        width: 320,
        height: 64,
        rate_hz: 30.0,
        quality_db: 42.0,
        threads: 1,
        max_key_interval_frames: 1000,
        preset: crate::encoder::Preset::default(),
    }
}

/// Where a buffer's bytes are.
fn address(buffer: &gst::BufferRef) -> usize {
    buffer.map_readable().unwrap().as_slice().as_ptr() as usize
}

/// The addresses of every buffer that goes through `pad`.
fn watch(pad: &gst::Pad) -> Arc<Mutex<Vec<usize>>> {
    let seen: Arc<Mutex<Vec<usize>>> = Arc::default();
    let noting = seen.clone();
    pad.add_probe(gst::PadProbeType::BUFFER, move |_, info| {
        if let Some(buffer) = info.buffer() {
            lock(&noting).push(address(buffer));
        }
        gst::PadProbeReturn::Ok
    });
    seen
}

/// `count` native frames of a pattern that moves, as a camera at 100 Hz would give them.
fn frames(layout: &str, count: u64) -> Vec<NativeFrame> {
    pipeline::init().unwrap();
    let caps = format!("video/x-raw,format={layout},width=320,height=64,framerate=100/1");
    let format = NativeFormat::new(&caps.parse().unwrap()).unwrap();
    let frame = |number: u64| {
        let byte = |at: usize| (64 + (at % 320 / 4 + at / 1280 + number as usize) % 128) as u8;
        let data: Vec<u8> = (0..format.bytes()).map(byte).collect();
        let mut buffer = gst::Buffer::from_mut_slice(data);
        let time = gst::ClockTime::from_nseconds(5_000_000_000 + number * 10_000_000);
        buffer.get_mut().unwrap().set_pts(time);
        NativeFrame::new(buffer, format.clone()).unwrap()
    };
    (0..count).map(frame).collect()
}

fn encode(settings: &EncoderSettings, frames: &[NativeFrame]) -> (Vec<AccessUnit>, Vec<usize>) {
    let units: Arc<Mutex<Vec<AccessUnit>>> = Arc::default();
    let collecting = units.clone();
    let on_output = move |event| match event {
        EncoderEvent::AccessUnit(unit) => lock(&collecting).push(unit),
        EncoderEvent::Failed(reason) => panic!("{reason}"),
    };
    let mut encoder =
        Encoder::start_native(settings, frames[0].format(), Box::new(on_output)).unwrap();
    let seen = watch(&encoder.element.static_pad("sink").unwrap());
    for (number, frame) in frames.iter().enumerate() {
        let time = 777_000_000_001 + number as i64 * 10_000_003;
        encoder.push(time, frame, number == 5).unwrap();
        assert!(encoder.queued_bytes() <= MAX_NATIVE_IN_FLIGHT * frame.bytes());
    }
    encoder.finish(LONG).unwrap();
    (
        std::mem::take(&mut lock(&units)),
        std::mem::take(&mut lock(&seen)),
    )
}

#[test]
fn nothing_is_copied_on_the_way_into_an_encoder_that_takes_the_layout() {
    let frames = frames("NV12", 12);
    let given: Vec<usize> = frames.iter().map(|frame| address(frame.buffer())).collect();
    let (units, arrived) = encode(&settings("x264enc"), &frames);
    assert_eq!(arrived, given);
    // And the rest of the promise: every frame, its time, its key frames.
    let times: Vec<i64> = units.iter().map(|unit| unit.pts_ns).collect();
    let expected: Vec<i64> = (0..12).map(|n| 777_000_000_001 + n * 10_000_003).collect();
    assert_eq!(times, expected);
    let keys: Vec<usize> = (0..12).filter(|&number| units[number].key).collect();
    assert_eq!(keys, [0, 5]);
    assert!(annexb::has_parameter_sets(Codec::H264, &units[5].data));
}

#[test]
fn nothing_is_copied_between_the_camera_and_its_taker() {
    use gst::prelude::*;
    pipeline::init().unwrap();
    // The same way as a capture goes, with a probe where a camera's buffers leave it.
    let mut given = None;
    let settings = CaptureSettings {
        delivery: Delivery::Native,
        ..CaptureSettings::new(
            "videotestsrc name=camera is-live=true num-buffers=20 ! video/x-raw,format=NV12,framerate=30/1 ! queue",
            320,
            64,
            100.0,
        )
    };
    let mut capture = Capture::start_with(&settings, Arc::new(|| 0), |camera| {
        let pad = camera.by_name("camera").unwrap().static_pad("src").unwrap();
        given = Some(watch(&pad));
    })
    .unwrap();
    let mut taken = Vec::new();
    let mut previous = 0;
    while let Some(event) = capture.next(LONG) {
        let frame = match event {
            CaptureEvent::Frame(frame) => frame,
            // On a busy machine this test itself may be late.
            CaptureEvent::Lost(_) => continue,
            CaptureEvent::Ended => break,
            other => panic!("{other:?}"),
        };
        let Content::Native(native) = frame.content else {
            panic!("a frame");
        };
        // The buffer itself carries the host's time.
        assert_eq!(native.stamp_ns(), frame.clock_time_ns);
        assert!(native.stamp_ns() > previous);
        previous = native.stamp_ns();
        // Nobody else refers to it, so dropping it gives it back.
        assert!(native.buffer().is_writable());
        taken.push((frame.number, address(native.buffer())));
    }
    let given = given.unwrap();
    let given = lock(&given);
    assert!(!taken.is_empty());
    for (number, address) in taken {
        assert_eq!(address, given[number as usize]);
    }
}

#[test]
fn layouts_that_an_encoder_does_not_take_are_converted() {
    // x265enc 1.22 takes no NV12, nothing takes YUY2.
    for (element, format) in [("x265enc", "NV12"), ("x264enc", "YUY2")] {
        let frames = frames(format, 8);
        let given: Vec<usize> = frames.iter().map(|frame| address(frame.buffer())).collect();
        let (units, arrived) = encode(&settings(element), &frames);
        assert_eq!(units.len(), 8, "{element} {format}");
        assert!(arrived.iter().all(|arrived| !given.contains(arrived)));
    }
}

#[test]
fn native_and_copied_frames_decode_to_the_same() {
    let frames = frames("NV12", 6);
    let (native, _) = encode(&settings("x264enc"), &frames);
    let mut decoder = crate::Decoder::new(Codec::H264);
    for ((_, decoded), frame) in decoder.decode(&native).unwrap().iter().zip(&frames) {
        let original = frame.to_image().unwrap();
        let psnr = crate::raw_image::psnr(&original, decoded);
        assert!(psnr > 40.0, "{psnr} dB");
    }
}

#[test]
fn frames_that_do_not_fit_are_refused() {
    let frames = frames("NV12", 3);
    let image = frames[0].to_image().unwrap();
    let ignore = || Box::new(|_: EncoderEvent| ());
    let wide = EncoderSettings {
        width: 640,
        ..settings("x264enc")
    };
    assert!(matches!(
        Encoder::start_native(&wide, frames[0].format(), ignore()),
        Err(EncodeError::WrongSize { .. })
    ));
    let mut encoder =
        Encoder::start_native(&settings("x264enc"), frames[0].format(), ignore()).unwrap();
    assert!(matches!(
        encoder.push(1, &image, false),
        Err(EncodeError::WrongInput { .. })
    ));
    encoder.push(2, &frames[1], false).unwrap();
    // An older one, as from a source that repeats itself, though its given time rises.
    assert!(matches!(
        encoder.push(3, &frames[0], false),
        Err(EncodeError::Discontinuity { .. })
    ));
    encoder.push(3, &frames[2], false).unwrap();
    encoder.finish(LONG).unwrap();
    let mut images = Encoder::start(&settings("x264enc"), ignore()).unwrap();
    assert!(matches!(
        images.push(1, &frames[0], false),
        Err(EncodeError::WrongInput { .. })
    ));
    images.push(1, &image, false).unwrap();
}

#[test]
fn quality_changes_only_where_the_element_takes_it() {
    let ignore = Box::new(|_: EncoderEvent| ());
    let mut encoder = Encoder::start(&settings("x264enc"), ignore).unwrap();
    let before = encoder.quantiser();
    assert!(matches!(
        encoder.set_quality(f64::NAN),
        Err(EncodeError::Settings(_))
    ));
    assert_eq!(encoder.set_quality(36.0), Ok(false));
    assert_eq!(encoder.quantiser(), before);
    // What it has already is no change.
    assert_eq!(encoder.set_quality(42.0), Ok(true));
    // An element that does: x264enc takes a bit rate while it runs.
    let element = pipeline::make("x264enc").unwrap();
    let kind = Kind {
        properties: &[kinds::Property {
            names: &["no-such-property", "bitrate"],
            value: "{qp}",
            need: kinds::Need::Must,
        }],
        ..*kinds::find("x264enc").unwrap()
    };
    assert_eq!(chain::adjust(&element, &kind, 33), Ok(true));
    assert_eq!(element.property::<u32>("bitrate"), 33);
}
