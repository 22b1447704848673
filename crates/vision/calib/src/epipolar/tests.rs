use cad_transforms::RigidTransform;
use camera_models::Provenance;
use camera_models::rectify::{Rectification, View};

use super::*;
use crate::test_data::shared;

fn pair(distortion: Distortion) -> StereoCalibration {
    let left = CameraModel {
        width: 1280,
        height: 720,
        fx: 690.6,
        fy: 691.2,
        cx: 640.7,
        cy: 382.5,
        distortion,
    };
    StereoCalibration {
        left,
        right: CameraModel {
            fx: 693.2,
            cy: 334.8,
            ..left
        },
        right_from_left: RigidTransform::from_rotation_vector(
            [0.00094, -0.0069, -0.0005],
            [-0.0629661, 0.0004, -0.0007],
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

fn pairs() -> [StereoCalibration; 3] {
    [
        Distortion::RadTan5 {
            k1: -0.1614,
            k2: 0.0195,
            p1: -0.0008,
            p2: 0.0005,
            k3: 0.0023,
        },
        Distortion::KannalaBrandt4 {
            k1: 0.02,
            k2: -0.01,
            k3: 0.004,
            k4: -0.0007,
        },
        Distortion::Eucm {
            alpha: 0.6,
            beta: 1.1,
        },
    ]
    .map(pair)
}

/// Matched pixels of points in the common field of view.
fn matches(pair: &StereoCalibration) -> Vec<([f64; 2], [f64; 2])> {
    let (left, right) = (Lens::new(&pair.left), Lens::new(&pair.right));
    (0..200_u32)
        .filter_map(|i| {
            let part = |step: f64| (f64::from(i) * step).fract() - 0.5;
            let z = 0.5 + 4.0 * (part(0.618_034) + 0.5);
            let x_in_left = [1.2 * part(0.754_878) * z, 0.8 * part(0.569_84) * z, z];
            let x_in_right = pair.right_from_left.apply(x_in_left);
            Some((left.project(x_in_left)?, right.project(x_in_right)?))
        })
        .collect()
}

#[test]
fn true_matches_have_no_epipolar_error() {
    for pair in pairs() {
        let epipolar = Epipolar::new(&pair).unwrap();
        for (l, r) in matches(&pair) {
            assert!(epipolar.row_difference(l, r).unwrap().abs() < 1e-8);
            assert!(epipolar.sampson_distance(l, r).unwrap().abs() < 1e-8);
            assert_eq!(row_difference(&pair, l, r), epipolar.row_difference(l, r));
        }
    }
}

/// The distance by search: both directions are moved on the plane z = 1 until they satisfy the
/// constraint, by Newton steps with finite differences.
fn least_move(pair: &StereoCalibration, l: [f64; 2], r: [f64; 2], focal_px: f64) -> f64 {
    let plane = |model: &CameraModel, pixel| {
        let [x, y, z] = Lens::new(model).unproject(pixel).unwrap();
        [x / z, y / z]
    };
    let (l, r) = (plane(&pair.left, l), plane(&pair.right, r));
    let start = [l[0], l[1], r[0], r[1]];
    // Triple product of the rotated left ray, the right ray and the baseline.
    let miss = |v: &[f64; 4]| {
        let a = Vector3::from(pair.right_from_left.rotate([v[0], v[1], 1.0]));
        let b = Vector3::new(v[2], v[3], 1.0);
        b.dot(&pair.right_from_left.translation().normalize().cross(&a))
    };
    let mut v = start;
    for _ in 0..50 {
        const H: f64 = 1e-6;
        let slope: [f64; 4] = std::array::from_fn(|i| {
            let (mut up, mut down) = (v, v);
            up[i] += H;
            down[i] -= H;
            (miss(&up) - miss(&down)) / (2.0 * H)
        });
        // Nearest point to the start on the constraint linearized at v.
        let norm: f64 = slope.iter().map(|s| s * s).sum();
        let along: f64 = (0..4).map(|i| slope[i] * (start[i] - v[i])).sum();
        let step = (miss(&v) + along) / norm;
        v = std::array::from_fn(|i| start[i] - step * slope[i]);
    }
    assert!(miss(&v).abs() < 1e-12);
    focal_px
        * (0..4)
            .map(|i| (v[i] - start[i]).powi(2))
            .sum::<f64>()
            .sqrt()
}

#[test]
fn sampson_distance_agrees_with_brute_force() {
    for pair in pairs() {
        let epipolar = Epipolar::new(&pair).unwrap();
        for (i, (l, mut r)) in matches(&pair).into_iter().enumerate() {
            let off = 0.2 * (i as f64 % 11.0) - 1.0;
            let before = epipolar.row_difference(l, r).unwrap();
            r[1] += off;
            let after = epipolar.row_difference(l, r).unwrap();
            // A pixel down in the right image is about a row down, scaled by the local distortion.
            assert!((after - before) * off >= 0.0);
            assert!((after - before).abs() <= 2.5 * off.abs() + 1e-9);

            let sampson = epipolar.sampson_distance(l, r).unwrap();
            let tried = least_move(&pair, l, r, epipolar.focal_px());
            assert!(
                (sampson.abs() - tried).abs() < 1e-3 * tried + 1e-8,
                "{sampson} {tried}"
            );
            // For a rectified pair it is the row difference over the square root of 2.
            assert!((sampson.abs() * 2_f64.sqrt() - after.abs()).abs() < 0.15 * after.abs() + 1e-9);

            // Rows in the rectified images themselves.
            let view = camera_models::rectify::View::Focal(epipolar.focal_px());
            let rectified = camera_models::rectify::Rectification::new(&pair, view).unwrap();
            let row = |eye, px| rectified.new_pixel(eye, px).unwrap()[1];
            let rows = row(camera_models::Eye::Right, r) - row(camera_models::Eye::Left, l);
            assert!((rows - after).abs() < 1e-9);
            if i > 40 {
                break;
            }
        }
    }
}

#[test]
fn the_sign_is_that_of_the_right_row() {
    let rectified = {
        let mut pair = pair(Distortion::None);
        pair.right = pair.left;
        pair.right_from_left = RigidTransform::from_translation_m([-0.06, 0.0, 0.0]).unwrap();
        pair
    };
    let rows = row_difference(&rectified, [700.0, 300.0], [650.0, 302.0]).unwrap();
    let scale = Epipolar::new(&rectified).unwrap().focal_px() / rectified.left.fy;
    assert!((rows - 2.0 * scale).abs() < 1e-9, "{rows}");
    assert_eq!(
        row_difference(&rectified, [f64::NAN, 0.0], [0.0, 0.0]),
        None
    );
    let mut above = rectified;
    above.right_from_left = RigidTransform::from_translation_m([0.0, -0.06, 0.0]).unwrap();
    assert_eq!(row_difference(&above, [700.0, 300.0], [650.0, 302.0]), None);
}

#[test]
fn the_factory_file_of_a_zed_mini() {
    let Some(path) = shared("06_calibration/zed/SN10028708.conf") else {
        return;
    };
    let (pair, _) = calibration_files::read_stereo(&path, 1280, 720).unwrap();
    let r = Rectification::new(&pair, View::Filled).unwrap();
    // The factory principal points differ by 47 rows between the eyes, which rectification removes.
    assert!((r.camera.fx - 700.0).abs() < 150.0, "{:?}", r.camera);
    let (l, right) = ([640.0, 382.0], [600.0, 334.0]);
    let rows = row_difference(&pair, l, right).unwrap();
    assert!(rows.abs() < 3.0, "{rows}");
}
