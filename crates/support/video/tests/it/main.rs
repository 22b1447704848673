//! The crate as its users see it: through GStreamer, with the software encoders of this machine.

mod capture;
mod decode;
mod discover;
mod encode;
mod material;
mod mp4;
mod references;

use std::sync::{Arc, Mutex};
use std::time::Duration;

use video::{AccessUnit, Encoder, EncoderEvent, EncoderSettings, RawImage};

/// Long enough for the slowest machine; reached only when something hangs.
const PATIENCE: Duration = Duration::from_secs(600);

/// The software encoders of the table that are installed here. x264enc and x265enc have to be.
fn elements() -> Vec<&'static str> {
    video::init().unwrap();
    let installed = |element: &&str| gstreamer::ElementFactory::find(element).is_some();
    assert!(
        ["x264enc", "x265enc"].iter().all(installed),
        "install gstreamer1.0-plugins-{{ugly,bad}}"
    );
    ["x264enc", "x265enc", "openh264enc"]
        .into_iter()
        .filter(installed)
        .collect()
}

fn settings(element: &str, image: &RawImage) -> EncoderSettings {
    EncoderSettings {
        element: element.into(),
        width: image.width,
        height: image.height,
        rate_hz: 30.0,
        quality_db: 42.0,
        threads: 1,
        max_key_interval_frames: 1000,
        preset: video::encoder::Preset::default(),
    }
}

/// Encodes (time, frame, whether a key frame is forced) and gives all access units.
fn encode<'a>(
    settings: &EncoderSettings,
    images: impl IntoIterator<Item = (i64, &'a RawImage, bool)>,
) -> Vec<AccessUnit> {
    let units: Arc<Mutex<Vec<AccessUnit>>> = Arc::default();
    let collecting = units.clone();
    let on_output = move |event| match event {
        EncoderEvent::AccessUnit(unit) => collecting.lock().unwrap().push(unit),
        EncoderEvent::Failed(reason) => panic!("{reason}"),
    };
    let mut encoder = Encoder::start(settings, Box::new(on_output)).unwrap();
    for (time, image, key) in images {
        encoder.push(time, image, key).unwrap();
    }
    encoder.finish(PATIENCE).unwrap();
    std::mem::take(&mut units.lock().unwrap())
}

/// Odd nanoseconds as from CLOCK_MONOTONIC, with jitter and one gap.
fn odd_times(count: usize) -> Vec<i64> {
    (0..count as i64)
        .map(|number| {
            let gap = if number >= count as i64 / 2 {
                400_000_007
            } else {
                0
            };
            123_456_789_012_345 + number * 33_333_333 + (number * 7_919) % 100_003 + gap
        })
        .collect()
}
