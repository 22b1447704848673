//! Images of the device beside those of the processor.

mod common;

use camera_models::Distortion;
use common::{Case, Renderers, camera, cases, exposure, gpu, random_splats};
use splats::{Background, Exposure, Image, RenderConfig, Renderer, Scene, Splats};
use splats_gpu::{GpuError, GpuRenderer, GpuScene};

/// Largest differences of two images.
#[derive(Debug, Default)]
struct Deviation {
    color: f32,
    alpha: f32,
    /// Relative.
    expected_depth: f32,
    /// Pixels with another median depth, or none where the other has one.
    other_median: usize,
    other_holes: usize,
}

fn deviation(found: &Image, expected: &Image) -> Deviation {
    let mut out = Deviation::default();
    let difference = |a: &[f32], b: &[f32]| {
        let both = a.iter().zip(b);
        both.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    };
    for c in 0..3 {
        out.color = out.color.max(difference(&found.rgb[c], &expected.rgb[c]));
    }
    out.alpha = difference(&found.alpha, &expected.alpha);
    let both = found
        .expected_depth_m
        .iter()
        .zip(&expected.expected_depth_m);
    for (a, b) in both {
        match a.is_nan() == b.is_nan() {
            true if a.is_nan() => {}
            true => out.expected_depth = out.expected_depth.max((a - b).abs() / b),
            false => out.other_holes += 1,
        }
    }
    let both = found.median_depth_m.iter().zip(&expected.median_depth_m);
    let other = both.filter(|(a, b)| a.is_nan() != b.is_nan() || (*a - *b).abs() > 1e-4 * **b);
    out.other_median = other.count();
    out
}

#[test]
fn images_equal_those_of_the_processor() {
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
        let renderer = renderers.of(&gpu, config);
        let on_device = GpuScene::new(&gpu, &scene).unwrap();
        let found = renderer.render(&on_device, &camera, &exposure()).unwrap();
        let processor = Renderer::new(config).unwrap();
        let expected = processor.forward(&scene, &camera, &exposure());
        let d = deviation(&found, &expected.image);
        println!("{name}: {d:?}, {:?}", renderer.stats());
        assert!(d.color < 1e-5 && d.alpha < 1e-5, "{name}: {d:?}");
        assert!(d.expected_depth < 1e-5, "{name}: {d:?}");
        // A pixel whose transmittance is a half, or its alpha a tenth, within rounding.
        assert!(d.other_median <= 1 && d.other_holes <= 1, "{name}: {d:?}");
        let (found, expected) = (renderer.stats(), expected.stats);
        assert_eq!(found.degenerate, expected.degenerate, "{name}");
        assert!(found.visible.abs_diff(expected.visible) <= 2, "{name}");
        assert!(found.pairs.abs_diff(expected.pairs) <= 4, "{name}");
        assert!(expected.visible > 500, "{name}: {expected:?}");
    }
}

#[test]
fn the_step_at_the_smallest_alpha_changes_few_pixels_by_one_step() {
    let Some(gpu) = gpu() else {
        return;
    };
    let config = RenderConfig::default();
    let mut renderer = GpuRenderer::new(&gpu, config).unwrap();
    let processor = Renderer::new(config).unwrap();
    let camera = camera((64, 48), Distortion::None);
    let background = Background::Constant([0.2, 0.5, 0.1]);
    let mut others = 0;
    for seed in 20..24 {
        let splats = random_splats(seed, 2000, 1);
        let background = background.clone();
        let scene = Scene { splats, background };
        let on_device = GpuScene::new(&gpu, &scene).unwrap();
        let found = renderer.render(&on_device, &camera, &exposure()).unwrap();
        let expected = processor.render(&scene, &camera, &exposure());
        let both = found.alpha.iter().zip(&expected.alpha);
        for (found, expected) in both {
            let difference = (found - expected).abs();
            assert!(difference < 1.1 / 255.0, "{found}, expected {expected}");
            others += usize::from(difference > 1e-4);
        }
    }
    assert!(others < 12, "{others} pixels of 12288 differ");
}

#[test]
fn the_same_image_has_the_same_bytes() {
    let Some(gpu) = gpu() else {
        return;
    };
    let case = cases().swap_remove(7);
    let on_device = GpuScene::new(&gpu, &case.scene).unwrap();
    let bits = |image: &Image| {
        let planes = [&image.expected_depth_m, &image.median_depth_m, &image.alpha];
        let planes = image.rgb.iter().chain(planes);
        let bits = planes.map(|plane| plane.iter().map(|v| v.to_bits()).collect::<Vec<_>>());
        bits.collect::<Vec<_>>()
    };
    let mut all = Vec::new();
    for _ in 0..2 {
        let mut renderer = GpuRenderer::new(&gpu, case.config).unwrap();
        for _ in 0..2 {
            let image = renderer.render(&on_device, &case.camera, &exposure());
            all.push(bits(&image.unwrap()));
        }
    }
    assert!(all.windows(2).all(|two| two[0] == two[1]));
}

#[test]
fn a_lost_device_is_an_error_that_names_it() {
    let Some(gpu) = gpu() else {
        return;
    };
    let case = cases().swap_remove(0);
    let mut renderer = GpuRenderer::new(&gpu, case.config).unwrap();
    let on_device = GpuScene::new(&gpu, &case.scene).unwrap();
    renderer
        .render(&on_device, &case.camera, &exposure())
        .unwrap();
    gpu.lose();
    let error = renderer.render(&on_device, &case.camera, &exposure());
    let error = error.unwrap_err();
    println!("{error}");
    assert!(matches!(error, GpuError::Lost { .. }), "{error}");
    assert!(error.to_string().contains(gpu.name()), "{error}");
    assert!(GpuScene::new(&gpu, &case.scene).is_err());
    assert!(GpuRenderer::new(&gpu, case.config).is_err());
}

/// Sizes at which blocks of the sort, tiles and lists of pairs end: 0 and 1 Gaussians, more pairs
/// than fit at first, images that are no multiple of a tile, one renderer for all.
#[test]
fn sizes_may_change_between_images() {
    let Some(gpu) = gpu() else {
        return;
    };
    let config = common::smooth(false);
    let mut renderer = GpuRenderer::new(&gpu, config).unwrap();
    let processor = Renderer::new(config).unwrap();
    let background = Background::Constant([0.2, 0.5, 0.1]);
    let sizes = [
        (0, (64, 48)),
        (1, (1, 1)),
        (1023, (33, 17)),
        (1024, (16, 16)),
        (1025, (250, 90)),
        (40, (3, 200)),
    ];
    for (count, size) in sizes {
        let splats = match count {
            0 => Splats::empty(0).unwrap(),
            _ => random_splats(9, count, 0),
        };
        let background = background.clone();
        let scene = Scene { splats, background };
        let camera = camera(size, Distortion::None);
        let on_device = GpuScene::new(&gpu, &scene).unwrap();
        let found = renderer.render(&on_device, &camera, &Exposure::NONE);
        let expected = processor.render(&scene, &camera, &Exposure::NONE);
        let d = deviation(&found.unwrap(), &expected);
        println!("{count} {size:?}: {d:?}, {:?}", renderer.stats());
        assert!(d.color < 1e-5 && d.alpha < 1e-5, "{count}: {d:?}");
    }
    // The lists of pairs had to grow.
    let splats = random_splats(9, 3000, 0);
    let scene = Scene { splats, background };
    let camera = camera((320, 240), Distortion::None);
    let on_device = GpuScene::new(&gpu, &scene).unwrap();
    let found = renderer.render(&on_device, &camera, &Exposure::NONE);
    let expected = processor.forward(&scene, &camera, &Exposure::NONE);
    assert!(expected.stats.pairs > 1 << 14, "{:?}", expected.stats);
    let d = deviation(&found.unwrap(), &expected.image);
    assert!(d.color < 1e-5 && d.alpha < 1e-5, "{d:?}");
}
