use ::splats::{
    Coverage, Exposure, ObservedGaussian, ObservedSky, ObservedSpace, Part, SectorConfig, Splat,
};
use cad_transforms::RigidTransform;

use super::super::images::ImageSummary;
use super::super::output_sectors::output_sectors;
use super::*;
use crate::pipeline::stages::preset::Preset;

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

/// A sector with Gaussians at these x and z, m.
fn sector(means: &[[f32; 2]]) -> SectorResult {
    let mut splats = Splats::empty(0).expect("a degree");
    for [x, z] in means {
        let mut splat = Splat::sphere(0.1, [0.5; 3]);
        splat.position_m = [*x, 0.0, *z];
        splats.push(&splat).expect("finite");
    }
    let part = Part {
        coverage: Coverage::new(
            vec![ObservedGaussian::default(); splats.len()],
            ObservedSpace::new(0.25, 20.0),
            ObservedSky::none(2),
        ),
        splats,
        background: Background::Constant([0.0; 3]),
        start_count: 0,
        checks: Vec::new(),
    };
    SectorResult {
        found: ImageSummary::default(),
        part: (!means.is_empty()).then_some(part),
        fell_back: None,
    }
}

/// Gaussians within 40 m of the box of a sector, along z too, as the simulation shows them.
#[test]
fn images_of_a_sector_are_compared_with_what_is_drawn_in_it() {
    let config = SplatsConfig::preset(Preset::Fast, None);
    let positions: Vec<[f64; 3]> = (0..150).map(|k| [f64::from(k), 0.0, 0.0]).collect();
    let cells = Cells::of_positions(&positions, 50, &SectorConfig::default());
    assert_eq!((cells.count(), cells.bounds(0).max_m[0]), (3, 49.5));
    let means = [
        &[[2.0, 0.0], [45.0, 1.0]][..],
        &[[60.0, 0.0], [89.0, 0.0], [90.0, 0.0], [55.0, 60.0]],
        &[],
    ];
    let sectors = means.map(sector);
    let kept = output_sectors(&cells, &sectors);
    assert_eq!(kept.iter().map(|of| of.cell).collect::<Vec<_>>(), [0, 1]);
    // Within the box of all: 2 to 90 m.
    assert_eq!(kept[0].bounds.min_m, [2.0, 0.0, 0.0]);
    assert_eq!(kept[0].bounds.max_m, [49.5, 0.0, 1.0]);
    let whole = Whole {
        cells: &cells,
        sectors: &sectors,
        kept: &kept,
        background: &Background::Constant([0.0; 3]),
        config: &config,
        networks: &Networks::default(),
    };
    let drawn = |cell: usize| {
        let scene = whole.scene_around(cell).expect("a scene");
        scene.splats.planes()[Plane::POSITION].clone()
    };
    assert_eq!(drawn(0), [2.0, 45.0, 60.0, 89.0]);
    assert_eq!(drawn(1), [45.0, 60.0, 89.0, 90.0, 55.0]);
    // From 99.5 m on.
    assert_eq!(drawn(2), [60.0, 89.0, 90.0]);
}
