use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};

use nalgebra::{Vector2, Vector3};

use super::forward::pixels;
use super::*;
use crate::camera::{Camera, Shutter};
use crate::config::RenderConfig;
use crate::scene::{Exposure, Plane, Sky, Splat, Splats};
use gaussians::harmonics;

pub(crate) fn random_splats(seed: u64, count: usize, degree: usize) -> Splats {
    gaussians::random_splats(seed, count, degree, -2.6).unwrap()
}

/// A small camera, slightly rotated and translated.
pub(crate) fn camera(size: (u32, u32), distortion: Distortion) -> Camera {
    let (w, h) = (f64::from(size.0), f64::from(size.1));
    let model = CameraModel::new(size, [0.8 * w, 0.83 * w, 0.47 * w, 0.52 * h], distortion);
    let pose = RigidTransform::from_rotation_vector([0.05, -0.08, 0.1], [0.03, -0.02, 0.1]);
    Camera::new(model, pose.unwrap()).unwrap()
}

pub(crate) fn shutter() -> Shutter {
    Shutter {
        time_gradient_s_per_px: [2e-5, 9e-4],
        reference_px: [10.0, 12.0],
        velocity_m_s: [1.3, -0.4, 0.8],
        rate_rad_s: [0.4, -0.9, 0.3],
    }
}

pub(crate) fn exposure() -> Exposure {
    Exposure {
        matrix: [
            [1.2, 0.05, 0.0, 0.02],
            [-0.03, 0.9, 0.02, -0.01],
            [0.0, 0.04, 1.1, 0.03],
        ],
    }
}

/// Weights of a loss that is linear in the image.
fn weights(pixels: usize, seed: u64) -> ImageGradient {
    let bell = |k: u64, i: usize| counter_random::bell(seed, k, i as u64);
    ImageGradient {
        rgb: (0..pixels)
            .map(|i| std::array::from_fn(|c| bell(c as u64, i)))
            .collect(),
        expected_depth: (0..pixels).map(|i| 0.2 * bell(4, i)).collect(),
        alpha: (0..pixels).map(|i| bell(5, i)).collect(),
    }
}

fn loss(image: &Image, weights: &ImageGradient) -> f64 {
    let mut sum = 0.0;
    for i in 0..image.rgb.len() {
        sum += (0..3)
            .map(|c| image.rgb[i][c] * weights.rgb[i][c])
            .sum::<f64>();
        if !image.expected_depth_m[i].is_nan() {
            sum += image.expected_depth_m[i] * weights.expected_depth[i];
        }
        sum += image.alpha[i] * weights.alpha[i];
    }
    sum
}

/// Without the steps at the smallest alpha and at saturation, so that differences exist.
fn smooth(compensate: bool) -> RenderConfig {
    RenderConfig {
        min_alpha: 1e-15,
        min_transmittance: 0.0,
        compensate,
        ..RenderConfig::default()
    }
}

struct Case {
    scene: Scene,
    camera: Camera,
    config: RenderConfig,
    name: &'static str,
}

fn cases() -> Vec<Case> {
    let scene = |seed: u64, degree: usize| {
        Scene::from(&crate::Scene {
            splats: random_splats(seed, 12, degree),
            background: crate::Background::Constant([0.3, 0.1, 0.6]),
        })
    };
    let fisheye = Distortion::KannalaBrandt4 {
        k1: 0.03,
        k2: -0.01,
        k3: 0.002,
        k4: 0.0,
    };
    let radial = Distortion::RadTan5 {
        k1: -0.2,
        k2: 0.05,
        p1: 2e-3,
        p2: -1e-3,
        k3: 0.0,
    };
    let pinhole = || camera((24, 18), Distortion::None);
    let mut texels = Vec::new();
    for i in 0..64 {
        texels.push(std::array::from_fn(|c| {
            counter_random::uniform(8, c as u64, i) as f32
        }));
    }
    let mut under_sky = scene(6, 0);
    under_sky.background = Background::Sky(Sky::from_texels(8, texels).unwrap());
    let case = |name, scene, camera, compensate| Case {
        scene,
        camera,
        config: smooth(compensate),
        name,
    };
    vec![
        case("degree 0", scene(1, 0), pinhole(), false),
        case("degree 3", scene(2, 3), pinhole(), false),
        case("compensated", scene(3, 1), pinhole(), true),
        case(
            "shutter",
            scene(4, 1),
            pinhole().with_shutter(shutter()).unwrap(),
            true,
        ),
        case("radial", scene(5, 2), camera((24, 18), radial), false),
        case(
            "fisheye",
            scene(7, 1),
            camera((24, 18), fisheye).with_shutter(shutter()).unwrap(),
            true,
        ),
        Case {
            config: RenderConfig {
                max_slope_share: 0.02,
                ..smooth(true)
            },
            ..case(
                "bounded slope",
                scene(8, 1),
                pinhole().with_shutter(shutter()).unwrap(),
                true,
            )
        },
        case("sky", under_sky, pinhole(), false),
    ]
}

/// Central difference of a function at 0.
fn difference(of: impl Fn(f64) -> f64, step: f64) -> f64 {
    // Richardson's extrapolation of two steps.
    let at = |h: f64| (of(h) - of(-h)) / (2.0 * h);
    (4.0 * at(step) - at(2.0 * step)) / 3.0
}

/// Size of the largest gradient.
fn largest(gradients: &[f64]) -> f64 {
    gradients.iter().map(|v| v.abs()).fold(0.0, f64::max)
}

fn check(name: &str, what: &str, found: f64, expected: f64, size: f64) {
    let tolerance = 2e-6 * (size + expected.abs());
    assert!(
        (found - expected).abs() < tolerance,
        "{name}, {what}: {found}, differences {expected}"
    );
}

#[test]
fn gradients_equal_finite_differences_for_every_parameter() {
    for case in cases() {
        let Case {
            scene,
            camera,
            config,
            name,
        } = &case;
        let w = weights(camera.pixels(), 3);
        let found = backward(scene, camera, &exposure(), config, &w);
        let mut changed = 0;
        for plane in 0..scene.planes.len() {
            let size = largest(&found.planes[plane]);
            for index in 0..scene.planes[plane].len() {
                let at = |h: f64| {
                    let mut moved = scene.clone();
                    moved.planes[plane][index] += h;
                    loss(&render(&moved, camera, &exposure(), config), &w)
                };
                let expected = difference(at, 1e-5);
                changed += usize::from(expected != 0.0);
                let what = format!("plane {plane} of {index}");
                check(name, &what, found.planes[plane][index], expected, size);
            }
        }
        assert!(
            changed > scene.planes.len() * 6,
            "{name}: {changed} gradients"
        );
    }
}

#[test]
fn gradients_of_pose_and_exposure_equal_finite_differences() {
    for case in cases() {
        let Case {
            scene,
            camera,
            config,
            name,
        } = &case;
        let w = weights(camera.pixels(), 4);
        let found = backward(scene, camera, &exposure(), config, &w);
        for k in 0..6 {
            if matches!(scene.background, Background::Sky(_)) {
                continue;
            }
            let at = |h: f64| {
                let mut v = [0.0; 6];
                v[k] = h;
                let motion =
                    RigidTransform::from_rotation_vector([v[3], v[4], v[5]], [v[0], v[1], v[2]]);
                let moved = motion.unwrap().inverse() * *camera.camera_from_world();
                let camera = camera.clone().with_pose(moved);
                loss(&render(scene, &camera, &exposure(), config), &w)
            };
            let size = largest(found.motion.as_slice());
            check(
                name,
                &format!("motion {k}"),
                found.motion[k],
                difference(at, 1e-5),
                size,
            );
        }
        // The loss is linear in the matrix.
        let base = loss(&render(scene, camera, &exposure(), config), &w);
        let size = largest(found.exposure.as_flattened());
        for k in 0..12 {
            let (row, column) = (k / 4, k % 4);
            let mut e = exposure();
            e.matrix[row][column] += 0.5;
            let step = f64::from(e.matrix[row][column]) - f64::from(exposure().matrix[row][column]);
            let expected = (loss(&render(scene, camera, &e, config), &w) - base) / step;
            check(
                name,
                &format!("exposure {k}"),
                found.exposure[row][column],
                expected,
                size,
            );
        }
    }
}

#[test]
fn gradients_of_a_sky_equal_finite_differences() {
    let case = cases().pop().unwrap();
    let Case {
        scene,
        camera,
        config,
        name,
    } = &case;
    let w = weights(camera.pixels(), 5);
    let found = backward(scene, camera, &exposure(), config, &w);
    let Background::Sky(sky) = &scene.background else {
        panic!("the last case has a sky");
    };
    let base = loss(&render(scene, camera, &exposure(), config), &w);
    let mut changed = 0;
    for texel in 0..64 {
        for c in 0..3 {
            let mut texels = sky.texels().to_vec();
            texels[texel][c] += 0.5;
            let step = f64::from(texels[texel][c]) - f64::from(sky.texels()[texel][c]);
            let mut moved = scene.clone();
            moved.background = Background::Sky(Sky::from_texels(8, texels).unwrap());
            // Linear in the texels, up to their rounding to f32 in the lookup.
            let expected = (loss(&render(&moved, camera, &exposure(), config), &w) - base) / step;
            let found = found.background[texel][c];
            assert!(
                (found - expected).abs() < 1e-5,
                "{name}: {found} {expected}"
            );
            changed += usize::from(expected != 0.0);
        }
    }
    assert!(changed > 20, "{changed}");
}

#[test]
fn rolling_shutter_equals_evaluation_of_each_pixel_at_its_own_time() {
    // Without dilation, one Gaussian whose mean moves by v Δt and keeps its shape.
    let splats = {
        let mut splats = Splats::empty(0).unwrap();
        let mut splat = Splat::sphere(0.15, [0.9, 0.5, 0.2]);
        splat.position_m = [0.1, -0.05, 2.0];
        splat.log_scale = [-2.0, -1.5, -2.2];
        splat.opacity_logit = 2.0;
        splats.push(&splat).unwrap();
        splats
    };
    let scene = crate::Scene {
        splats,
        background: crate::Background::Constant([0.0; 3]),
    };
    let scene = Scene::from(&scene);
    let still = camera((40, 30), Distortion::None);
    let moving = still.clone().with_shutter(shutter()).unwrap();
    let config = RenderConfig {
        dilation_px2: 0.0,
        min_alpha: 1e-9,
        ..RenderConfig::default()
    };
    let footprint = footprint::all(&scene, &still, &config).remove(0);
    let jacobian = still
        .lens()
        .project_with_jacobians(
            still
                .camera_from_world()
                .apply([0.1_f32, -0.05_f32, 2.0].map(f64::from)),
        )
        .unwrap()
        .by_point;
    let p = still
        .camera_from_world()
        .apply([0.1_f32, -0.05_f32, 2.0].map(f64::from));
    let s = shutter();
    let u = Vector3::from(s.velocity_m_s) + Vector3::from(s.rate_rad_s).cross(&Vector3::from(p));
    let v = -(jacobian * u);
    let image = render(&scene, &moving, &Exposure::NONE, &config);
    for (i, (u, _)) in pixels(&scene, &moving).enumerate() {
        let time =
            Vector2::from(s.time_gradient_s_per_px).dot(&(u - Vector2::from(s.reference_px)));
        let d = u - footprint.mean - v * time;
        let alpha = footprint.opacity * (-0.5 * d.dot(&(footprint.conic * d))).exp();
        let expected = if alpha < 1e-9 { 0.0 } else { alpha };
        assert!(
            (image.alpha[i] - expected).abs() < 1e-9,
            "{i}: {} {expected}",
            image.alpha[i]
        );
    }
}

#[test]
fn median_depth_is_that_of_a_surface_and_expected_depth_the_mean() {
    let mut splats = Splats::empty(0).unwrap();
    for (z, opacity_logit) in [(1.0, -1.0), (2.0, 0.5), (3.0, 0.5)] {
        let mut splat = Splat::sphere(5.0, [0.5; 3]);
        splat.position_m = [0.0, 0.0, z];
        splat.opacity_logit = opacity_logit;
        splats.push(&splat).unwrap();
    }
    let scene = crate::Scene {
        splats,
        background: crate::Background::Constant([0.0; 3]),
    };
    let model = CameraModel::new((1, 1), [10.0, 10.0, 0.0, 0.0], Distortion::None);
    let camera = Camera::new(model, RigidTransform::identity()).unwrap();
    let config = RenderConfig::default();
    let image = render(&Scene::from(&scene), &camera, &Exposure::NONE, &config);
    let [a, b] = [-1.0, 0.5].map(|x: f64| 1.0 / (1.0 + (-x).exp()));
    let weights = [a, (1.0 - a) * b, (1.0 - a) * (1.0 - b) * b];
    let sum: f64 = weights.iter().sum();
    let mean = (weights[0] + 2.0 * weights[1] + 3.0 * weights[2]) / sum;
    assert!((image.alpha[0] - sum).abs() < 1e-9);
    assert!((image.expected_depth_m[0] - mean).abs() < 1e-9);
    assert_eq!(image.median_depth_m[0], 2.0);
}

#[test]
fn a_slanted_disc_has_the_depth_of_its_plane_up_to_its_bound() {
    let tilt = 70_f64.to_radians();
    let position = Vector3::new(0.2, -0.1, 2.0);
    let mut disc = Splat::sphere(0.05, [0.5; 3]);
    disc.position_m = [0.2, -0.1, 2.0];
    disc.log_scale[2] = -8.0;
    disc.rotation_wxyz = [
        (0.5 * tilt).cos() as f32,
        (0.5 * tilt).sin() as f32,
        0.0,
        0.0,
    ];
    disc.opacity_logit = 9.0;
    let mut splats = Splats::empty(0).unwrap();
    splats.push(&disc).unwrap();
    let scene = Scene::from(&crate::Scene {
        splats,
        background: crate::Background::Constant([0.0; 3]),
    });
    let normal = Vector3::new(0.0, -tilt.sin(), tilt.cos());
    let fisheye = Distortion::KannalaBrandt4 {
        k1: 0.03,
        k2: -0.01,
        k3: 0.002,
        k4: 0.0,
    };
    let config = |slope_dilation_px2: f32, max_slope_share: f32| RenderConfig {
        slope_dilation_px2,
        max_slope_share,
        ..RenderConfig::default()
    };
    for distortion in [Distortion::None, fisheye] {
        let model = CameraModel::new((96, 72), [200.0, 200.0, 47.0, 35.0], distortion);
        let camera = Camera::new(model, RigidTransform::identity()).unwrap();
        // Errors against the plane, and depths, m.
        let depths = |config: &RenderConfig| {
            let image = render(&scene, &camera, &Exposure::NONE, config);
            let (mut errors, mut all) = (Vec::new(), Vec::new());
            for (i, (u, _)) in pixels(&scene, &camera).enumerate() {
                let depth = image.median_depth_m[i];
                if depth.is_nan() {
                    continue;
                }
                let ray = Vector3::from(camera.lens().unproject(u.into()).unwrap());
                let expected = normal.dot(&position) / normal.dot(&ray) * ray.z;
                errors.push((depth - expected).abs());
                all.push(depth);
            }
            all.sort_by(f64::total_cmp);
            (errors.into_iter().fold(0.0, f64::max), all)
        };
        let (error, all) = depths(&config(1e-3, 0.5));
        let change = all[all.len() - 1] - all[0];
        assert!(
            all.len() > 20 && change > 0.08 && error < 0.004,
            "{} pixels, {change} m, worst {error} m",
            all.len()
        );
        // A mean for all, and a tenth of the distance at most within the ellipse.
        let (error, all) = depths(&config(1e-3, 0.0));
        assert!(error > 0.04 && all.iter().all(|z| (z - 2.0).abs() < 1e-6));
        let (_, all) = depths(&config(1e-3, 0.02));
        let change = all[all.len() - 1] - all[0];
        assert!((0.01..0.08).contains(&change), "{change} m");
    }
}

#[test]
fn harmonics_are_orthonormal_on_the_sphere() {
    // A product rule that is exact for these degrees would be better; a dense one suffices.
    let n = 200;
    let mut sums = [[0.0; 16]; 16];
    for i in 0..n {
        let z = (i as f64 + 0.5) / n as f64 * 2.0 - 1.0;
        for j in 0..n {
            let a = (j as f64 + 0.5) / n as f64 * std::f64::consts::TAU;
            let r = (1.0 - z * z).sqrt();
            let y = harmonics::values(Vector3::new(r * a.cos(), r * a.sin(), z), 16);
            for k in 0..16 {
                for l in 0..16 {
                    sums[k][l] += y[k].0 * y[l].0 * 4.0 * std::f64::consts::PI / (n * n) as f64;
                }
            }
        }
    }
    for (k, row) in sums.iter().enumerate() {
        for (l, sum) in row.iter().enumerate() {
            let expected = f64::from(u8::from(k == l));
            assert!((sum - expected).abs() < 1e-3, "{k} {l} {sum}");
        }
    }
    // The signs of the published files, at a direction without symmetry.
    let y = harmonics::values(Vector3::new(0.48, 0.6, 0.64), 16);
    assert!(y[1].0 < 0.0 && y[2].0 > 0.0 && y[3].0 < 0.0 && y[9].0 < 0.0 && y[15].0 > 0.0);
    assert_eq!(Plane::count(3), 59);
}
