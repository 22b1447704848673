//! Lost access units in streams of real encoders.

use crate::material::texture;
use crate::{elements, encode, settings};
use video::references::{Continuity, Step};
use video::{AccessUnit, DecodeError, Decoder};

#[test]
fn every_single_loss_is_noticed() {
    let images = texture(160, 64, 40);
    for element in elements() {
        let codec = video::encoder::element_codec(element).unwrap();
        let input = images
            .iter()
            .zip(0..)
            .map(|(image, n)| (n * 33_333_333, image, n == 20));
        let units = encode(&settings(element, &images[0]), input);
        let steps = |units: &[AccessUnit]| -> Vec<Step> {
            let mut stream = Continuity::new(codec);
            units.iter().map(|unit| stream.next(&unit.data)).collect()
        };
        let whole = steps(&units);
        for (number, step) in whole.iter().enumerate() {
            let expected = if number % 20 == 0 {
                Step::Key
            } else {
                Step::Follows
            };
            assert_eq!(*step, expected, "{element}, frame {number}");
        }
        for lost in 0..40 {
            let mut left = units.clone();
            left.remove(lost);
            let end = if lost < 20 { 19 } else { 39 };
            for (number, step) in steps(&left).into_iter().enumerate() {
                assert_eq!(
                    step == Step::Broken,
                    (lost..end).contains(&number),
                    "{element}: {lost} is lost, {number} is {step:?}"
                );
            }
        }
    }
}

#[test]
fn what_refers_to_a_lost_image_is_not_decoded() {
    let images = texture(160, 64, 12);
    for element in elements() {
        let codec = video::encoder::element_codec(element).unwrap();
        let input = images
            .iter()
            .zip(0..)
            .map(|(image, n)| (n * 33_333_333, image, n == 8));
        let mut units = encode(&settings(element, &images[0]), input);
        let mut decoder = Decoder::new(codec);
        let whole = decoder.decode(&units).unwrap();
        units.remove(3);
        match decoder.decode(&units) {
            Err(DecodeError::Incomplete { images, missing }) => {
                assert_eq!(missing, [4, 5, 6, 7].map(|n| n * 33_333_333), "{element}");
                assert!(images == [&whole[..3], &whole[8..]].concat(), "{element}");
            }
            other => panic!("{element}: {other:?}"),
        }
    }
}
