use ::splats::Exposure;
use cad_transforms::RigidTransform;

use super::*;

/// The record of a view: left and right images of frames in turn.
fn record(number: usize) -> SplatView {
    SplatView {
        camera: "side".to_owned(),
        eye: [Eye::Left, Eye::Right][number % 2],
        frame: number as u64 / 2,
        set: 0,
        time_ns: 0,
        world_from_camera: RigidTransform::identity(),
        shutter: None,
        reduction: 1,
        exposure: Exposure::NONE.matrix,
        held_out: None,
    }
}

#[test]
fn held_out_images_that_are_not_those_of_the_training_are_an_error_with_the_frame() {
    let said = |expected: &[usize], found: &[usize]| {
        let result = check_numbers(expected, found, &record);
        result
            .err()
            .map_or(String::new(), |error| error.to_string())
    };
    for same in [&[][..], &[2, 3, 14]] {
        assert_eq!(said(same, same), "");
    }
    let missing = "held-out right image of camera side, frame 1: found none that can be used after \
                   the training, expected an image as at its start";
    for found in [&[2, 14][..], &[2], &[2, 14, 15]] {
        assert_eq!(said(&[2, 3, 14], found), missing);
    }
    let more = "held-out left image of camera side, frame 7: found an image after the training, \
                expected none as at its start";
    for expected in [&[2, 3][..], &[2, 3, 15]] {
        assert_eq!(said(expected, &[2, 3, 14]), more);
    }
}
