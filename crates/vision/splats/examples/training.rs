//! Trains a simulated street from coarse points and reports held-out PSNR over steps and the number
//! of Gaussians.
//!
//! `cargo run --release -p splats --example training -- STEPS GROWTH`, GROWTH one of `need`,
//! `error`, `gradient`, `none`.
#![expect(clippy::disallowed_methods, reason = "this program measures time")]

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};
use rustix::time::{ClockId, clock_gettime};
use splats::{
    Background, Camera, Exposure, RenderConfig, Renderer, Scene, Splat, SplatError, Splats,
    StartPoint, TrainConfig, Trainer, TrainingView, splats_from_points, train,
};

const SIZE: (u32, u32) = (336, 188);
const TRUTH: u64 = 30_000;

fn main() -> Result<(), SplatError> {
    let arguments: Vec<String> = std::env::args().collect();
    let steps = arguments
        .get(1)
        .and_then(|v| v.parse().ok())
        .unwrap_or(1500);
    let growth = arguments.get(2).map_or("need", String::as_str);
    let truth = street()?;
    let renderer = Renderer::new(RenderConfig::default())?;
    let (mut views, mut held_out) = (Vec::new(), Vec::new());
    for i in 0..64 {
        let view = view(&renderer, &truth, i)?;
        match i % 8 == 4 {
            true => held_out.push(view),
            false => views.push(view),
        }
    }
    let scene = Scene {
        splats: splats_from_points(&points(&truth.splats))?,
        background: Background::Constant([0.5; 3]),
    };
    let mut config = TrainConfig::default();
    (config.steps, config.degree) = (steps, 0);
    match growth {
        "need" => {}
        "error" => config.growth.min_gain_db = 0.0,
        "gradient" => {
            config.growth.min_gain_db = 0.0;
            (config.growth.by_gradient, config.growth.min_gradient) = (true, 6e-4);
        }
        _ => config.growth.stop = 0.0,
    }
    let mut trainer = Trainer::new(scene, views, config, RenderConfig::default(), 1)?;
    report("start", &trainer, &held_out);
    let start = cpu_s();
    let result = train(&mut trainer, &held_out)?;
    let seconds = cpu_s() - start;
    for check in result.checks {
        println!("{check:?}");
    }
    report("end", &trainer, &held_out);
    println!(
        "{:.1} CPU s, {:.1} CPU ms a step",
        seconds,
        seconds * 1e3 / steps as f64
    );
    Ok(())
}

fn report(name: &str, trainer: &Trainer, held_out: &[TrainingView]) {
    let evaluation = trainer.evaluate(held_out);
    println!(
        "{name}: {} Gaussians, {:.2} dB, worst {:.2} dB, depth error {:.4}",
        trainer.scene().splats.len(),
        evaluation.mean_psnr_db(),
        evaluation.worst_psnr_db(),
        evaluation.depth_error
    );
}

fn cpu_s() -> f64 {
    let time = clock_gettime(ClockId::ProcessCPUTime);
    time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
}

/// Ground and two walls with a pattern of stripes and patches.
fn street() -> Result<Scene, SplatError> {
    let mut splats = Splats::empty(0)?;
    let (length, width, height) = (40.0, 8.0, 6.0);
    for i in 0..TRUTH {
        let uniform = |k: u64| counter_random::uniform(1, k, i) as f32;
        let across = uniform(0) * (width + 2.0 * height) - height;
        let z = uniform(1) * length;
        let (x, y, normal) = match across {
            a if a < 0.0 => (-width / 2.0, 1.5 + a, 0),
            a if a > width => (width / 2.0, 1.5 - (a - width), 0),
            a => (a - width / 2.0, 1.5, 1),
        };
        let patch = (across.floor() as i32 * 7 + (z * 0.7) as i32 * 13) as u64;
        let base = |c: u64| 0.2 + 0.6 * counter_random::uniform(2, c, patch) as f32;
        let stripe = if (z * 2.0) as i32 % 2 == 0 { 0.1 } else { -0.1 };
        let color = [0, 1, 2].map(|c| base(c) + stripe + 0.1 * (uniform(2 + c) - 0.5));
        let mut splat = Splat::sphere(0.08, color);
        splat.position_m = [x, y, z];
        splat.log_scale[normal] = -5.0;
        splat.opacity_logit = 3.0;
        splats.push(&splat)?;
    }
    let background = Background::Constant([0.6, 0.7, 0.9]);
    Ok(Scene { splats, background })
}

/// One of 64 views along the street, alternately to both sides.
fn view(renderer: &Renderer, truth: &Scene, number: u32) -> Result<TrainingView, SplatError> {
    let [w, h] = [SIZE.0, SIZE.1].map(f64::from);
    let lens = [0.55 * w, 0.55 * w, (w - 1.0) / 2.0, (h - 1.0) / 2.0];
    let model = CameraModel::new(SIZE, lens, Distortion::None);
    let angle = if number.is_multiple_of(2) { 0.4 } else { -0.4 };
    let rotation = RigidTransform::from_rotation_vector([0.0, angle, 0.0], [0.0; 3]);
    let position = RigidTransform::from_translation_m([0.0, 0.0, -0.4 * f64::from(number)]);
    let poses = rotation.and_then(|rotation| Ok(rotation * position?));
    let pose = poses.map_err(|error| SplatError::Camera {
        reason: error.to_string(),
    })?;
    let camera = Camera::new(model, pose)?;
    let image = renderer.render(truth, &camera, &Exposure::NONE);
    let noise = |i: usize| 1.5 * counter_random::bell(3, u64::from(number), i as u64) as f32;
    let bytes = (0..3 * camera.pixels())
        .map(|i| (image.rgb[i % 3][i / 3] * 255.0 + noise(i)).round() as u8)
        .collect();
    let mut view = TrainingView::new(camera, bytes, number);
    view.depth_sigma_m = image.median_depth_m.iter().map(|z| 0.01 * z * z).collect();
    view.depth_m = image.median_depth_m;
    Ok(view)
}

/// A fifth of the truth with errors of 2 cm.
fn points(truth: &Splats) -> Vec<StartPoint> {
    (0..truth.len())
        .step_by(5)
        .map(|i| {
            let splat = truth.get(i);
            let bell = |k: u64| counter_random::bell(4, k, i as u64) as f32;
            let flat = splat.log_scale[0] < -4.0;
            StartPoint {
                position_m: std::array::from_fn(|k| splat.position_m[k] + 0.02 * bell(k as u64)),
                normal: Some(if flat {
                    [1.0, 0.0, 0.0]
                } else {
                    [0.0, 1.0, 0.0]
                }),
                spacing_m: 0.35,
                sigma_m: 0.02,
                color: std::array::from_fn(|c| 0.5 + 0.282_094_8 * splat.harmonics[0][c]),
            }
        })
        .collect()
}
