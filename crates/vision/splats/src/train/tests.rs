use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};

use super::*;
use crate::camera::Camera;
use crate::config::RenderConfig;
use crate::error::SplatError;
use crate::reference;
use crate::scene::{Background, Exposure, Scene, Sky, Splat, Splats};

const SIZE: (u32, u32) = (64, 48);

/// Gaussians in a box of 2 m around the origin.
fn truth(count: u64) -> Splats {
    let mut splats = Splats::empty(0).unwrap();
    for i in 0..count {
        let uniform = |k: u64| counter_random::uniform(11, k, i) as f32;
        let mut splat = Splat::sphere(0.1, [uniform(3), uniform(4), uniform(5)]);
        splat.position_m = [0, 1, 2].map(|k| 2.0 * uniform(k) - 1.0);
        splat.log_scale = [6, 7, 8].map(|k| -2.8 + 1.2 * uniform(k));
        splat.rotation_wxyz = [1.0, uniform(9), uniform(10), uniform(11)];
        splat.opacity_logit = 2.0;
        splats.push(&splat).unwrap();
    }
    splats
}

/// A camera at a distance of 4 m that looks at the origin.
fn camera(azimuth: f64, elevation: f64) -> Camera {
    let model = CameraModel::new(SIZE, [60.0, 60.0, 31.5, 23.5], Distortion::None);
    let about = |v| RigidTransform::from_rotation_vector(v, [0.0; 3]).unwrap();
    let back = RigidTransform::from_translation_m([0.0, 0.0, 4.0]).unwrap();
    let pose = back * about([elevation, 0.0, 0.0]) * about([0.0, azimuth, 0.0]);
    Camera::new(model, pose).unwrap()
}

/// Views of the truth, rendered by the reference implementation.
fn views(splats: &Splats, count: usize, offset: f64) -> Vec<TrainingView> {
    let scene = Scene {
        splats: splats.clone(),
        background: Background::Constant([0.2, 0.3, 0.4]),
    };
    let scene = reference::Scene::from(&scene);
    (0..count)
        .map(|i| {
            let azimuth = (i as f64 + offset) / count as f64 * std::f64::consts::TAU;
            let camera = camera(azimuth, 0.4 * (3.0 * azimuth).sin());
            let image =
                reference::render(&scene, &camera, &Exposure::NONE, &RenderConfig::default());
            let bytes = image
                .rgb
                .as_flattened()
                .iter()
                .map(|v| (v * 255.0).round().clamp(0.0, 255.0) as u8);
            let mut view = TrainingView::new(camera, bytes.collect(), i as u32);
            view.depth_m = image.median_depth_m.iter().map(|v| *v as f32).collect();
            view.depth_sigma_m = vec![0.05; view.depth_m.len()];
            view
        })
        .collect()
}

/// The same views with noise of two levels.
fn noisy(mut views: Vec<TrainingView>) -> Vec<TrainingView> {
    for (v, view) in views.iter_mut().enumerate() {
        for (i, value) in view.rgb.iter_mut().enumerate() {
            let noise = 2.0 * counter_random::bell(12, v as u64, i as u64);
            *value = (f64::from(*value) + noise).round().clamp(0.0, 255.0) as u8;
        }
    }
    views
}

/// Coarse points: positions of some of the truth with errors, colors with errors, no shapes.
fn start(splats: &Splats, every: usize) -> Scene {
    let points: Vec<StartPoint> = (0..splats.len())
        .step_by(every)
        .map(|i| {
            let bell = |k: u64| counter_random::bell(5, k, i as u64) as f32;
            let splat = splats.get(i);
            StartPoint {
                position_m: std::array::from_fn(|k| splat.position_m[k] + 0.04 * bell(k as u64)),
                normal: None,
                spacing_m: 0.25,
                sigma_m: 0.02,
                color: std::array::from_fn(|c| {
                    gaussians::harmonics::to_color(splat.harmonics[0][c]) * 0.5 + 0.25
                }),
            }
        })
        .collect();
    Scene {
        splats: splats_from_points(&points).unwrap(),
        background: Background::Constant([0.0; 3]),
    }
}

fn config(steps: usize) -> TrainConfig {
    let mut config = TrainConfig {
        steps,
        degree: 0,
        ..TrainConfig::default()
    };
    // Images are small already.
    (config.quarter_until, config.full_from) = (0.0, 0.1);
    // Few steps: larger ones.
    config.optimizer.position = 5e-4;
    config.optimizer.color = 1e-2;
    (config.growth.start, config.growth.interval) = (100, 50);
    config.growth.min_gain_db = 0.0;
    config
}

fn trainer(scene: Scene, views: Vec<TrainingView>, config: TrainConfig) -> Trainer {
    Trainer::new(scene, views, config, RenderConfig::default(), 3).unwrap()
}

#[test]
fn training_gains_on_held_out_views() {
    let truth = truth(150);
    let held_out = views(&truth, 5, 0.37);
    let mut trainer = trainer(start(&truth, 2), views(&truth, 24, 0.0), config(800));
    let before = trainer.evaluate(&held_out);
    let report = train(&mut trainer, &held_out).unwrap();
    let (from, to) = (before.mean_psnr_db(), report.evaluation.mean_psnr_db());
    assert!(
        to > from + 8.0 && to > 24.0,
        "{from} dB before, {to} dB after"
    );
    assert!(
        trainer.scene().splats.len() > 75,
        "{}",
        trainer.scene().splats.len()
    );
    assert!(report.evaluation.depth_error < 0.6 * before.depth_error);
    assert!(report.checks.is_empty());
}

#[test]
fn training_gives_the_same_scene_on_any_number_of_threads() {
    let truth = truth(60);
    let all = views(&truth, 6, 0.0);
    let mut config = config(120);
    config.degree = 1;
    config.degree_start = 0.3;
    (
        config.poses.refine,
        config.poses.start,
        config.exposure.refine,
    ) = (true, 20, true);
    (config.growth.start, config.growth.interval) = (20, 20);
    let run = |threads: usize, by_gradient: bool| {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        let mut config = config;
        config.growth.by_gradient = by_gradient;
        pool.install(|| {
            let mut trainer = trainer(start(&truth, 1), all.clone(), config);
            let reports: Vec<_> = (0..120).map(|_| trainer.step().unwrap()).collect();
            (trainer.scene().clone(), reports)
        })
    };
    for by_gradient in [false, true] {
        let (scene, reports) = run(1, by_gradient);
        assert!(scene.splats.len() != 60, "no growth");
        for threads in [2, 4] {
            let (other, other_reports) = run(threads, by_gradient);
            assert!(
                other == scene && other_reports == reports,
                "{threads} threads"
            );
        }
    }
}

#[test]
fn growth_ends_where_held_out_views_do_not_gain() {
    // Six Gaussians, one for each of the truth: more of them gain nothing against noise.
    let few = truth(6);
    let held_out = noisy(views(&few, 6, 0.37));
    let mut settings = config(1500);
    settings.growth.start = 500;
    settings.growth.min_error_px = 0.05;
    settings.growth.min_gain_db = 0.1;
    settings.growth.check_steps = 100;
    let mut trainer = trainer(start(&few, 1), noisy(views(&few, 12, 0.0)), settings);
    let report = train(&mut trainer, &held_out).unwrap();
    let continued = report.checks.iter().any(|check| check.continues);
    assert!(report.checks.len() == 2 && !continued, "{report:?}");
    assert!(
        trainer.scene().splats.len() <= 6,
        "{}",
        trainer.scene().splats.len()
    );

    // Twenty for a hundred: more of them do gain.
    let many = truth(100);
    let held_out = noisy(views(&many, 6, 0.37));
    let mut settings = config(1000);
    settings.growth.start = 200;
    settings.growth.min_gain_db = 0.05;
    settings.growth.check_steps = 100;
    let mut trainer = self::trainer(start(&many, 5), noisy(views(&many, 12, 0.0)), settings);
    let report = train(&mut trainer, &held_out).unwrap();
    assert!(
        report.checks.iter().any(|check| check.continues),
        "{:?}",
        report.checks
    );
    assert!(
        trainer.scene().splats.len() > 30,
        "{}",
        trainer.scene().splats.len()
    );
}

#[test]
fn refinement_recovers_poses_and_gains() {
    let truth = truth(100);
    let mut all = views(&truth, 12, 0.0);
    let expected: Vec<Camera> = all.iter().map(|view| view.camera.clone()).collect();
    let bell = |k: u64, i: usize| counter_random::bell(8, k, i as u64);
    for (i, view) in all.iter_mut().enumerate() {
        let of = |k: u64| [0, 1, 2].map(|c| bell(k + c, i));
        let motion = RigidTransform::from_rotation_vector(
            of(0).map(|v| 0.004 * v),
            of(3).map(|v| 0.015 * v),
        );
        let pose = motion.unwrap() * *view.camera.camera_from_world();
        view.camera = view.camera.clone().with_pose(pose);
        // Brighter and darker images, in equal parts.
        let gain = if i % 2 == 0 { 0.9 } else { 1.1 };
        for value in &mut view.rgb {
            *value = (f64::from(*value) * gain).min(255.0) as u8;
        }
    }
    let mut settings = config(1200);
    settings.poses.refine = true;
    settings.poses.start = 100;
    (
        settings.poses.position_sigma_m,
        settings.poses.rotation_sigma_rad,
    ) = (0.015, 0.004);
    (settings.exposure.refine, settings.exposure.sigma) = (true, 0.1);
    // The scene starts at the truth, so that the poses are what is wrong.
    let scene = Scene {
        splats: truth.clone(),
        background: Background::Constant([0.2, 0.3, 0.4]),
    };
    (
        settings.optimizer.position,
        settings.optimizer.position_by_size,
    ) = (1e-5, 0.0);
    settings.optimizer.opacity = 1e-2;
    let mut trainer = trainer(scene, all.clone(), settings);
    let error = |cameras: &[Camera]| {
        let between = cameras.iter().zip(&expected).map(|(found, expected)| {
            let motion = *found.camera_from_world() * expected.camera_from_world().inverse();
            (motion.translation_m().iter().map(|v| v * v).sum::<f64>()).sqrt()
        });
        between.sum::<f64>() / expected.len() as f64
    };
    let before: Vec<Camera> = all.iter().map(|view| view.camera.clone()).collect();
    train(&mut trainer, &[]).unwrap();
    let after: Vec<Camera> = (0..12).map(|i| trainer.camera(i).unwrap()).collect();
    let (before, after) = (error(&before), error(&after));
    assert!(after < 0.5 * before, "{before} m before, {after} m after");
    let gain = |i: usize| trainer.exposure(i).matrix[0][0];
    let ratio = (1..12)
        .step_by(2)
        .map(|i| gain(i) / gain(i - 1))
        .sum::<f32>()
        / 6.0;
    assert!((ratio - 1.1 / 0.9).abs() < 0.04, "{ratio}");
}

#[test]
fn masked_pixels_do_not_train() {
    let truth = truth(60);
    let clean = views(&truth, 6, 0.0);
    let run = |views: Vec<TrainingView>| {
        let mut trainer = trainer(start(&truth, 1), views, config(100));
        train(&mut trainer, &[]).unwrap();
        trainer.scene().clone()
    };
    let masked = |fill: u8| {
        let mut all = clean.clone();
        for view in &mut all {
            view.mask = (0..64 * 48).map(|i| i % 64 > 20 || i / 64 > 20).collect();
            for (pixel, rgb) in view.rgb.chunks_mut(3).enumerate() {
                if !view.mask[pixel] {
                    rgb.fill(fill);
                }
            }
        }
        all
    };
    // Images are reduced at first: a block with a masked pixel is masked.
    assert!(run(masked(0)) == run(masked(255)));
    assert!(run(masked(0)) != run(clean.clone()));
}

#[test]
fn named_settings_train() {
    let truth = truth(60);
    let held_out = views(&truth, 4, 0.37);
    for preset in [
        Preset::Fast,
        Preset::Balanced,
        Preset::Accurate,
        Preset::Paws,
    ] {
        let mut config = TrainConfig::preset(preset);
        config.steps = 200;
        // The scene is small and near.
        config.optimizer.color = 1e-2;
        (config.growth.start, config.growth.interval) = (50, 25);
        let mut trainer = trainer(start(&truth, 1), views(&truth, 8, 0.0), config);
        let before = trainer.evaluate(&held_out).mean_psnr_db();
        let after = train(&mut trainer, &held_out)
            .unwrap()
            .evaluation
            .mean_psnr_db();
        assert!(
            after > before + 2.0,
            "{preset:?}: {before} dB before, {after} dB after"
        );
        let degree = trainer.scene().splats.degree();
        assert_eq!(degree, config.degree, "{preset:?}");
    }
}

#[test]
fn unusable_views_are_refused_by_name() {
    let truth = truth(10);
    let scene = || start(&truth, 1);
    let good = || views(&truth, 2, 0.0);
    let refused = |views: Vec<TrainingView>| {
        let result = Trainer::new(scene(), views, config(10), RenderConfig::default(), 1);
        result.unwrap_err().to_string()
    };
    assert!(refused(Vec::new()).contains("there are none"));
    let mut all = good();
    all[1].mask = vec![false; 64 * 48];
    assert!(refused(all).contains("view 1 has no usable pixel"));
    let mut all = good();
    all[0].rgb.pop();
    assert!(refused(all).contains("image of 9215 values, expected 9216"));
    let mut all = good();
    all[0].depth_sigma_m.clear();
    assert!(refused(all).contains("standard deviations of depth of 0 values"));
}

/// Numbers of groups are names: most of those of a session may have no usable image.
#[test]
fn exposure_groups_may_have_any_numbers() {
    let truth = truth(20);
    let trained = |numbers: [u32; 4]| {
        let mut all = views(&truth, 4, 0.0);
        for (view, number) in all.iter_mut().zip(numbers) {
            view.exposure_group = number;
        }
        let mut config = config(20);
        config.exposure.refine = true;
        let mut trainer = trainer(start(&truth, 1), all, config);
        for _ in 0..20 {
            trainer.step().unwrap();
        }
        trainer.scene().splats.clone()
    };
    assert_eq!(trained([0, 1, 1, 2]), trained([7, 680, 680, u32::MAX]));
}

#[test]
fn divergence_is_an_error_and_keeps_the_scene() {
    let truth = truth(30);
    let mut all = views(&truth, 4, 0.0);
    for view in &mut all {
        view.exposure.matrix[1][0] = f32::NAN;
    }
    let mut trainer = trainer(start(&truth, 1), all, config(400));
    let before = trainer.scene().splats.clone();
    let error = trainer.step().unwrap_err();
    assert!(
        matches!(error, SplatError::Diverged { step: 0, .. }),
        "{error:?}"
    );
    assert_eq!(trainer.scene().splats, before);
    assert_eq!(trainer.steps(), 0);
}

/// A training with every part of its state in use, with checks of growth.
fn resumable(truth: &Splats) -> (Trainer, Vec<TrainingView>) {
    let mut config = config(400);
    config.degree = 1;
    config.degree_start = 0.3;
    (config.poses.refine, config.poses.start) = (true, 20);
    config.exposure.refine = true;
    (config.growth.start, config.growth.interval) = (60, 20);
    (config.growth.min_gain_db, config.growth.check_steps) = (0.01, 20);
    let mut scene = start(truth, 2);
    scene.background = Background::Sky(Sky::uniform(8, [0.3; 3]).unwrap());
    let trainer = trainer(scene, views(truth, 6, 0.0), config);
    (trainer, noisy(views(truth, 4, 0.37)))
}

#[test]
fn a_resumed_training_equals_one_that_was_not_stopped() {
    let truth = truth(40);
    let (mut trainer, held_out) = resumable(&truth);
    let mut growth = GrowthByNeed::new(trainer.config());
    let mut checkpoints = Vec::new();
    while trainer.steps() < 400 {
        if trainer.steps().is_multiple_of(7) {
            checkpoints.push(growth.checkpoint(&trainer).unwrap());
        }
        growth.advance(&mut trainer, &held_out).unwrap();
    }
    let expected = growth.checkpoint(&trainer).unwrap();
    assert!(growth.checks().len() > 1 && checkpoints.len() > 20);
    for number in [0, 5, checkpoints.len() / 2, checkpoints.len() - 1] {
        let (mut resumed, _) = resumable(&truth);
        let mut growth = GrowthByNeed::resume(&checkpoints[number], &mut resumed).unwrap();
        while resumed.steps() < 400 {
            growth.advance(&mut resumed, &held_out).unwrap();
        }
        let found = growth.checkpoint(&resumed).unwrap();
        assert!(found == expected, "checkpoint {number}");
        assert!(resumed.scene() == trainer.scene());
    }
}

#[test]
fn broken_checkpoints_are_refused_and_change_nothing() {
    let truth = truth(10);
    let (mut trainer, held_out) = resumable(&truth);
    let mut growth = GrowthByNeed::new(trainer.config());
    for _ in 0..10 {
        growth.advance(&mut trainer, &held_out).unwrap();
    }
    let bytes = growth.checkpoint(&trainer).unwrap();
    let (mut fresh, _) = resumable(&truth);
    let before = GrowthByNeed::new(fresh.config())
        .checkpoint(&fresh)
        .unwrap();
    for length in (0..bytes.len()).step_by(13) {
        assert!(
            GrowthByNeed::resume(&bytes[..length], &mut fresh).is_err(),
            "{length}"
        );
    }
    let longer = [&bytes[..], &[0]].concat();
    assert!(GrowthByNeed::resume(&longer, &mut fresh).is_err());
    // Lengths beyond the bytes are not allocated.
    for at in (0..bytes.len() - 8).step_by(17) {
        let mut damaged = bytes.clone();
        damaged[at..at + 8].fill(0xff);
        let _ = GrowthByNeed::resume(&damaged, &mut fresh.clone());
    }
    // Of another number of views.
    let mut other = self::trainer(start(&truth, 2), views(&truth, 3, 0.0), *fresh.config());
    let error = GrowthByNeed::resume(&bytes, &mut other).unwrap_err();
    assert!(matches!(error, SplatError::Checkpoint { .. }), "{error}");
    let after = GrowthByNeed::new(fresh.config())
        .checkpoint(&fresh)
        .unwrap();
    assert!(before == after);
}
