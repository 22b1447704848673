//! The promises of the encoder, each on every software encoder.

use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex};
use std::time::Duration;

use crate::material::{recordings, texture};
use crate::{PATIENCE, elements, encode, odd_times, settings};
use video::encoder::MAX_IN_FLIGHT;
use video::raw_image::{coded_size, psnr, without_padding};
use video::{
    AccessUnit, Codec, Decoder, EncodeError, Encoder, EncoderEvent, EncoderSettings, PixelFormat,
    RawImage, annexb,
};

/// An encoder whose events arrive in a channel; a full channel holds the encoder up.
fn start(settings: &EncoderSettings, room: usize) -> (Encoder, Receiver<EncoderEvent>) {
    let (send, receive): (SyncSender<EncoderEvent>, _) = sync_channel(room);
    let on_output = move |event| {
        // A test that is done with the encoder drops the receiver.
        let _ = send.send(event);
    };
    (
        Encoder::start(settings, Box::new(on_output)).unwrap(),
        receive,
    )
}

fn keys(units: &[AccessUnit]) -> Vec<usize> {
    (0..units.len())
        .filter(|&number| units[number].key)
        .collect()
}

#[test]
fn times_and_key_frames_are_exact() {
    let images = texture(320, 96, 40);
    let times = odd_times(images.len());
    let forced = [7, 8, 23, 39];
    for element in elements() {
        let input = times
            .iter()
            .zip(&images)
            .enumerate()
            .map(|(number, (&time, image))| (time, image, forced.contains(&number)));
        let units = encode(&settings(element, &images[0]), input);
        let codec = video::encoder::element_codec(element).unwrap();
        assert_eq!(
            units.iter().map(|unit| unit.pts_ns).collect::<Vec<_>>(),
            times,
            "{element}"
        );
        assert_eq!(keys(&units), [0, 7, 8, 23, 39], "{element}");
        for unit in &units {
            assert_eq!(annexb::is_key(codec, &unit.data), unit.key);
            assert_eq!(
                annexb::has_parameter_sets(codec, &unit.data),
                unit.key,
                "{element}"
            );
        }
        // Each group decodes on its own: it is closed.
        let mut decoder = Decoder::new(codec);
        for group in units.chunk_by(|_, next| !next.key) {
            let decoded = decoder.decode(group).unwrap();
            for ((time, image), unit) in decoded.iter().zip(group) {
                assert_eq!(*time, unit.pts_ns);
                let source = &images[times.iter().position(|other| other == time).unwrap()];
                assert!(
                    psnr(image, source) >= 39.0,
                    "{element}: {}",
                    psnr(image, source)
                );
            }
        }
    }
}

#[test]
fn key_frames_come_at_the_latest_after_the_interval() {
    let images = texture(160, 64, 25);
    for element in elements() {
        let settings = EncoderSettings {
            max_key_interval_frames: 10,
            preset: video::encoder::Preset::default(),
            ..settings(element, &images[0])
        };
        let input = images
            .iter()
            .zip(0..)
            .map(|(image, number)| (number * 1000, image, false));
        assert_eq!(keys(&encode(&settings, input)), [0, 10, 20], "{element}");
    }
}

#[test]
fn a_cut_to_another_scene_is_no_key_frame() {
    let mut images = texture(320, 192, 24);
    // The same backwards and in negative: nothing to predict from.
    for image in &mut images[12..] {
        let other: Vec<u8> = image.data.iter().rev().map(|&value| 255 - value).collect();
        image.data = other.into();
    }
    for element in elements() {
        let input = images
            .iter()
            .zip(0..)
            .map(|(image, number)| (number * 33_333_333, image, false));
        assert_eq!(
            keys(&encode(&settings(element, &images[0]), input)),
            [0],
            "{element}"
        );
    }
}

#[test]
fn an_access_unit_does_not_wait_for_the_next_image() {
    let images = texture(160, 64, 5);
    for element in elements() {
        for threads in [1, 2] {
            let settings = EncoderSettings {
                threads,
                ..settings(element, &images[0])
            };
            let (mut encoder, events) = start(&settings, 100);
            for (image, time) in images.iter().zip(0..) {
                encoder.push(time * 1_000_000, image, false).unwrap();
                let event = events.recv_timeout(PATIENCE);
                assert!(
                    matches!(&event, Ok(EncoderEvent::AccessUnit(unit)) if unit.pts_ns == time * 1_000_000),
                    "{element} with {threads} threads: {event:?}"
                );
            }
        }
    }
}

#[test]
fn same_images_same_bytes() {
    let images = texture(320, 192, 12);
    for element in elements() {
        for threads in [1, 2] {
            let settings = EncoderSettings {
                threads,
                ..settings(element, &images[0])
            };
            let run = || {
                encode(
                    &settings,
                    images
                        .iter()
                        .zip(0..)
                        .map(|(image, n)| (n * 33_333_333, image, n == 6)),
                )
            };
            assert!(run() == run(), "{element} with {threads} threads");
        }
    }
}

/// One encoder per camera, simultaneously: x265enc with other options once failed here in one run
/// of 50.
#[test]
fn encoders_side_by_side_do_not_disturb_each_other() {
    let images = texture(160, 64, 4);
    for element in elements() {
        let run = || {
            let times = (0..).map(|number| number * 33_333_333);
            let input = times.zip(&images).map(|(time, image)| (time, image, false));
            encode(&settings(element, &images[0]), input)
        };
        let alone = run();
        std::thread::scope(|scope| {
            for _ in 0..4 {
                scope.spawn(|| (0..15).for_each(|_| assert!(run() == alone, "{element}")));
            }
        });
    }
}

#[test]
fn default_quality_is_at_least_40_db() {
    let mut clips = vec![
        ("texture", texture(1344, 376, 4)),
        ("odd rows", texture(364, 182, 4)),
    ];
    clips.extend(recordings(4));
    for element in elements() {
        for (name, images) in &clips {
            let input = images
                .iter()
                .zip(0..)
                .map(|(image, n)| (n * 33_333_333, image, false));
            let units = encode(&settings(element, &images[0]), input);
            let codec = video::encoder::element_codec(element).unwrap();
            let decoded = Decoder::new(codec).decode(&units).unwrap();
            for (source, (_, image)) in images.iter().zip(&decoded) {
                let quality = psnr(source, image);
                assert!(quality >= 40.0, "{element} on {name}: {quality} dB");
            }
        }
    }
}

/// Regression: odd sizes were padded before the encoder, by everyone who records.
#[test]
fn odd_sizes_come_back_as_they_were() {
    for (width, height) in [(319, 96), (320, 95), (319, 95)] {
        let images: Vec<RawImage> = (texture(320, 96, 4).iter())
            .map(|image| without_padding(image, width, height).unwrap())
            .collect();
        for element in elements() {
            let input = images
                .iter()
                .zip(0..)
                .map(|(image, n)| (n * 33_333_333, image, false));
            let units = encode(&settings(element, &images[0]), input);
            let codec = video::encoder::element_codec(element).unwrap();
            let decoded = Decoder::new(codec).decode(&units).unwrap();
            assert_eq!(decoded.len(), images.len());
            for (source, (_, image)) in images.iter().zip(&decoded) {
                assert_eq!((image.width, image.height), coded_size(width, height));
                let image = without_padding(image, width, height).unwrap();
                let quality = psnr(source, &image);
                assert!(quality >= 40.0, "{element}, {width}x{height}: {quality} dB");
            }
        }
    }
}

#[test]
fn a_better_quality_costs_more_bytes() {
    let images = texture(320, 96, 3);
    for element in elements() {
        let bytes = |quality_db| -> usize {
            let settings = EncoderSettings {
                quality_db,
                ..settings(element, &images[0])
            };
            let input = images
                .iter()
                .zip(0..)
                .map(|(image, n)| (n * 1000, image, false));
            encode(&settings, input)
                .iter()
                .map(|unit| unit.data.len())
                .sum()
        };
        assert!(
            bytes(30.0) < bytes(36.0) && bytes(36.0) < bytes(42.0),
            "{element}"
        );
    }
}

/// The flag and the matrix in the stream itself, as an independent decoder sees them.
#[test]
fn streams_say_that_they_are_full_range() {
    use gstreamer::prelude::*;
    let image = &texture(160, 64, 1)[0];
    for (element, codec) in [("x264enc", Codec::H264), ("x265enc", Codec::H265)] {
        let unit = encode(&settings(element, image), [(0, image, false)]).remove(0);
        let (media, parser) = match codec {
            Codec::H264 => ("video/x-h264", "h264parse"),
            Codec::H265 => ("video/x-h265", "h265parse"),
        };
        let line = format!(
            "appsrc name=in format=time caps={media},stream-format=byte-stream,alignment=au \
             ! {parser} ! appsink name=out sync=false"
        );
        let pipeline = gstreamer::parse::launch(&line)
            .unwrap()
            .downcast::<gstreamer::Bin>()
            .unwrap();
        let source = pipeline
            .by_name("in")
            .unwrap()
            .downcast::<gstreamer_app::AppSrc>()
            .unwrap();
        let sink = pipeline
            .by_name("out")
            .unwrap()
            .downcast::<gstreamer_app::AppSink>()
            .unwrap();
        pipeline.set_state(gstreamer::State::Playing).unwrap();
        source
            .push_buffer(gstreamer::Buffer::from_slice(unit.data))
            .unwrap();
        source.end_of_stream().unwrap();
        let sample = sink
            .try_pull_sample(gstreamer::ClockTime::from_seconds(60))
            .unwrap();
        let caps = sample.caps().unwrap();
        let colorimetry = caps
            .structure(0)
            .unwrap()
            .get::<String>("colorimetry")
            .unwrap();
        assert_eq!(colorimetry, "1:4:7:1", "{element}: {caps}");
        pipeline.set_state(gstreamer::State::Null).unwrap();
    }
}

#[test]
fn what_cannot_be_encoded_is_refused() {
    let image = &texture(64, 32, 1)[0];
    let good = settings("x264enc", image);
    let refused = |settings: EncoderSettings| {
        Encoder::start(&settings, Box::new(|_| {})).expect_err(&format!("{settings:?}"))
    };
    for (width, height) in [(0, 32), (64, 0), (16_385, 32)] {
        refused(EncoderSettings {
            width,
            height,
            ..good.clone()
        });
    }
    for rate_hz in [0.0, -1.0, f64::NAN, f64::INFINITY] {
        let error = refused(EncoderSettings {
            rate_hz,
            ..good.clone()
        });
        assert!(matches!(error, EncodeError::Settings(_)), "{error}");
    }
    for settings in [
        EncoderSettings {
            threads: 0,
            ..good.clone()
        },
        EncoderSettings {
            quality_db: f64::NAN,
            ..good.clone()
        },
        EncoderSettings {
            max_key_interval_frames: 0,
            preset: video::encoder::Preset::default(),
            ..good.clone()
        },
        EncoderSettings {
            width: 1 << 20,
            ..good.clone()
        },
    ] {
        assert!(matches!(refused(settings), EncodeError::Settings(_)));
    }
    for element in ["no-such-encoder", "fakesink", "", "nvv4l2h265enc"] {
        if gstreamer::ElementFactory::find(element).is_some() && element.starts_with("nv") {
            continue;
        }
        let error = refused(EncoderSettings {
            element: element.into(),
            ..good.clone()
        });
        assert!(matches!(error, EncodeError::Start { .. }), "{error}");
    }
}

#[test]
fn a_refused_image_leaves_the_encoder_as_it_was() {
    let images = texture(64, 32, 2);
    let (mut encoder, events) = start(&settings("x264enc", &images[0]), 100);
    let wider = texture(66, 32, 1).remove(0);
    let grey = video::raw_image::i420_to_grey(&images[0]).unwrap();
    let short = RawImage {
        data: images[0].data.slice(1..),
        ..images[0].clone()
    };
    assert!(matches!(
        encoder.push(-1, &images[0], false),
        Err(EncodeError::Time { .. })
    ));
    encoder.push(5, &images[0], false).unwrap();
    assert!(matches!(
        encoder.push(5, &images[1], false),
        Err(EncodeError::Time { .. })
    ));
    assert!(matches!(
        encoder.try_push(4, &images[1], true),
        Err(EncodeError::Time { .. })
    ));
    assert!(matches!(
        encoder.push(6, &wider, true),
        Err(EncodeError::WrongSize { .. })
    ));
    assert!(matches!(
        encoder.push(6, &grey, true),
        Err(EncodeError::RawImage(_))
    ));
    assert!(matches!(
        encoder.push(6, &short, true),
        Err(EncodeError::RawImage(_))
    ));
    encoder.push(6, &images[1], false).unwrap();
    encoder.finish(PATIENCE).unwrap();
    let units: Vec<_> = events.iter().collect();
    assert!(
        matches!(&units[..], [EncoderEvent::AccessUnit(first), EncoderEvent::AccessUnit(second)]
        if (first.pts_ns, first.key, second.pts_ns, second.key) == (5, true, 6, false))
    );
}

#[test]
fn the_queue_is_bounded_and_says_when_it_is_full() {
    let images = texture(64, 32, 1);
    let bytes = PixelFormat::I420.bytes(64, 32).unwrap();
    // The first event fills the channel, the second holds the encoder up.
    let (mut encoder, events) = start(&settings("x264enc", &images[0]), 1);
    let mut taken = 0;
    let error = loop {
        match encoder.try_push(taken, &images[0], false) {
            Ok(()) => taken += 1,
            Err(error) => break error,
        }
        assert!(taken as usize <= MAX_IN_FLIGHT + 1, "nothing stopped it");
        assert!(encoder.queued_bytes() <= MAX_IN_FLIGHT * bytes);
    };
    assert_eq!(
        error,
        EncodeError::Full {
            images: MAX_IN_FLIGHT
        }
    );
    assert_eq!(encoder.queued_bytes(), MAX_IN_FLIGHT * bytes);
    // Taking the events lets it go on, and a waiting push with it.
    let reader = std::thread::spawn(move || events.iter().count());
    for time in taken..taken + 20 {
        encoder.push(time, &images[0], false).unwrap();
    }
    encoder.finish(PATIENCE).unwrap();
    assert_eq!(reader.join().unwrap(), taken as usize + 20);
}

#[test]
fn finish_gives_up_in_time_and_a_stuck_encoder_does_not_hang_its_owner() {
    let images = texture(64, 32, 1);
    let (mut encoder, events) = start(&settings("x264enc", &images[0]), 0);
    for time in 0..3 {
        encoder.push(time, &images[0], false).unwrap();
    }
    // Nobody takes the first event, so the encoder stands still for good.
    let error = encoder.finish(Duration::from_millis(20)).unwrap_err();
    assert_eq!(
        error,
        EncodeError::Stalled {
            after: Duration::from_millis(20),
            images: 3
        }
    );
    drop(events);
}

#[test]
fn dropping_an_encoder_stops_its_output() {
    let images = texture(64, 32, 1);
    let count = Arc::new(Mutex::new(0));
    let counting = count.clone();
    let on_output = move |_| *counting.lock().unwrap() += 1;
    let mut encoder =
        Encoder::start(&settings("x264enc", &images[0]), Box::new(on_output)).unwrap();
    for time in 0..50 {
        encoder.push(time, &images[0], false).unwrap();
    }
    drop(encoder);
    // The callback is dropped with the encoder, so nothing is counted any more.
    assert!((42..=50).contains(&*count.lock().unwrap()));
    assert_eq!(Arc::strong_count(&count), 1);
}

#[test]
fn a_failing_encoder_says_so_once_and_takes_nothing_more() {
    // Flatter than x265 can do; it notices at the first frame.
    let image = RawImage::new(8192, 16, PixelFormat::I420, vec![128; 8192 * 24]).unwrap();
    let (mut encoder, events) = start(&settings("x265enc", &image), 100);
    let mut time = 0;
    let error = loop {
        time += 1;
        if let Err(error) = encoder.push(time, &image, time == 3) {
            break error;
        }
    };
    assert!(matches!(error, EncodeError::Failed(_)), "{error}");
    assert!(matches!(
        encoder.push(time + 1, &image, false),
        Err(EncodeError::Failed(_))
    ));
    assert!(matches!(
        encoder.finish(PATIENCE),
        Err(EncodeError::Failed(_))
    ));
    let events: Vec<EncoderEvent> = events.iter().collect();
    assert!(
        matches!(&events[..], [EncoderEvent::Failed(_)]),
        "{events:?}"
    );
}
