use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};

use super::*;
use crate::camera::Camera;
use crate::config::RenderConfig;
use crate::error::SplatError;
use crate::reference;
use crate::scene::{Background, Exposure, Scene, Splat, Splats};

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
                    crate::harmonics::to_color(splat.harmonics[0][c]) * 0.5 + 0.25
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
    let mut config = TrainConfig::default();
    config.steps = steps;
    config.degree = 0;
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
    eprintln!(
        "{from} dB to {to} dB, {} Gaussians, depth {} to {}",
        trainer.scene().splats.len(),
        before.depth_error,
        report.evaluation.depth_error
    );
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
