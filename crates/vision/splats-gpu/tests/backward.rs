//! Gradients of the device beside those of the processor.

mod common;

use common::{Case, Renderers, cases, exposure, gpu};
use splats::{Gradients, ImageGradient, Renderer};
use splats_gpu::{GpuRenderer, GpuScene};

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

/// Root of the sum of squares of the difference, relative to that of the expected values.
fn relative(found: impl Iterator<Item = f64>, expected: impl Iterator<Item = f64>) -> f64 {
    let (mut difference, mut size) = (0.0, 0.0);
    for (found, expected) in found.zip(expected) {
        difference += (found - expected).powi(2);
        size += expected.powi(2);
    }
    assert!(size > 0.0, "the expected gradients are zeros");
    (difference / size).sqrt()
}

/// A value of each Gaussian of the scene, 0 where it is not visible.
fn dense(of: &Gradients, values: &[f32], splats: usize) -> Vec<f64> {
    let mut out = vec![0.0; splats];
    for (index, value) in of.indices.iter().zip(values) {
        out[*index as usize] = f64::from(*value);
    }
    out
}

fn check(name: &str, found: &Gradients, expected: &Gradients, splats: usize) {
    let of =
        |found: &[f64], expected: &[f64]| relative(found.iter().copied(), expected.iter().copied());
    let both = |a: &[f32], b: &[f32]| of(&dense(found, a, splats), &dense(expected, b, splats));
    let component = |of: &Gradients, k: usize| of.absolute.iter().map(|a| a[k]).collect::<Vec<_>>();
    let wide = |of: &[[f32; 3]]| {
        let values = of.as_flattened().iter();
        values.map(|v| f64::from(*v)).collect::<Vec<_>>()
    };
    let planes = found.planes.iter().zip(&expected.planes);
    let mut all: Vec<(String, f64)> = planes
        .enumerate()
        .map(|(k, (a, b))| (format!("plane {k}"), both(a, b)))
        .collect();
    for k in 0..2 {
        let name = format!("absolute {k}");
        all.push((name, both(&component(found, k), &component(expected, k))));
    }
    all.push(("error".into(), both(&found.error, &expected.error)));
    all.push(("weight".into(), both(&found.weight, &expected.weight)));
    all.push(("motion".into(), of(&found.motion, &expected.motion)));
    let (a, b) = (&found.exposure, &expected.exposure);
    let exposures = of(a.as_flattened(), b.as_flattened());
    all.push(("exposure".into(), exposures));
    let (a, b) = (wide(&found.background), wide(&expected.background));
    assert_eq!(a.len(), b.len(), "{name}");
    all.push(("background".into(), of(&a, &b)));
    let worst = all.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
    println!("{name}: {} values, worst {worst:?}", all.len());
    for (of, error) in &all {
        assert!(*error < 1e-4, "{name}, {of}: {error}");
    }
}

#[test]
fn gradients_equal_those_of_the_processor() {
    let Some(gpu) = gpu() else {
        return;
    };
    let mut renderers = Renderers::default();
    for case in cases() {
        let Case {
            name,
            scene,
            camera,
            config,
        } = case;
        let gradient = gradient(camera.pixels(), 7);
        let processor = Renderer::new(config).unwrap();
        let pass = processor.forward(&scene, &camera, &exposure());
        let expected = processor
            .backward(&scene, &camera, &exposure(), &pass, &gradient)
            .unwrap();
        let renderer = renderers.of(&gpu, config);
        let on_device = GpuScene::new(&gpu, &scene).unwrap();
        let found = renderer.backward(&on_device, &camera, &exposure(), &gradient);
        check(name, &found.unwrap(), &expected, scene.splats.len());
    }
}

#[test]
fn the_same_gradients_have_the_same_bytes() {
    let Some(gpu) = gpu() else {
        return;
    };
    let case = cases().swap_remove(7);
    let gradient = gradient(case.camera.pixels(), 3);
    let on_device = GpuScene::new(&gpu, &case.scene).unwrap();
    let mut all = Vec::new();
    for _ in 0..2 {
        let mut renderer = GpuRenderer::new(&gpu, case.config).unwrap();
        for _ in 0..2 {
            let found = renderer.backward(&on_device, &case.camera, &exposure(), &gradient);
            all.push(found.unwrap());
        }
    }
    // No value is NaN, so that equal values are equal bytes up to the sign of zeros.
    assert!(all.windows(2).all(|two| two[0] == two[1]));
}

#[test]
fn a_gradient_of_another_size_is_refused() {
    let Some(gpu) = gpu() else {
        return;
    };
    let case = cases().swap_remove(0);
    let mut gradient = gradient(case.camera.pixels(), 3);
    gradient.rgb[1].pop();
    let on_device = GpuScene::new(&gpu, &case.scene).unwrap();
    let mut renderer = GpuRenderer::new(&gpu, case.config).unwrap();
    let error = renderer
        .backward(&on_device, &case.camera, &exposure(), &gradient)
        .unwrap_err()
        .to_string();
    assert_eq!(error, "gradient of green of 3071 values, expected 3072");
}
