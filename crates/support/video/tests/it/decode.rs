//! The decoder on our own streams, on published ones, and on rubbish.

use std::fs;

use crate::material::texture;
use crate::{elements, encode, odd_times, settings};
use gstreamer::glib;
use video::annexb::{self, Nal};
use video::references::{Continuity, Step};
use video::{AccessUnit, Codec, DecodeError, Decoder, RawImage};

/// A stream of three groups of five frames.
fn groups(element: &str) -> (Codec, Vec<Vec<AccessUnit>>) {
    let images = texture(160, 64, 15);
    let times = odd_times(15);
    let input = times
        .iter()
        .zip(&images)
        .enumerate()
        .map(|(number, (&time, image))| (time, image, number % 5 == 0));
    let units = encode(&settings(element, &images[0]), input);
    let groups: Vec<_> = units
        .chunk_by(|_, next| !next.key)
        .map(<[_]>::to_vec)
        .collect();
    assert_eq!(groups.len(), 3);
    (video::encoder::element_codec(element).unwrap(), groups)
}

#[test]
fn groups_decode_in_any_order_to_the_same_images() {
    for element in elements() {
        let (codec, groups) = groups(element);
        let whole = Decoder::new(codec).decode(&groups.concat()).unwrap();
        assert_eq!(whole.len(), 15);
        for threads in [1, 0] {
            let mut decoder = Decoder::with_threads(codec, threads);
            for &number in &[2, 0, 1, 1, 2, 0] {
                let images = decoder.decode(&groups[number]).unwrap();
                assert!(
                    images == whole[5 * number..5 * number + 5],
                    "{element}, group {number}"
                );
            }
            assert!(decoder.element().is_some());
        }
    }
}

#[test]
fn runs_that_cannot_be_decoded_are_refused() {
    for element in elements() {
        let (codec, groups) = groups(element);
        let mut decoder = Decoder::new(codec);
        assert_eq!(decoder.decode(&[]), Ok(Vec::new()));
        let late = &groups[0][1..];
        assert_eq!(
            decoder.decode(late),
            Err(DecodeError::NotKey(late[0].pts_ns))
        );
        let mut swapped = groups[0].clone();
        swapped[3].pts_ns = swapped[2].pts_ns;
        assert!(matches!(
            decoder.decode(&swapped),
            Err(DecodeError::Time { .. })
        ));
        swapped[0].pts_ns = -1;
        assert!(matches!(
            decoder.decode(&swapped),
            Err(DecodeError::Time { .. })
        ));
        assert_eq!(decoder.decode(&groups[1]).unwrap().len(), 5);
    }
}

#[test]
fn missing_images_are_named() {
    for element in elements() {
        let (codec, groups) = groups(element);
        let mut decoder = Decoder::new(codec);
        let whole = decoder.decode(&groups[0]).unwrap();
        let mut damaged = groups[0].clone();
        // A start code and nothing that a decoder could use.
        damaged[3].data = vec![0, 0, 0, 1, 0x3f, 0x55, 0x55].into();
        match decoder.decode(&damaged) {
            Err(DecodeError::Incomplete { images, missing }) => {
                assert!(
                    missing.contains(&damaged[3].pts_ns),
                    "{element}: {missing:?}"
                );
                assert!(images.len() + missing.len() == 5 && images[..3] == whole[..3]);
            }
            Err(DecodeError::Failed(reason)) => eprintln!("{element}: {reason}"),
            other => panic!("{element}: {other:?}"),
        }
        // And it goes on afterwards as if nothing had been.
        assert!(decoder.decode(&groups[0]).unwrap() == whole, "{element}");
    }
}

#[test]
fn rubbish_is_an_error_and_no_hang() {
    for element in elements() {
        let (codec, groups) = groups(element);
        let mut decoder = Decoder::new(codec);
        let mut state = 0x1234_5678_9abc_def1u64;
        for round in 0..40 {
            let mut units = groups[round % 3].clone();
            for unit in &mut units {
                let mut bytes = unit.data.to_vec();
                for _ in 0..=round {
                    state ^= state << 13;
                    state ^= state >> 7;
                    state ^= state << 17;
                    let at = (state >> 8) as usize % bytes.len();
                    match state & 7 {
                        0 => bytes.truncate(at.max(1)),
                        _ => bytes[at] = (state >> 40) as u8,
                    }
                }
                unit.data = bytes.into();
            }
            // Anything but a panic, a hang, or more frames than access units.
            if let Ok(images) = decoder.decode(&units) {
                assert_eq!(images.len(), 5);
            }
        }
        assert_eq!(decoder.decode(&groups[0]).unwrap().len(), 5, "{element}");
    }
}

#[test]
fn bytes_that_are_no_video_are_an_error() {
    let key = |data: &[u8]| AccessUnit {
        pts_ns: 0,
        data: data.to_vec().into(),
        key: true,
    };
    for (codec, slice) in [
        (Codec::H264, [0, 0, 1, 0x65, 0x80]),
        (Codec::H265, [0, 0, 1, 0x26, 1]),
    ] {
        let mut decoder = Decoder::new(codec);
        assert!(decoder.decode(&[key(&slice)]).is_err());
        assert_eq!(
            decoder.decode(&[key(b"hello")]),
            Err(DecodeError::NotKey(0))
        );
        assert_eq!(decoder.element(), None);
    }
}

/// Cuts a baseline or main H.264 stream into access units: a new one begins with the first NAL
/// unit after a slice that is not a slice, or with a slice of macroblock 0 (clause 7.4.1.2.4, as
/// far as the streams here need it).
fn access_units(stream: &[u8]) -> Vec<AccessUnit> {
    let mut units: Vec<Vec<u8>> = Vec::new();
    let mut in_slices = true;
    for nal in annexb::nals(stream) {
        let first_slice =
            nal.is_slice(Codec::H264) && nal.bytes.get(1).is_some_and(|b| b & 0x80 != 0);
        let begins = match (in_slices, nal.is_slice(Codec::H264)) {
            (true, true) => first_slice,
            (true, false) => opens(&nal),
            (false, _) => false,
        };
        if begins || units.is_empty() {
            units.push(Vec::new());
        }
        in_slices = nal.is_slice(Codec::H264) || (in_slices && !begins);
        let unit = units.last_mut().unwrap();
        unit.extend_from_slice(&[0, 0, 0, 1]);
        unit.extend_from_slice(nal.bytes);
    }
    units
        .into_iter()
        .zip(0..)
        .map(|(data, number)| AccessUnit {
            pts_ns: number * 40_000_000,
            key: annexb::is_key(Codec::H264, &data),
            data: data.into(),
        })
        .collect()
}

/// Delimiter, SEI or parameter set: cannot stand behind the slices of a frame.
fn opens(nal: &Nal<'_>) -> bool {
    (6..=9).contains(&nal.unit_type(Codec::H264))
}

#[test]
fn published_streams_decode_to_the_published_images() {
    let Some(folder) = test_data::shared("09_containers_video/h264_openh264") else {
        return;
    };
    let list = fs::read_to_string(folder.join("expected_decoded_sha1_shared.csv")).unwrap();
    let mut decoder = Decoder::new(Codec::H264);
    for line in list.lines().filter(|line| !line.trim().is_empty()) {
        let (name, expected) = line.split_once(',').unwrap();
        let units = access_units(&fs::read(folder.join(name)).unwrap());
        let mut stream = Continuity::new(Codec::H264);
        assert!(
            units
                .iter()
                .all(|unit| stream.next(&unit.data) != Step::Broken),
            "{name}"
        );
        let images = decoder
            .decode(&units)
            .unwrap_or_else(|error| panic!("{name}: {error}"));
        let mut sum = glib::Checksum::new(glib::ChecksumType::Sha1).unwrap();
        for (_, image) in &images {
            let RawImage { data, .. } = image;
            sum.update(data);
        }
        assert_eq!(
            sum.string().unwrap(),
            expected,
            "{name}, {} frames",
            images.len()
        );
    }
    // The same stream without its first IDR frame: there is nowhere to begin.
    let lost = access_units(&fs::read(folder.join("BA_MW_D_IDR_LOST.264")).unwrap());
    assert!(decoder.decode(&lost).is_err());
}
