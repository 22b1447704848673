use std::sync::{Arc, Mutex};
use std::time::Duration;

use super::*;
use crate::{Encoder, EncoderEvent, EncoderSettings, PixelFormat};

const SIZE: (u32, u32) = (256, 64);

/// A frame of squares in both eyes; `plain` leaves the eyes it names grey.
fn frame(n: usize, plain: [bool; 2]) -> RawImage {
    let (width, height) = SIZE;
    let mut data = Vec::new();
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let is_plain = plain[usize::from(x >= width / 2)];
        let is_light = ((x + n as u32) / 4 + y / 4).is_multiple_of(2);
        data.push(match (is_plain, is_light) {
            (true, _) => 100,
            (false, true) => 180,
            (false, false) => 60,
        });
    }
    data.resize(data.len() * 3 / 2, 128);
    RawImage::new(width, height, PixelFormat::I420, data).unwrap()
}

fn encoded(frames: &[RawImage], keys_every: usize) -> Vec<AccessUnit> {
    let settings = EncoderSettings {
        element: "x264enc".into(),
        width: SIZE.0,
        height: SIZE.1,
        rate_hz: 30.0,
        quality_db: 45.0,
        threads: 1,
        max_key_interval_frames: 300,
        preset: crate::encoder::Preset::default(),
    };
    let units = Arc::new(Mutex::new(Vec::new()));
    let collect = units.clone();
    let taken = move |event| match event {
        EncoderEvent::AccessUnit(unit) => collect.lock().unwrap().push(unit),
        EncoderEvent::Failed(reason) => panic!("{reason}"),
    };
    let mut encoder = Encoder::start(&settings, Box::new(taken)).unwrap();
    for (n, frame) in frames.iter().enumerate() {
        let is_key = n % keys_every == 0;
        encoder.push(n as i64 * 33_000_000, frame, is_key).unwrap();
    }
    encoder.finish(Duration::from_secs(120)).unwrap();
    std::mem::take(&mut units.lock().unwrap())
}

fn candidates(count: usize, keys_every: usize) -> Vec<Candidate> {
    let candidate = |n: usize| Candidate {
        number: 100 + n as u64,
        time_ns: n as i64 * 33_000_000,
        key: n / keys_every * keys_every,
    };
    (0..count).map(candidate).collect()
}

fn said(stills: &Stills) -> Vec<(Vec<&'static str>, u64, &'static str)> {
    let said = stills.stills.iter().map(|still| {
        let roles = still.roles.iter().map(|r| r.name()).collect();
        (roles, still.number, still.eye)
    });
    said.collect()
}

#[test]
fn the_worst_is_the_eye_that_shows_least() {
    // The right eye shows nothing for a while.
    let frames: Vec<RawImage> = (0..48)
        .map(|n| frame(n, [false, (32..36).contains(&n)]))
        .collect();
    let units = encoded(&frames, 4);
    let settings = Settings {
        width: 100,
        ..Settings::default()
    };
    let make = || {
        let mut read = |k: usize| Some(units[k].data.clone());
        stills(Codec::H264, &candidates(48, 4), &settings, &mut read).unwrap()
    };
    let found = make();
    let expected = [
        (vec!["start"], 100, "left"),
        (vec!["middle"], 120, "left"),
        (vec!["least sharp"], 132, "right"),
        (vec!["end"], 147, "left"),
    ];
    assert_eq!(said(&found), expected);
    assert_eq!((found.looked_at, found.undecodable), (13, 0));
    let [start, _, worst, _] = &found.stills[..] else {
        panic!("{found:?}")
    };
    assert!(
        start.look.sharpness > 10.0 * worst.look.sharpness,
        "{found:?}"
    );
    assert!((worst.look.brightness - 100.0).abs() < 3.0, "{worst:?}");
    // JPEGs of half the eye's size, as a mean of four pixels is.
    for still in &found.stills {
        assert!(still.jpeg.starts_with(&[0xff, 0xd8]) && still.jpeg.ends_with(&[0xff, 0xd9]));
        assert!(
            still.jpeg.windows(4).any(|w| w == [0, 32, 0, 64]),
            "32 rows of 64"
        );
    }
    assert_eq!(found, make(), "the same twice");
}

#[test]
fn what_cannot_be_decoded_is_passed_over() {
    let frames: Vec<RawImage> = (0..12).map(|n| frame(n, [false; 2])).collect();
    let units = encoded(&frames, 4);
    let mut read = |k: usize| (k != 0).then(|| units[k].data.clone());
    let settings = Settings::default();
    let found = stills(Codec::H264, &candidates(12, 4), &settings, &mut read).unwrap();
    assert_eq!(found.undecodable, 1);
    assert_eq!(found.stills[0].number, 104);
    assert_eq!(found.stills[0].roles[0], Role::Start);
    let nothing = stills(Codec::H264, &candidates(12, 4), &settings, &mut |_| None).unwrap();
    // Three key frames and the last frame.
    assert_eq!((nothing.stills.len(), nothing.undecodable), (0, 4));
    let none = stills(Codec::H264, &[], &settings, &mut |_| None).unwrap();
    assert_eq!(none, Stills::default());
}

#[test]
fn a_long_recording_costs_no_more() {
    let (chosen, middle) = choose(&candidates(100_000, 10), 32);
    assert!(chosen.len() <= 35, "{}", chosen.len());
    assert_eq!((chosen.first(), chosen.last()), (Some(&0), Some(&99_999)));
    assert!(chosen.contains(&middle) && middle == 49_990);
    let gaps: Vec<usize> = chosen
        .iter()
        .zip(chosen.iter().skip(1))
        .map(|(a, b)| b - a)
        .collect();
    assert!(gaps.iter().all(|gap| *gap <= 3200), "{gaps:?}");
}

#[test]
fn looks_are_numbers_for_what_one_sees() {
    let grey = |value: [u8; 2]| {
        let data: Vec<u8> = (0..64).map(|k| value[k % 2]).collect();
        Look::of(&RawImage::new(8, 8, PixelFormat::Grey8, data).unwrap())
    };
    assert_eq!(grey([90, 90]).sharpness, 0.0);
    assert_eq!(grey([90, 90]).brightness, 90.0);
    // Columns differ, rows do not: half of all pairs.
    assert_eq!(grey([80, 100]).sharpness, 10.0);
    assert_eq!(grey([0, 100]).clipped, 0.5);
    assert_eq!(grey([255, 254]).clipped, 1.0);
}
