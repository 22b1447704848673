use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};
use scene_bundle::outputs::cloud::CloudPoint;
use scene_bundle::outputs::depth::{DepthImage, DepthView};

use super::*;
use session_input::Color;
use terrain::RowMotion;

const WIDTH: u32 = 60;
const HEIGHT: u32 = 40;
/// Depth of the wall, m.
const WALL_M: f32 = 3.0;
const SIGMA_M: f32 = 0.02;

fn view() -> DepthView {
    DepthView {
        camera: "front".to_owned(),
        model: CameraModel {
            width: WIDTH,
            height: HEIGHT,
            fx: 50.0,
            fy: 50.0,
            cx: 29.5,
            cy: 19.5,
            distortion: Distortion::None,
        },
        view_from_left: RigidTransform::identity(),
    }
}

/// A view along z, translated to the right, of a wall, with another depth in a few pixels.
fn depth_map(right_m: f64, else_m: impl Fn(u32, u32) -> Option<f32>) -> PosedDepthMap {
    let pixels = (0..HEIGHT).flat_map(|y| (0..WIDTH).map(move |x| (x, y)));
    let depth: Vec<f32> = pixels
        .map(|(x, y)| else_m(x, y).unwrap_or(WALL_M))
        .collect();
    let sigma = vec![SIGMA_M; depth.len()];
    let image = DepthImage::from_metres(WIDTH, HEIGHT, &depth, &sigma);
    let place = RigidTransform::from_translation_m([right_m, 0.0, 0.0]).expect("finite");
    PosedDepthMap::new(image, &view(), &place, RowMotion::default())
}

fn nothing_else(_: u32, _: u32) -> Option<f32> {
    None
}

fn left_image<'a>(lens: &'a Lens, image: &'a Image) -> LeftImage<'a> {
    LeftImage {
        lens,
        image,
        movable: None,
    }
}

fn cloud(depth_maps: Vec<PosedDepthMap>) -> Vec<CloudPoint> {
    let near: VecDeque<Vec<PosedDepthMap>> = depth_maps
        .into_iter()
        .map(|depth_map| vec![depth_map])
        .collect();
    let image = Image {
        width: WIDTH,
        height: HEIGHT,
        color: Color::Rgb,
        data: [9, 80, 200].repeat((WIDTH * HEIGHT) as usize).into(),
    };
    let lens = Lens::new(&view().model);
    let mut voxels = Voxels::new(0.05);
    for k in 0..near.len() {
        voxels.add(
            &points(
                &CloudConfig::default(),
                &near,
                (k, 0),
                &left_image(&lens, &image),
            )
            .0,
        );
    }
    voxels.into_points()
}

#[test]
fn a_wall_seen_by_several_views_becomes_points() {
    let points = cloud(
        [0.0, 0.15, 0.3]
            .map(|right_m| depth_map(right_m, nothing_else))
            .into(),
    );
    // Pixels are 6 cm apart on the wall: about one voxel per pixel visible in all views.
    assert!(points.len() > 1500, "{}", points.len());
    for point in &points {
        assert!((point.x_in_world[2] - WALL_M).abs() < 1e-3, "{point:?}");
        assert_eq!(point.color, [9, 80, 200]);
        assert!(point.sigma_m <= SIGMA_M + 1e-6);
    }
    // Parts that not all views show are missing: the last view is 0.3 m farther to the right.
    let leftmost = points
        .iter()
        .map(|p| p.x_in_world[0])
        .fold(f32::MAX, f32::min);
    assert!((leftmost - (0.3 - 29.5 * 0.06)).abs() < 0.07, "{leftmost}");
}

#[test]
fn too_few_views_make_no_point() {
    assert!(cloud(vec![depth_map(0.0, nothing_else)]).is_empty());
    assert!(
        cloud(vec![
            depth_map(0.0, nothing_else),
            depth_map(0.1, nothing_else)
        ])
        .is_empty()
    );
    // Two cameras at the same instant do not distinguish static from dynamic.
    let near = VecDeque::from([vec![
        depth_map(0.0, nothing_else),
        depth_map(0.1, nothing_else),
        depth_map(0.2, nothing_else),
    ]]);
    let image = Image {
        width: WIDTH,
        height: HEIGHT,
        color: Color::Grey,
        data: vec![7; (WIDTH * HEIGHT) as usize].into(),
    };
    let lens = Lens::new(&view().model);
    assert!(
        points(
            &CloudConfig::default(),
            &near,
            (0, 0),
            &left_image(&lens, &image)
        )
        .0
        .is_empty()
    );
}

#[test]
fn a_person_who_walks_by_leaves_no_points() {
    // A person at 2 m at another position each time.
    let somebody = |from: u32| move |x: u32, _| (from..from + 6).contains(&x).then_some(2.0);
    let depth_maps = [10, 22, 34, 46].map(|from| depth_map(0.0, somebody(from)));
    let points = cloud(depth_maps.into());
    assert!(points.len() > 1500, "{}", points.len());
    for point in &points {
        assert!((point.x_in_world[2] - WALL_M).abs() < 1e-3, "{point:?}");
    }
    // A person at rest remains.
    let points = cloud([0; 3].map(|_| depth_map(0.0, somebody(20))).into());
    assert!(points.iter().any(|p| (p.x_in_world[2] - 2.0).abs() < 1e-3));
}

#[test]
fn uncertain_depth_makes_no_point() {
    let vague = |right_m: f64| {
        let mut depth_map = depth_map(right_m, nothing_else);
        depth_map.blur(CloudConfig::default().max_point_sigma_m + 0.01);
        depth_map
    };
    assert!(cloud(vec![vague(0.0), vague(0.1), vague(0.2)]).is_empty());
}

#[test]
fn gray_images_give_gray_and_movable_pixels_give_nothing() {
    let image = Image {
        width: 3,
        height: 2,
        color: Color::Grey,
        data: vec![1, 2, 3, 4, 5, 6].into(),
    };
    // Pixel (x, y) is the projection of the ray (x, y, 1).
    let lens = Lens::new(&CameraModel {
        width: 3,
        height: 2,
        fx: 1.0,
        fy: 1.0,
        cx: 0.0,
        cy: 0.0,
        distortion: Distortion::None,
    });
    let mut left_image = left_image(&lens, &image);
    assert_eq!(left_image.color([1.4, 0.6, 1.0]), Some([5; 3]));
    assert_eq!(left_image.color([2.6, 0.0, 1.0]), None);
    assert_eq!(left_image.color([-0.6, 0.0, 1.0]), None);
    let movable = [false, false, false, false, true, false];
    left_image.movable = Some(&movable);
    assert_eq!(left_image.color([1.4, 0.6, 1.0]), None);
    assert_eq!(left_image.color([2.0, 1.0, 1.0]), Some([6; 3]));
}
