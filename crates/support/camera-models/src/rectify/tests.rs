use super::*;

/// The EuRoC pair: rotated, distorted, and one camera a little higher.
fn euroc() -> StereoCalibration {
    let lens = |fx, fy, cx, cy, k1, k2, p1, p2| CameraModel {
        width: 752,
        height: 480,
        fx,
        fy,
        cx,
        cy,
        distortion: Distortion::RadTan4 { k1, k2, p1, p2 },
    };
    StereoCalibration {
        left: lens(
            458.654,
            457.296,
            367.215,
            248.375,
            -0.28340811,
            0.07395907,
            0.00019359,
            1.7618e-05,
        ),
        right: lens(
            457.587,
            456.134,
            379.999,
            255.238,
            -0.28368365,
            0.07451284,
            -0.00010473,
            -3.5559e-05,
        ),
        right_from_left: RigidTransform::from_rotation_vector(
            [0.0070, -0.0140, 0.0023],
            [-0.1100738, 0.0003991, -0.0008537],
        )
        .unwrap(),
        imu: None,
        provenance: Provenance {
            format: None,
            files: Vec::new(),
            part: None,
        },
    }
}

fn fisheye() -> StereoCalibration {
    let mut pair = euroc();
    for camera in [&mut pair.left, &mut pair.right] {
        (camera.fx, camera.fy) = (300.0, 299.0);
        camera.distortion = Distortion::KannalaBrandt4 {
            k1: 0.02,
            k2: -0.01,
            k3: 0.004,
            k4: -0.0007,
        };
    }
    pair
}

const VIEWS: [View; 3] = [View::All, View::Filled, View::Focal(420.0)];

#[test]
fn a_point_has_one_row_and_the_disparity_of_its_depth() {
    for pair in [euroc(), fisheye()] {
        for view in VIEWS {
            let r = Rectification::new(&pair, view).unwrap();
            let (left, right) = (Lens::new(&pair.left), Lens::new(&pair.right));
            let mut seen = 0;
            for i in 0..400_u32 {
                let part = |step: f64| (f64::from(i) * step).fract() - 0.5;
                let z = 0.4 + 3.0 * (part(0.618_034) + 0.5);
                let x_in_left = [part(0.754_878) * z, part(0.569_84) * z, z];
                let x_in_right = pair.right_from_left.apply(x_in_left);
                let (Some(l), Some(r_px)) = (left.project(x_in_left), right.project(x_in_right))
                else {
                    continue;
                };
                let l = r.new_pixel(Eye::Left, l).unwrap();
                let r_px = r.new_pixel(Eye::Right, r_px).unwrap();
                assert!((l[1] - r_px[1]).abs() < 1e-8, "{l:?} {r_px:?}");
                let depth = r.rectified_from_left.apply(x_in_left)[2];
                let disparity = r.camera.fx * pair.baseline_m() / depth;
                assert!((l[0] - r_px[0] - disparity).abs() < 1e-8);
                // The projection matrices agree.
                let p = r.right_projection();
                let [x, y, z] = r.rectified_from_left.apply(x_in_left);
                let u = (p[0] * x + p[2] * z + p[3]) / z;
                let v = (p[5] * y + p[6] * z) / z;
                assert!((u - r_px[0]).abs() < 1e-8 && (v - r_px[1]).abs() < 1e-8);
                seen += 1;
            }
            assert!(seen > 300);
            assert!(r.stereo().is_rectified());
        }
    }
}

#[test]
fn views_have_the_stated_field_of_view() {
    for pair in [euroc(), fisheye()] {
        let filled = Rectification::new(&pair, View::Filled).unwrap();
        for eye in [Eye::Left, Eye::Right] {
            let map = filled.exact_map(eye);
            // Between the tested points of the edge; a remap counts this as the edge of the image.
            let inside = |c: f32, size: f32| c >= -0.02 && c <= size - 1.0 + 0.02;
            assert!(map.x.iter().all(|x| inside(*x, 752.0)));
            assert!(map.y.iter().all(|y| inside(*y, 480.0)));
        }
        // A slightly shorter focal length would include empty pixels.
        let wider = Rectification::new(&pair, View::Focal(0.99 * filled.camera.fx)).unwrap();
        let empty = [Eye::Left, Eye::Right].iter().any(|eye| {
            let map = wider.exact_map(*eye);
            let outside = |c: &f32, size: f32| c.is_nan() || *c < 0.0 || *c > size - 1.0;
            map.x.iter().any(|x| outside(x, 752.0)) || map.y.iter().any(|y| outside(y, 480.0))
        });
        assert!(empty);

        let all = Rectification::new(&pair, View::All).unwrap();
        assert!(all.camera.fx < filled.camera.fx);
        let mut at_the_border: f64 = f64::INFINITY;
        let mut limited = false;
        for eye in [Eye::Left, Eye::Right] {
            for i in 0..=300 {
                let part = f64::from(i) / 300.0;
                for old in [
                    [part * 752.0 - 0.5, -0.5],
                    [part * 752.0 - 0.5, 479.5],
                    [-0.5, part * 480.0 - 0.5],
                    [751.5, part * 480.0 - 0.5],
                ] {
                    let [x, y] = all.new_pixel(eye, old).unwrap();
                    let c = &all.camera;
                    let off_axis = (x - c.cx).hypot(y - c.cy) / c.fx;
                    // Just inside the limit, the image may end between two tested points.
                    if off_axis > 0.95 * MAX_ANGLE_RAD.tan() {
                        limited = true;
                        continue;
                    }
                    let inside = |c: f64, size: f64| (c + 0.5).min(size - 0.5 - c);
                    let room = inside(x, 752.0).min(inside(y, 480.0));
                    // The extreme points of a distorted border are between the tested ones.
                    assert!(room > -0.1, "{x} {y}");
                    at_the_border = at_the_border.min(room);
                }
            }
        }
        // The corners of the fisheye are too far off the axis, so that its border is elsewhere.
        assert!(limited || at_the_border < 0.1, "{at_the_border}");
    }
}

#[test]
fn source_and_rectified_pixels_are_inverse() {
    for pair in [euroc(), fisheye()] {
        let r = Rectification::new(&pair, View::All).unwrap();
        for old in [[0.0, 0.0], [751.0, 479.0], [300.5, 17.25]] {
            let new = r.new_pixel(Eye::Right, old).unwrap();
            let again = r.old_pixel(Eye::Right, new).unwrap();
            assert!((again[0] - old[0]).hypot(again[1] - old[1]) < 1e-8);
        }
    }
}

#[test]
fn the_fast_map_keeps_its_bound() {
    let mut worst: f32 = 0.0;
    let mut strong = euroc();
    strong.left.distortion = Distortion::Rational8 {
        k1: 12.0,
        k2: 3.0,
        p1: 1e-4,
        p2: -2e-4,
        k3: 0.2,
        k4: 12.4,
        k5: 7.0,
        k6: 1.0,
    };
    for pair in [euroc(), fisheye(), strong] {
        for view in VIEWS {
            // Sizes that are no multiple of a tile, smaller and larger than the source.
            for size in [[752, 480], [201, 133], [1283, 730], [7, 3]] {
                let r = Rectification::with_size(&pair, view, size).unwrap();
                for eye in [Eye::Left, Eye::Right] {
                    let (fast, exact) = (r.map(eye), r.exact_map(eye));
                    for (a, b) in fast
                        .x
                        .iter()
                        .zip(&exact.x)
                        .chain(fast.y.iter().zip(&exact.y))
                    {
                        assert_eq!(a.is_nan(), b.is_nan());
                        if !a.is_nan() {
                            worst = worst.max((a - b).abs());
                        }
                    }
                }
            }
        }
    }
    println!("worst of all maps: {worst} px");
    assert!(worst <= Map::BOUND_PX, "{worst}");
}

/// An image with edges and slopes.
fn image(width: usize, height: usize) -> Vec<u8> {
    (0..width * height)
        .map(|i| {
            let (x, y) = (i % width, i / width);
            let cell = if (x / 9 + y / 7) % 2 == 0 { 90 } else { 0 };
            (cell + (3 * x + 2 * y) % 160) as u8
        })
        .collect()
}

#[test]
fn remap_agrees_with_the_reference_implementation() {
    let old = image(752, 480);
    for view in VIEWS {
        let r = Rectification::new(&euroc(), view).unwrap();
        let map = r.map(Eye::Left);
        let fast = Remap::new(&map, 752, 480).apply(&old, 7);
        let exact = remap_exact(&map, &old, [752, 480], 7);
        let worst = fast.iter().zip(&exact).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(worst.unwrap() <= 2, "{worst:?}");
        let mean: f64 = fast
            .iter()
            .zip(&exact)
            .map(|(a, b)| f64::from(a.abs_diff(*b)))
            .sum::<f64>()
            / fast.len() as f64;
        assert!(mean < 0.2, "{mean}");
    }
    // The identity map keeps an image up to the last edge, and gives fill outside.
    let identity = Map::exact(754, 480, |[x, y]| (x < 753.0).then_some([x, y]));
    let moved = Remap::new(&identity, 752, 480).apply(&old, 7);
    for (row, new) in moved.chunks(754).enumerate() {
        assert_eq!(new[..752], old[row * 752..][..752]);
        assert_eq!(new[752..], [7, 7]);
    }
    assert_eq!(moved, remap_exact(&identity, &old, [752, 480], 7));
}

#[test]
fn pairs_that_cannot_be_rectified_are_an_error() {
    let mut pair = euroc();
    pair.right_from_left = RigidTransform::from_translation_m([0.0, -0.1, 0.0]).unwrap();
    let error = Rectification::new(&pair, View::All).unwrap_err();
    assert_eq!(error, RectifyError::NotBeside { angle_deg: 90.0 });
    let mut pair = euroc();
    pair.right_from_left =
        RigidTransform::from_rotation_vector([0.0, 3.0, 0.0], [-0.1, 0.0, 0.0]).unwrap();
    assert!(Rectification::new(&pair, View::Filled).is_err());
    assert!(matches!(
        Rectification::new(&euroc(), View::Focal(0.0)),
        Err(RectifyError::Impossible { .. })
    ));
}
