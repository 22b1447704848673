//! Training on the device beside that on the processor.

mod common;

use camera_models::Distortion;
use common::{camera, exposure, gpu, random_splats, shutter, sky};
use splats::{
    Background, Exposure, Plane, RenderConfig, Renderer, Scene, SplatError, Splats, TrainConfig,
    Trainer, TrainingView,
};
use splats_gpu::{Gpu, GpuTrainer};

/// Views of a scene with masks, depths and exposures, from two lenses.
fn views(truth: &Scene) -> Vec<TrainingView> {
    let renderer = Renderer::new(RenderConfig::default()).unwrap();
    let fisheye = Distortion::KannalaBrandt4 {
        k1: 0.03,
        k2: -0.01,
        k3: 0.002,
        k4: 0.0,
    };
    let rolling = camera((67, 49), fisheye).with_shutter(shutter()).unwrap();
    let cameras = [camera((64, 48), Distortion::None), rolling];
    let mut views = Vec::new();
    for (number, camera) in (0..).zip(cameras) {
        let exposure = if number == 0 {
            Exposure::NONE
        } else {
            exposure()
        };
        let image = renderer.render(truth, &camera, &exposure);
        let mut rgb = Vec::new();
        for pixel in 0..camera.pixels() {
            rgb.extend([0, 1, 2].map(|c| (image.rgb[c][pixel] * 255.0).clamp(0.0, 255.0) as u8));
        }
        let mut view = TrainingView::new(camera, rgb, number);
        view.exposure = exposure;
        let width = image.width;
        view.mask = (0..image.alpha.len())
            .map(|i| !(i % width > 40 && i / width < 11))
            .collect();
        view.depth_m = image.expected_depth_m;
        view.depth_sigma_m = view.depth_m.iter().map(|z| 0.01 * z * z).collect();
        views.push(view);
    }
    views
}

fn config(steps: usize) -> TrainConfig {
    let mut config = TrainConfig::default();
    config.steps = steps;
    config.degree = 1;
    config.degree_start = 0.0;
    config.harmonics_interval = 2;
    config.quarter_until = 0.0;
    config.full_from = 0.5;
    config
}

fn trainer(config: TrainConfig, background: Background) -> Trainer {
    let truth = Scene {
        splats: random_splats(31, 1200, 1),
        background: sky(7),
    };
    let start = Scene {
        splats: random_splats(32, 1000, 1),
        background,
    };
    Trainer::new(start, views(&truth), config, RenderConfig::default(), 5).unwrap()
}

fn run(trainer: &mut Trainer, gpu: &Gpu, steps: usize) -> GpuTrainer {
    let mut device = GpuTrainer::new(gpu).unwrap();
    let end = trainer.steps() + steps;
    while trainer.steps() < end {
        trainer.run_on(&mut device, end - trainer.steps()).unwrap();
    }
    device
}

/// Root mean square of the differences of a plane, and of what the training changed in it.
fn change(start: &[f32], found: &[f32], expected: &[f32]) -> (f64, f64) {
    let square = |a: &[f32], b: &[f32]| {
        let both = a.iter().zip(b);
        let sum: f64 = both.map(|(a, b)| f64::from(a - b).powi(2)).sum();
        (sum / a.len() as f64).sqrt()
    };
    (square(found, expected), square(start, expected))
}

#[test]
fn one_step_equals_that_of_the_processor() {
    let Some(gpu) = gpu() else {
        return;
    };
    for (name, background) in [
        ("sky", sky(9)),
        ("color", Background::Constant([0.4, 0.2, 0.3])),
    ] {
        // Full size, both views.
        let mut processor = trainer(config(8), background);
        for _ in 0..4 {
            processor.step().unwrap();
        }
        for _ in 0..2 {
            let start = processor.clone();
            let mut on_device = processor.clone();
            let device = run(&mut on_device, &gpu, 1);
            let report = processor.step().unwrap();
            let losses = device.losses();
            println!("{name}: {losses:?}, {report:?}");
            assert!((losses.l1 - report.l1).abs() < 1e-5 * report.l1);
            assert!((losses.ssim - report.ssim).abs() < 1e-4);
            assert!((losses.depth - report.depth).abs() < 1e-4 * report.depth);
            assert!(report.depth > 0.0 && report.visible > 300, "{report:?}");
            let planes = |of: &Trainer| of.scene().splats.planes().to_vec();
            let all = planes(&start).into_iter().zip(planes(&on_device));
            for (k, ((start, found), expected)) in all.zip(planes(&processor)).enumerate() {
                let (difference, changed) = change(&start, &found, &expected);
                // Harmonics above degree 0 rest every second step.
                assert!(
                    difference <= 2e-3 * changed,
                    "{name} {k}: {difference} of {changed}"
                );
            }
            let colors = |of: &Trainer| match &of.scene().background {
                Background::Constant(color) => color.to_vec(),
                Background::Sky(sky) => sky.texels().as_flattened().to_vec(),
            };
            let [start, found, expected] = [&start, &on_device, &processor].map(colors);
            let (difference, changed) = change(&start, &found, &expected);
            assert!(
                changed > 0.0 && difference <= 2e-3 * changed,
                "{name}, background: {difference} of {changed}"
            );
        }
    }
}

#[test]
fn a_training_gains_as_that_on_the_processor_does_and_repeats() {
    let Some(gpu) = gpu() else {
        return;
    };
    let mut config = config(120);
    config.growth.start = 60;
    config.growth.interval = 30;
    config.growth.min_gain_db = 0.0;
    let background = Background::Constant([0.4; 3]);
    let mut processor = trainer(config, background.clone());
    let views = views(&Scene {
        splats: random_splats(31, 1200, 1),
        background: sky(7),
    });
    let before = processor.evaluate(&views).mean_psnr_db();
    let count = processor.scene().splats.len();
    while processor.steps() < config.steps {
        processor.step().unwrap();
    }
    let expected = processor.evaluate(&views).mean_psnr_db();
    let mut scenes = Vec::new();
    for _ in 0..2 {
        let mut on_device = trainer(config, background.clone());
        run(&mut on_device, &gpu, config.steps);
        let found = on_device.evaluate(&views).mean_psnr_db();
        let splats = on_device.scene().splats.len();
        let of_processor = processor.scene().splats.len();
        println!("{before} dB to {found} dB, {splats} Gaussians; {expected} dB, {of_processor}");
        assert!(found > before + 2.0 && (found - expected).abs() < 0.1);
        assert!(splats != count && splats.abs_diff(of_processor) * 50 < of_processor);
        scenes.push(on_device.scene().clone());
    }
    assert!(scenes[0] == scenes[1]);
}

#[test]
fn a_lost_device_leaves_the_training_as_it_was() {
    let Some(gpu) = gpu() else {
        return;
    };
    let config = config(40);
    let mut trainer = trainer(config, sky(9));
    let mut device = run(&mut trainer, &gpu, 10);
    let before = trainer.scene().clone();
    gpu.lose();
    let error = trainer.run_on(&mut device, 10).unwrap_err();
    println!("{error}");
    assert!(matches!(error, SplatError::Device { .. }), "{error}");
    assert!(device.failure().is_some());
    assert!(trainer.steps() == 10 && *trainer.scene() == before);
    // The processor can go on.
    trainer.step().unwrap();
}

#[test]
fn settings_that_need_the_processor_are_refused() {
    let Some(gpu) = gpu() else {
        return;
    };
    let mut config = config(40);
    config.poses.refine = true;
    let mut device = GpuTrainer::new(&gpu).unwrap();
    let error = trainer(config, sky(9)).run_on(&mut device, 10);
    let error = error.unwrap_err().to_string();
    assert_eq!(
        error,
        "the setting poses.refine is 1, expected 0 on a device"
    );
}

/// A view that needs more pairs than there is room for, followed by one that needs few: room is
/// made for the first.
#[test]
fn room_is_made_for_the_image_with_most_pairs() {
    let Some(gpu) = gpu() else {
        return;
    };
    let splats = random_splats(32, 1000, 1);
    let planes = splats.planes().iter().enumerate().map(|(k, plane)| {
        // Twenty times as large, so that each is in many tiles of a large image.
        let is_scale = (Plane::SCALE..Plane::SCALE + 3).contains(&k);
        let larger = if is_scale { 3.0 } else { 0.0 };
        plane.iter().map(|value| value + larger).collect()
    });
    let scene = Scene {
        splats: Splats::from_planes(splats.degree(), planes.collect()).unwrap(),
        background: Background::Constant([0.4, 0.2, 0.3]),
    };
    let views = [(512, 384), (64, 48)].into_iter().zip(0..);
    let views = views.map(|(size, number)| {
        let camera = camera(size, Distortion::None);
        let rgb = vec![100; 3 * camera.pixels()];
        TrainingView::new(camera, rgb, number)
    });
    let views: Vec<TrainingView> = views.collect();
    let mut config = config(400);
    config.quarter_until = 0.0;
    config.full_from = 0.0;
    let mut trainer = Trainer::new(scene, views, config, RenderConfig::default(), 5).unwrap();
    // Of runs of one step more each, some end with the small image.
    for steps in 2..6 {
        run(&mut trainer, &gpu, steps);
    }
    assert_eq!(trainer.steps(), 2 + 3 + 4 + 5);
}
