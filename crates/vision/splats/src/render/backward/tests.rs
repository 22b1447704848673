use camera_models::Distortion;

use super::*;
use crate::config::RenderConfig;
use crate::lanes::Level;
use crate::reference;
use crate::reference::tests::{camera, exposure, random_splats, shutter};
use crate::scene::{Background, Sky};

fn gradient(pixels: usize, seed: u64) -> ImageGradient {
    let bell = |k: u64, i: usize| counter_random::bell(seed, k, i as u64) as f32;
    let plane = |k: u64, scale: f32| (0..pixels).map(|i| scale * bell(k, i)).collect::<Vec<_>>();
    ImageGradient {
        rgb: [plane(0, 1.0), plane(1, 1.0), plane(2, 1.0)],
        expected_depth: plane(3, 0.2),
        alpha: plane(4, 1.0),
        error: plane(5, 1.0).into_iter().map(f32::abs).collect(),
    }
}

fn in_f64(of: &ImageGradient) -> reference::ImageGradient {
    let wide = |plane: &Vec<f32>| plane.iter().map(|v| f64::from(*v)).collect::<Vec<_>>();
    let pixels = of.alpha.len();
    reference::ImageGradient {
        rgb: (0..pixels)
            .map(|i| std::array::from_fn(|c| f64::from(of.rgb[c][i])))
            .collect(),
        expected_depth: wide(&of.expected_depth),
        alpha: wide(&of.alpha),
    }
}

/// Root of the sum of squares of the difference, and of the expected values.
fn norms(pairs: impl Iterator<Item = (f64, f64)>) -> (f64, f64) {
    let (mut difference, mut size) = (0.0, 0.0);
    for (found, expected) in pairs {
        difference += (found - expected).powi(2);
        size += expected.powi(2);
    }
    (difference.sqrt(), size.sqrt())
}

fn check(name: &str, scene: &Scene, camera: &Camera, config: RenderConfig) {
    let renderer = Renderer::new(config).unwrap();
    let gradient = gradient(camera.pixels(), 7);
    let pass = renderer.forward(scene, camera, &exposure());
    let found = renderer
        .backward(scene, camera, &exposure(), &pass, &gradient)
        .unwrap();
    let wide = reference::Scene::from(scene);
    let expected = reference::backward(&wide, camera, &exposure(), &config, &in_f64(&gradient));
    let mut dense = vec![vec![0.0; scene.splats.len()]; found.planes.len()];
    for (dense, plane) in dense.iter_mut().zip(&found.planes) {
        for (index, value) in found.indices.iter().zip(plane) {
            dense[*index as usize] = f64::from(*value);
        }
    }
    for (plane, (dense, expected)) in dense.iter().zip(&expected.planes).enumerate() {
        let pairs = dense.iter().copied().zip(expected.iter().copied());
        let (difference, size) = norms(pairs);
        assert!(
            size > 0.0 && difference < 2e-3 * size,
            "{name}, plane {plane}: {difference} of {size}"
        );
    }
    let (difference, size) = norms(found.motion.into_iter().zip(expected.motion));
    assert!(
        difference < 2e-3 * size,
        "{name}, motion: {:?} {:?}",
        found.motion,
        expected.motion
    );
    let both = found
        .exposure
        .as_flattened()
        .iter()
        .zip(expected.exposure.as_flattened());
    let (difference, size) = norms(both.map(|(a, b)| (*a, *b)));
    assert!(
        difference < 1e-4 * size,
        "{name}, exposure: {difference} of {size}"
    );
    let both = found
        .background
        .as_flattened()
        .iter()
        .zip(expected.background.as_flattened());
    let (difference, size) = norms(both.map(|(a, b)| (f64::from(*a), *b)));
    assert!(
        size > 0.0 && difference < 1e-3 * size,
        "{name}, background: {difference} of {size}"
    );
}

/// Without the step at the smallest alpha, whose pixels differ in f32.
fn config(compensate: bool) -> RenderConfig {
    RenderConfig {
        min_alpha: 1e-5,
        compensate,
        ..RenderConfig::default()
    }
}

#[test]
fn gradients_equal_those_of_the_reference() {
    for seed in 0..4 {
        let scene = Scene {
            splats: random_splats(seed, 60, seed as usize),
            background: Background::Constant([0.3, 0.1, 0.6]),
        };
        let pinhole = camera((45, 37), Distortion::None);
        check("pinhole", &scene, &pinhole, config(false));
        check("compensated", &scene, &pinhole, config(true));
        let rolling = pinhole.clone().with_shutter(shutter()).unwrap();
        check("shutter", &scene, &rolling, config(true));
        let bounded = RenderConfig {
            max_slope_share: 0.02,
            ..config(true)
        };
        check("bounded slope", &scene, &rolling, bounded);
        let radial = Distortion::RadTan5 {
            k1: -0.2,
            k2: 0.05,
            p1: 2e-3,
            p2: -1e-3,
            k3: 0.0,
        };
        check("radial", &scene, &camera((45, 37), radial), config(false));
        let fisheye = Distortion::KannalaBrandt4 {
            k1: 0.03,
            k2: -0.01,
            k3: 0.002,
            k4: 0.0,
        };
        let fisheye = camera((32, 32), fisheye).with_shutter(shutter()).unwrap();
        check("fisheye", &scene, &fisheye, config(true));
        let texels = (0..64)
            .map(|i| std::array::from_fn(|c| counter_random::uniform(seed, c as u64, i) as f32));
        let sky = Sky::from_texels(8, texels.collect()).unwrap();
        let under_sky = Scene {
            background: Background::Sky(sky),
            ..scene
        };
        check("sky", &under_sky, &pinhole, config(false));
    }
}

#[test]
fn absolute_gradients_bound_the_signed_ones_and_weights_fill_the_image() {
    let scene = Scene {
        splats: random_splats(1, 60, 0),
        background: Background::Constant([0.0; 3]),
    };
    let camera = camera((45, 37), Distortion::None);
    let renderer = Renderer::new(RenderConfig::default()).unwrap();
    let pass = renderer.forward(&scene, &camera, &Exposure::NONE);
    let mut gradient = gradient(camera.pixels(), 1);
    gradient.error = vec![2.0; camera.pixels()];
    let found = renderer
        .backward(&scene, &camera, &Exposure::NONE, &pass, &gradient)
        .unwrap();
    let alpha: f32 = pass.image.alpha.iter().sum();
    let weight: f32 = found.weight.iter().sum();
    assert!((alpha - weight).abs() < 1e-3 * alpha, "{alpha} {weight}");
    for (error, weight) in found.error.iter().zip(&found.weight) {
        assert!((error - 2.0 * weight).abs() <= 1e-4 * weight);
    }
    assert!(found.absolute.iter().all(|[x, y]| *x >= 0.0 && *y >= 0.0));
    assert!(
        found
            .absolute
            .iter()
            .filter(|[x, y]| *x > 0.0 && *y > 0.0)
            .count()
            > 40
    );
}

#[test]
fn levels_and_threads_give_the_same_bytes() {
    let scene = Scene {
        splats: random_splats(3, 3000, 1),
        background: Background::Constant([0.1; 3]),
    };
    let camera = camera((150, 101), Distortion::None)
        .with_shutter(shutter())
        .unwrap();
    let gradient = gradient(camera.pixels(), 2);
    let renderer = Renderer::new(RenderConfig::default()).unwrap();
    let run = |renderer: &Renderer| {
        let pass = renderer.forward(&scene, &camera, &exposure());
        renderer
            .backward(&scene, &camera, &exposure(), &pass, &gradient)
            .unwrap()
    };
    let expected = run(&renderer);
    for level in Level::all() {
        assert!(
            run(&renderer.clone().with_level(level)) == expected,
            "{level:?}"
        );
    }
    for threads in [1, 2, 4] {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        assert!(
            pool.install(|| run(&renderer)) == expected,
            "{threads} threads"
        );
    }
}

#[test]
fn gradients_of_another_size_are_refused() {
    let scene = Scene {
        splats: random_splats(3, 10, 0),
        background: Background::Constant([0.1; 3]),
    };
    let camera = camera((20, 10), Distortion::None);
    let renderer = Renderer::new(RenderConfig::default()).unwrap();
    let pass = renderer.forward(&scene, &camera, &Exposure::NONE);
    let mut gradient = gradient(200, 1);
    gradient.alpha.pop();
    let error = renderer.backward(&scene, &camera, &Exposure::NONE, &pass, &gradient);
    let expected = "gradient of the accumulated alpha of 199 values, expected 200";
    assert_eq!(error.unwrap_err().to_string(), expected);
}
