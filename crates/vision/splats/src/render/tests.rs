use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};

use super::project::Footprint;
use super::*;
use crate::camera::Camera;
use crate::config::RenderConfig;
use crate::lanes::Level;
use crate::reference;
use crate::reference::tests::{camera, exposure, random_splats, shutter};
use crate::scene::{Background, Exposure, Scene, Sky, Splat, Splats};

fn scene(splats: Splats) -> Scene {
    Scene {
        splats,
        background: Background::Constant([0.3, 0.1, 0.6]),
    }
}

/// Differences of an image from the reference's.
struct Deviation {
    /// Share of values with a difference above 2e-4: pixels at the step of the smallest alpha.
    outliers: f64,
    worst_color: f64,
    worst_alpha: f64,
    /// Shares of pixels with other depths, above 1e-4 of the depth.
    expected_depth: f64,
    median_depth: f64,
}

fn deviation(scene: &Scene, camera: &Camera, config: RenderConfig) -> Deviation {
    let renderer = Renderer::new(config).unwrap();
    let image = renderer.render(scene, camera, &exposure());
    let expected = reference::render(&reference::Scene::from(scene), camera, &exposure(), &config);
    let pixels = camera.pixels();
    let mut d = Deviation {
        outliers: 0.0,
        worst_color: 0.0,
        worst_alpha: 0.0,
        expected_depth: 0.0,
        median_depth: 0.0,
    };
    let share = 1.0 / pixels as f64;
    let other = |found: f32, expected: f64| match (found.is_nan(), expected.is_nan()) {
        (false, false) => (f64::from(found) - expected).abs() > 1e-4 * expected,
        (a, b) => a != b,
    };
    for i in 0..pixels {
        for c in 0..3 {
            let error = (f64::from(image.rgb[c][i]) - expected.rgb[i][c]).abs();
            d.worst_color = d.worst_color.max(error);
            d.outliers += f64::from(u8::from(error > 2e-4)) * share / 3.0;
        }
        d.worst_alpha = d
            .worst_alpha
            .max((f64::from(image.alpha[i]) - expected.alpha[i]).abs());
        let expected_depth = expected.expected_depth_m[i];
        d.expected_depth +=
            f64::from(u8::from(other(image.expected_depth_m[i], expected_depth))) * share;
        let median_depth = expected.median_depth_m[i];
        d.median_depth += f64::from(u8::from(other(image.median_depth_m[i], median_depth))) * share;
    }
    d
}

/// One step of 8 bits per Gaussian at the step of the smallest alpha, and few of them.
fn check(name: &str, scene: &Scene, camera: &Camera, config: RenderConfig) {
    let d = deviation(scene, camera, config);
    let (color, alpha) = (d.worst_color, d.worst_alpha);
    assert!(
        d.outliers < 2e-3,
        "{name}: {} of the values differ",
        d.outliers
    );
    assert!(
        color < 0.02 && alpha < 0.01,
        "{name}: colors by {color}, alpha by {alpha}"
    );
    assert!(
        d.expected_depth < 2e-3,
        "{name}: {} of expected depths",
        d.expected_depth
    );
    assert!(
        d.median_depth < 2e-3,
        "{name}: {} of median depths",
        d.median_depth
    );
}

#[test]
fn random_scenes_equal_the_reference() {
    let plain = RenderConfig::default();
    let compensated = RenderConfig {
        compensate: true,
        dilation_px2: 0.1,
        ..plain
    };
    for seed in 0..6 {
        let splats = random_splats(seed, 300, seed as usize % 4);
        let pinhole = camera((75, 53), Distortion::None);
        check("pinhole", &scene(splats.clone()), &pinhole, plain);
        check("compensated", &scene(splats.clone()), &pinhole, compensated);
        let rolling = pinhole.clone().with_shutter(shutter()).unwrap();
        check("shutter", &scene(splats.clone()), &rolling, plain);
        let radial = Distortion::RadTan5 {
            k1: -0.2,
            k2: 0.05,
            p1: 2e-3,
            p2: -1e-3,
            k3: 0.0,
        };
        check(
            "radial",
            &scene(splats.clone()),
            &camera((75, 53), radial),
            plain,
        );
        let fisheye = Distortion::KannalaBrandt4 {
            k1: 0.03,
            k2: -0.01,
            k3: 0.002,
            k4: 0.0,
        };
        check(
            "fisheye",
            &scene(splats.clone()),
            &camera((64, 64), fisheye),
            plain,
        );
        let texels = (0..256)
            .map(|i| std::array::from_fn(|c| counter_random::uniform(seed, c as u64, i) as f32));
        let sky = Sky::from_texels(16, texels.collect()).unwrap();
        let under_sky = Scene {
            splats,
            background: Background::Sky(sky),
        };
        check("sky", &under_sky, &pinhole, plain);
    }
}

/// Cases in which renderers fail.
fn bad_cases() -> Vec<(&'static str, Splat)> {
    let base = Splat {
        position_m: [0.1, 0.0, 2.0],
        opacity_logit: 1.0,
        ..Splat::sphere(0.2, [0.9, 0.5, 0.1])
    };
    let ln = |v: f32| v.ln();
    vec![
        (
            "behind",
            Splat {
                position_m: [0.0, 0.0, -2.0],
                ..base
            },
        ),
        (
            "at the camera",
            Splat {
                position_m: [0.0, 0.0, 0.0],
                ..base
            },
        ),
        (
            "nearer than the near plane, large",
            Splat {
                position_m: [0.0, 0.0, 0.02],
                log_scale: [1.0; 3],
                ..base
            },
        ),
        (
            "at the near plane",
            Splat {
                position_m: [0.01, 0.0, -0.04],
                ..base
            },
        ),
        (
            "beside the image, large",
            Splat {
                position_m: [-6.0, 0.5, 1.0],
                log_scale: [ln(2.0); 3],
                ..base
            },
        ),
        (
            "at the border",
            Splat {
                position_m: [1.15, 0.7, 2.0],
                ..base
            },
        ),
        (
            "a needle",
            Splat {
                log_scale: [ln(2.0), ln(1e-6), ln(1e-6)],
                rotation_wxyz: [0.9, 0.2, 0.3, 0.1],
                ..base
            },
        ),
        (
            "a disc seen from its edge",
            Splat {
                log_scale: [ln(0.5), ln(1e-7), ln(0.5)],
                ..base
            },
        ),
        (
            "a point",
            Splat {
                log_scale: [-20.0; 3],
                ..base
            },
        ),
        (
            "a scale of 0 in f32",
            Splat {
                log_scale: [-200.0; 3],
                ..base
            },
        ),
        (
            "huge",
            Splat {
                log_scale: [ln(100.0); 3],
                ..base
            },
        ),
        (
            "huge and thin",
            Splat {
                log_scale: [ln(300.0), ln(0.01), ln(300.0)],
                rotation_wxyz: [0.9, 0.1, 0.0, 0.3],
                ..base
            },
        ),
        (
            "opaque",
            Splat {
                opacity_logit: 40.0,
                ..base
            },
        ),
        (
            "infinitely opaque in f32",
            Splat {
                opacity_logit: 1e30,
                ..base
            },
        ),
        (
            "transparent",
            Splat {
                opacity_logit: -40.0,
                ..base
            },
        ),
        (
            "at the smallest alpha",
            Splat {
                opacity_logit: -5.535,
                ..base
            },
        ),
        (
            "a long quaternion",
            Splat {
                rotation_wxyz: [300.0, -200.0, 100.0, 50.0],
                ..base
            },
        ),
        (
            "a short quaternion",
            Splat {
                rotation_wxyz: [3e-4, -2e-4, 1e-4, 0.0],
                ..base
            },
        ),
        (
            "far",
            Splat {
                position_m: [10.0, 5.0, 5e4],
                log_scale: [ln(3e3); 3],
                ..base
            },
        ),
        (
            "farther than the far plane",
            Splat {
                position_m: [0.0, 0.0, 2e5],
                log_scale: [ln(3e4); 3],
                ..base
            },
        ),
        (
            "a dark color",
            Splat {
                harmonics: [[-50.0; 3]; 16],
                ..base
            },
        ),
        (
            "a bright color",
            Splat {
                harmonics: [[20.0; 3]; 16],
                ..base
            },
        ),
    ]
}

#[test]
fn bad_cases_equal_the_reference() {
    let camera = camera((75, 53), Distortion::None);
    for (name, splat) in bad_cases() {
        for compensate in [false, true] {
            let config = RenderConfig {
                compensate,
                ..RenderConfig::default()
            };
            let mut splats = Splats::empty(0).unwrap();
            splats.push(&splat).unwrap();
            check(name, &scene(splats.clone()), &camera, config);
            // Among others, in the middle of a vector.
            let mut among = random_splats(9, 12, 0);
            among.push(&splat).unwrap();
            let d = deviation(&scene(among), &camera, config);
            assert!(
                d.worst_color < 0.1 && d.outliers < 5e-3,
                "{name}: {} {}",
                d.worst_color,
                d.outliers
            );
        }
    }
}

#[test]
fn unrepresentable_gaussians_are_counted_and_not_rendered() {
    let mut splats = Splats::empty(0).unwrap();
    let mut splat = Splat {
        position_m: [0.0, 0.0, 2.0],
        ..Splat::sphere(0.1, [0.5; 3])
    };
    splat.log_scale = [60.0; 3];
    splats.push(&splat).unwrap();
    let renderer = Renderer::new(RenderConfig::default()).unwrap();
    let camera = camera((20, 20), Distortion::None);
    let pass = renderer.forward(&scene(splats), &camera, &Exposure::NONE);
    assert_eq!((pass.stats.degenerate, pass.stats.visible), (1, 0));
    assert!(pass.image.alpha.iter().all(|alpha| *alpha == 0.0));
}

#[test]
fn empty_scenes_and_images_of_one_pixel_are_rendered() {
    let renderer = Renderer::new(RenderConfig::default()).unwrap();
    let empty = scene(Splats::empty(0).unwrap());
    let image = renderer.render(&empty, &camera((17, 33), Distortion::None), &Exposure::NONE);
    assert!(image.rgb[2].iter().all(|blue| *blue == 0.6));
    assert!(image.expected_depth_m.iter().all(|depth| depth.is_nan()));
    let model = CameraModel::new((1, 1), [1.0, 1.0, 0.0, 0.0], Distortion::None);
    let one = Camera::new(model, RigidTransform::identity()).unwrap();
    check(
        "one pixel",
        &scene(random_splats(1, 50, 1)),
        &one,
        RenderConfig::default(),
    );
}

#[test]
fn levels_and_threads_give_the_same_bytes() {
    let scene = scene(random_splats(3, 5000, 2));
    let camera = camera((150, 101), Distortion::None)
        .with_shutter(shutter())
        .unwrap();
    let renderer = Renderer::new(RenderConfig::default()).unwrap();
    let bits = |image: &Image| -> Vec<u32> {
        let planes =
            image
                .rgb
                .iter()
                .chain([&image.expected_depth_m, &image.median_depth_m, &image.alpha]);
        planes
            .flatten()
            .map(|v| if v.is_nan() { 1 } else { v.to_bits() })
            .collect()
    };
    let expected = bits(&renderer.render(&scene, &camera, &exposure()));
    for level in Level::all() {
        let renderer = renderer.clone().with_level(level);
        assert!(
            bits(&renderer.render(&scene, &camera, &exposure())) == expected,
            "{level:?}"
        );
    }
    for threads in [1, 2, 4] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let image = pool.install(|| renderer.render(&scene, &camera, &exposure()));
        assert!(bits(&image) == expected, "{threads} threads");
    }
    let batch = renderer.render_batch(&scene, &[camera.clone(), camera], &exposure());
    assert!(batch.iter().all(|image| bits(image) == expected));
}

#[test]
fn order_is_that_of_a_stable_sort() {
    let footprints: Vec<Footprint> = (0..10_000)
        .map(|i| Footprint {
            z: 0.05
                + (counter_random::bits(1, 2, i) % 997) as f32
                    * if i % 3 == 0 { 1e-3 } else { 50.0 },
            ..Footprint::default()
        })
        .collect();
    let mut expected: Vec<u32> = (0..footprints.len() as u32).collect();
    expected.sort_by(|a, b| {
        footprints[*a as usize]
            .z
            .total_cmp(&footprints[*b as usize].z)
    });
    assert_eq!(order::by_depth(&footprints), expected);
    assert!(order::by_depth(&[]).is_empty());
}

#[test]
fn settings_outside_of_their_domain_are_refused() {
    let cases = [
        (
            "max_alpha",
            RenderConfig {
                max_alpha: 1.0,
                ..RenderConfig::default()
            },
        ),
        (
            "near_m",
            RenderConfig {
                near_m: 0.0,
                ..RenderConfig::default()
            },
        ),
        (
            "dilation_px2",
            RenderConfig {
                dilation_px2: f32::NAN,
                ..RenderConfig::default()
            },
        ),
        (
            "slope_dilation_px2",
            RenderConfig {
                slope_dilation_px2: 0.0,
                ..RenderConfig::default()
            },
        ),
        (
            "max_slope_share",
            RenderConfig {
                max_slope_share: 1.0,
                ..RenderConfig::default()
            },
        ),
    ];
    for (name, config) in cases {
        let error = Renderer::new(config).unwrap_err();
        assert!(error.to_string().contains(name), "{error}");
    }
}
