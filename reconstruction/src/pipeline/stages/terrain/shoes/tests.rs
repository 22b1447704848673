use cad_transforms::Covariance;
use cad_transforms::rig::Foot;

use super::*;
use crate::pipeline::stages::down_looking::{HEIGHT_M, SIZE, at, frame, rig, view};

fn detection(time_ns: i64) -> TagDetection {
    TagDetection {
        time_ns,
        frame: 0,
        camera: 0,
        foot: Foot::Left,
        tag: 7,
        rig_from_tag: at(0.1, 0.1, -HEIGHT_M) * at(0.08, 0.0, 0.08),
        covariance: Covariance::from_sigmas([0.001; 3], [0.01; 3]).expect("positive"),
        visible_share: [1.0; 2],
        rms_levels: 1.0,
        wrong_bits: 0,
        second: None,
    }
}

/// Excluded pixels of a depth map of level ground, with a shoe of 8 cm on it.
fn excluded(detections: &[TagDetection], shoe_m: f64) -> Vec<[f64; 2]> {
    let rig = rig();
    let view = view();
    let frame = frame(1_000_000_000);
    let place = |pixel: usize, depth: f64| {
        let [x, y] = [pixel % SIZE[0] as usize, pixel / SIZE[0] as usize].map(|v| v as f64);
        let point = [(x - 29.5) / 60.0 * depth, (y - 19.5) / 60.0 * depth, depth];
        let [x, y, _] = rig.cameras[0].rig_from_left.apply(point);
        [x, y]
    };
    let pixels = (SIZE[0] * SIZE[1]) as usize;
    let is_shoe = |pixel: usize| {
        let [x, y] = place(pixel, HEIGHT_M - shoe_m);
        (-0.02..=0.26).contains(&x) && (0.06..=0.14).contains(&y)
    };
    let depth_m: Vec<f32> = (0..pixels)
        .map(|pixel| match is_shoe(pixel) {
            true => (HEIGHT_M - shoe_m) as f32,
            false => HEIGHT_M as f32,
        })
        .collect();
    let mut classes = vec![PixelClass::Static; pixels];
    let shoes = Shoes::new(&rig, detections, TerrainConfig::default());
    shoes.exclude(&view, &frame, &depth_m, &mut classes);
    let shown: Vec<usize> = (0..pixels)
        .filter(|pixel| classes[*pixel] == PixelClass::Excluded)
        .collect();
    assert!(shown.iter().all(|pixel| is_shoe(*pixel)), "ground is kept");
    let all = (0..pixels).filter(|pixel| is_shoe(*pixel)).count();
    assert!(
        shown.is_empty() || shown.len() == all,
        "{} of {all}",
        shown.len()
    );
    shown
        .into_iter()
        .map(|pixel| place(pixel, HEIGHT_M))
        .collect()
}

#[test]
fn the_shoe_is_excluded_and_the_ground_around_it_is_not() {
    assert!(excluded(&[detection(1_000_000_000)], 0.08).len() > 30);
    // What is as low as the ground is ground.
    assert!(excluded(&[detection(1_000_000_000)], 0.005).is_empty());
}

#[test]
fn shoes_of_other_frames_exclude_nothing() {
    let others = [detection(900_000_000), detection(1_066_000_000)];
    assert!(excluded(&others, 0.08).is_empty());
    assert!(excluded(&[], 0.08).is_empty());
}

#[test]
fn the_pose_with_the_more_level_sole_counts() {
    let mut tilted = detection(1_000_000_000);
    let right = tilted.rig_from_tag;
    let foot_from_tag = at(0.08, 0.0, 0.08);
    let turn = RigidTransform::from_rotation_vector([0.0, 0.5, 0.0], [0.0; 3]).expect("finite");
    tilted.rig_from_tag = right * foot_from_tag.inverse() * turn * foot_from_tag;
    tilted.second = Some(scene_bundle::outputs::tag_detections::SecondPose {
        rig_from_tag: right,
        excess_cost: 1.0,
    });
    assert_eq!(
        excluded(&[tilted], 0.08),
        excluded(&[detection(1_000_000_000)], 0.08)
    );
}
