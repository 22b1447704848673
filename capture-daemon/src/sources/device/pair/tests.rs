//! Two fake cameras.

use session_archive::time::NS_PER_S;
use video::{PixelFormat, RawImage};

use super::*;

const PERIOD: i64 = NS_PER_S / 30;
const WITHIN: i64 = PERIOD * 2 / 5;

/// Stores its samples.
#[derive(Default)]
struct RecordingSink(Mutex<Vec<Sample>>);

impl Sink for RecordingSink {
    fn now(&self) -> HostTime {
        HostTime(0)
    }

    fn put(&self, sample: Sample) {
        self.0.lock().expect("samples").push(sample);
    }

    fn pixels_needed(&self) -> bool {
        false
    }

    fn is_ending(&self) -> bool {
        false
    }
}

/// A uniform gray frame that encodes its number and eye.
fn frame(eye: Eye, number: u64, time_ns: i64) -> Sample {
    let grey = match eye {
        Eye::Left => number as u8,
        Eye::Right => 100 + number as u8,
    };
    let image = RawImage::new(4, 2, PixelFormat::I420, vec![grey; 12]).expect("an image");
    Sample::Frame(RawFrame {
        number,
        device_ticks: time_ns,
        kernel_time: Some(HostTime(time_ns)),
        host_time: HostTime(time_ns + 5_000_000),
        exposure_ns: None,
        eyes_apart_ns: None,
        image,
    })
}

/// Output for these frames: number, gray level of the left and of the right image, time difference;
/// or the dropped frame with its reason.
fn join(samples: Vec<(Eye, Sample)>) -> Vec<String> {
    let recorder = RecordingSink::default();
    let joined = StereoJoiner::new(WITHIN, &recorder);
    for (eye, sample) in samples {
        joined.eye(eye).put(sample);
    }
    joined.finish();
    let outputs = |sample: Sample| match sample {
        Sample::Frame(f) => {
            let (left, right) = (f.image.data[0], f.image.data[4]);
            let apart_us = f.eyes_apart_ns.expect("two eyes") / 1000;
            assert_eq!(f.kernel_time, Some(HostTime(f.device_ticks)));
            format!("{}: {left} {right} {apart_us}", f.number)
        }
        Sample::Arrival(s) => format!("{} seen", s.number),
        Sample::Dropped(l) => format!("{} lost: {}", l.number, l.detail),
        Sample::Disconnected(g) => format!("disconnected: {}", g.detail),
        Sample::Notice(n) => n.text,
        other => panic!("{other:?}"),
    };
    recorder
        .0
        .into_inner()
        .expect("samples")
        .into_iter()
        .map(outputs)
        .collect()
}

fn both(numbers: std::ops::Range<u64>, later_ns: i64) -> Vec<(Eye, Sample)> {
    numbers
        .flat_map(|n| {
            let time = n as i64 * PERIOD + 1;
            [
                (Eye::Left, frame(Eye::Left, n, time)),
                (Eye::Right, frame(Eye::Right, n + 7, time + later_ns)),
            ]
        })
        .collect()
}

#[test]
fn pairs_are_side_by_side_with_their_time_difference() {
    let found = join(both(0..3, 2_000_000));
    assert_eq!(found, ["0: 0 107 2000", "1: 1 108 2000", "2: 2 109 2000"]);
}

/// While nobody stores frames, pairs are counted and timed; a single image of a pair is not
/// previewed either.
#[test]
fn pairs_without_pixels_are_only_counted() {
    let recorder = RecordingSink::default();
    let joined = StereoJoiner::new(WITHIN, &recorder);
    assert!(
        !joined.eye(Eye::Right).pixels_needed(),
        "as the receiver of the pairs"
    );
    let mut samples = both(0..4, 1_000_000);
    // Of 0 and 1 both images come without pixels, of 2 the right one.
    for i in [0, 1, 2, 3, 5] {
        let Sample::Frame(frame) = &samples[i].1 else {
            panic!("{:?}", samples[i]);
        };
        let seen = FrameArrival {
            number: frame.number,
            device_ticks: frame.device_ticks,
            host_time: frame.host_time,
        };
        samples[i].1 = Sample::Arrival(seen);
    }
    assert_eq!(
        join(samples),
        ["0 seen", "1 seen", "2 seen", "3: 3 110 1000"]
    );
}

#[test]
fn frames_too_far_apart_are_dropped_with_the_reason() {
    // Half a period: neither neighbour is near enough.
    let found = join(both(0..3, PERIOD / 2));
    let lost = "lost: no right image was taken within 13.3 ms of the left one";
    let mut expected: Vec<String> = (0..3).map(|n| format!("{n} {lost}")).collect();
    expected.push("3 frames of the right camera have no left one within 13.3 ms".to_owned());
    assert_eq!(found, expected);
}

#[test]
fn frame_dropped_by_one_camera_is_a_gap_at_its_number() {
    let mut samples = both(0..6, 1_000_000);
    // Left 1 is damaged, right 3 did not arrive.
    samples[2].1 = Sample::Dropped(DroppedFrame {
        number: 1,
        host_time: HostTime(0),
        cause: Cause::Device,
        detail: "damaged".to_owned(),
    });
    samples.remove(7);
    let found = join(samples);
    assert_eq!(found[..2], ["0: 0 107 1000", "1 lost: damaged"]);
    assert_eq!(found[2], "2: 2 109 1000");
    assert!(found[3].starts_with("3 lost: no right image"), "{found:?}");
    assert_eq!(found[4..6], ["4: 4 111 1000", "5: 5 112 1000"]);
    assert!(
        found[6].starts_with("1 frames of the right camera"),
        "{found:?}"
    );
}

#[test]
fn non_increasing_timestamp_is_dropped() {
    let mut samples = both(0..4, 0);
    samples[4].1 = frame(Eye::Left, 2, PERIOD + 1);
    let found = join(samples);
    assert_eq!(found[1], "1: 1 108 0");
    assert_eq!(
        found[2],
        "2 lost: its time stamp is not after that of the one before"
    );
    assert_eq!(found[3], "3: 3 110 0");
}

#[test]
fn disconnect_of_one_camera_stops_the_pair_until_it_reconnects() {
    let disconnected = Sample::Disconnected(Disconnect {
        host_time: HostTime(0),
        part: DevicePart::Camera,
        detail: "unplugged".to_owned(),
    });
    let mut samples = both(0..2, 1_000_000);
    samples.push((Eye::Right, disconnected));
    // Meanwhile the left one continues.
    samples.extend(
        both(2..5, 0)
            .into_iter()
            .filter(|(eye, _)| *eye == Eye::Left),
    );
    // The right one restarts its counter and timestamps.
    samples.push((Eye::Right, frame(Eye::Right, 0, 5 * PERIOD + 2)));
    samples.push((Eye::Left, frame(Eye::Left, 5, 5 * PERIOD + 1)));
    let found = join(samples);
    assert_eq!(
        found,
        [
            "0: 0 107 1000",
            "1: 1 108 1000",
            "disconnected: right camera: unplugged",
            "5: 5 100 0"
        ]
    );
}
