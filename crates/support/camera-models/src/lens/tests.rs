use proptest::prelude::*;

use super::*;

/// Lenses of every family: mild, strong, and some that are not monotonic inside a wide image.
fn models() -> Vec<CameraModel> {
    let (p1, p2) = (3e-4, -2e-4);
    let distortions = [
        Distortion::None,
        Distortion::Radial2 { k1: -0.3, k2: 0.1 },
        Distortion::RadTan4 {
            k1: -0.28,
            k2: 0.07,
            p1,
            p2,
        },
        // A ZED Mini's factory values are not monotonic beyond 58 degrees.
        Distortion::RadTan5 {
            k1: -0.17,
            k2: 0.026,
            p1,
            p2,
            k3: -0.001,
        },
        Distortion::Rational8 {
            k1: 0.3,
            k2: 0.1,
            p1,
            p2,
            k3: 1e-3,
            k4: 0.5,
            k5: 0.1,
            k6: 0.01,
        },
        Distortion::KannalaBrandt4 {
            k1: 0.02,
            k2: -0.01,
            k3: 1e-3,
            k4: -1e-4,
        },
        // TUM-VI's and EuRoC's as Basalt gives them, rounded.
        Distortion::DoubleSphere {
            xi: -0.29,
            alpha: 0.57,
        },
        Distortion::DoubleSphere {
            xi: 0.1,
            alpha: 0.3,
        },
        Distortion::Eucm {
            alpha: 0.63,
            beta: 1.04,
        },
    ];
    distortions
        .into_iter()
        .map(|distortion| CameraModel {
            width: 752,
            height: 480,
            fx: 458.0,
            fy: 457.0,
            cx: 367.0,
            cy: 248.0,
            distortion,
        })
        .collect()
}

proptest! {
    #[test]
    fn projection_and_jacobians_agree_with_dual_numbers(x in -2.0..2.0, y in -2.0..2.0, z in 0.2..3.0) {
        for model in models() {
            let lens = Lens::new(&model);
            let Some(found) = lens.project_with_jacobians([x, y, z]) else { continue };
            prop_assert_eq!(Some(found.pixel), lens.project([x, y, z]));
            for (row, dual) in dual::project(&model, [x, y, z]).into_iter().enumerate() {
                let off = |a: f64, b: f64| (a - b).abs() / (1.0 + b.abs());
                // Both are f64; what differs is the order of operations.
                prop_assert!(off(found.pixel[row], dual.value) < 1e-12, "{model:?}");
                for i in 0..3 {
                    prop_assert!(off(found.by_point[(row, i)], dual.by[i]) < 1e-10, "{model:?}");
                }
                for i in 0..CameraModel::MAX_PARAMETERS {
                    let own = found.by_parameters[(row, i)];
                    prop_assert!(off(own, dual.by[3 + i]) < 1e-10, "{model:?} {i}");
                }
            }
        }
    }

    #[test]
    fn jacobians_agree_with_differences(x in -1.0..1.0, y in -1.0..1.0, z in 0.8..3.0) {
        const H: f64 = 1e-6;
        for model in models() {
            let lens = Lens::new(&model);
            let Some(found) = lens.project_with_jacobians([x, y, z]) else { continue };
            let parameters = model.parameters();
            let moved = |column: usize, by: f64| {
                let (mut point, mut parameters) = ([x, y, z], parameters.clone());
                match column {
                    0..3 => point[column] += by,
                    _ => parameters[column - 3] += by,
                }
                Lens::new(&model.with_parameters(&parameters)).project(point)
            };
            for column in 0..3 + parameters.len() {
                let (Some(after), Some(before)) = (moved(column, H), moved(column, -H)) else { continue };
                for row in 0..2 {
                    let difference = (after[row] - before[row]) / (2.0 * H);
                    let own = match column {
                        0..3 => found.by_point[(row, column)],
                        _ => found.by_parameters[(row, column - 3)],
                    };
                    // The third derivative times H² / 6, and 1e-13 px over H.
                    let off = (own - difference).abs() / (1.0 + difference.abs());
                    prop_assert!(off < 1e-5, "{model:?} column {column}: {own} {difference}");
                }
            }
        }
    }

    #[test]
    fn unproject_then_project_returns_the_pixel(u in -0.5..751.5, v in -0.5..479.5) {
        for model in models() {
            let lens = Lens::new(&model);
            let Some(direction) = lens.unproject([u, v]) else {
                prop_assert!(!lens.covers_image(), "{model:?}");
                continue;
            };
            let length: f64 = direction.iter().map(|d| d * d).sum();
            prop_assert!((length - 1.0).abs() < 1e-12);
            let pixel = lens.project(direction.map(|d| 2.5 * d)).expect("in the domain");
            prop_assert!((pixel[0] - u).abs().max((pixel[1] - v).abs()) < 1e-9, "{model:?} {pixel:?}");
        }
    }

    #[test]
    fn project_then_unproject_returns_the_direction(angle in 0.0..3.1f64, around in 0.0..std::f64::consts::TAU) {
        for model in models() {
            let lens = Lens::new(&model);
            // At the very end of the domain the inverse loses its digits.
            let inside = angle < 0.99 * lens.widest_rad();
            let point = [angle.sin() * around.cos(), angle.sin() * around.sin(), angle.cos()];
            let Some(pixel) = lens.project(point) else {
                prop_assert!(!inside, "{model:?}");
                continue;
            };
            if !inside { continue }
            let back = lens.unproject(pixel).expect("a pixel of the domain");
            for i in 0..3 {
                prop_assert!((back[i] - point[i]).abs() < 1e-7, "{model:?} {point:?} {back:?}");
            }
        }
    }
}

#[test]
fn domain_ends_before_the_image_folds() {
    // With k1 alone, the distortion has its maximum where 1 + 3 k1 r² = 0.
    let model = CameraModel {
        distortion: Distortion::Radial2 { k1: -0.3, k2: 0.0 },
        ..models()[0]
    };
    let lens = Lens::new(&model);
    let radius = (1.0f64 / 0.9).sqrt();
    assert!((lens.widest_rad() - radius.atan()).abs() < 1e-9);
    assert!(lens.project([radius * 0.999, 0.0, 1.0]).is_some());
    assert_eq!(lens.project([radius * 1.001, 0.0, 1.0]), None);
    // The largest radius that any pixel can have is two thirds of that.
    let edge = 2.0 / 3.0 * radius;
    let pixel = |r: f64| [model.fx * r + model.cx, model.cy];
    assert!(lens.unproject(pixel(edge * 0.999)).is_some());
    assert_eq!(lens.unproject(pixel(edge * 1.001)), None);
    // A pinhole has nothing behind it; a fisheye sees more than half of the world.
    assert_eq!(Lens::new(&models()[0]).project([0.1, 0.1, -1.0]), None);
    let wide = Distortion::KannalaBrandt4 {
        k1: 0.0,
        k2: 0.0,
        k3: 0.0,
        k4: 0.0,
    };
    let fisheye = Lens::new(&CameraModel {
        distortion: wide,
        ..model
    });
    assert!(fisheye.project([1.0, 0.0, -0.5]).is_some());
    assert_eq!(fisheye.project([0.0, 0.0, -1.0]), None);
}

#[test]
fn points_without_direction_have_no_pixel() {
    for model in models() {
        let lens = Lens::new(&model);
        assert_eq!(lens.project([0.0; 3]), None, "{model:?}");
        assert_eq!(lens.project([f64::NAN, 0.0, 1.0]), None, "{model:?}");
        assert_eq!(lens.unproject([f64::NAN, 0.0]), None, "{model:?}");
        let [u, v] = lens.project([0.0, 0.0, 2.0]).expect("the axis");
        assert!((u - model.cx).abs() < 1e-12 && (v - model.cy).abs() < 1e-12);
        let straight = lens
            .project_with_jacobians([0.0, 0.0, 2.0])
            .expect("the axis");
        // On the axis a small step moves every lens but the spheres' as a pinhole.
        let near = lens
            .project_with_jacobians([1e-7, 1e-7, 2.0])
            .expect("near the axis");
        assert!(
            (straight.by_point - near.by_point).amax() < 1e-3,
            "{model:?}"
        );
    }
}
