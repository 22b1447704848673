//! Training beside a plain PyTorch renderer and trainer on the CPU (`plain.py` beside this file),
//! in one run: the same images, start, number of steps and order of views.
//!
//! Images have no distortion, noise or rolling shutter; there is no depth loss and no growth, and
//! one color from all sides, because the plain trainer has none of these.

use std::ffi::OsString;
use std::process::{Command, Stdio};

use anyhow::{Context, Result};
use camera_models::{CameraModel, Distortion};
use serde_json::{Value, json};
use splats::{
    Background, LossConfig, OptimizerConfig, RenderConfig, Scene, TrainConfig, Trainer,
    TrainingView, points_from_views, splats_from_points,
};

use super::views::{Part, WalkViews};
use super::walks::short_name;
use crate::meter::timed;
use crate::python;

/// Images, and Gaussians at the start.
const SIZE: (u32, u32) = (160, 96);
const GAUSSIANS: usize = 4000;
/// Most training and test views.
const TRAINING: usize = 40;
const TESTS: usize = 8;
/// One: waiting threads of PyTorch count as processor time beside other load.
const THREADS: usize = 1;
/// The plain trainer's learning rate of positions at the first step, per metre of the scene's
/// radius: Kerbl et al. 2023. Ours goes by the sizes of Gaussians.
const POSITION_RATE: f32 = 1.6e-4;
const VARIABLE: &str = "PAWS_TORCH_PYTHON";
/// Where Debian's package `python3-torch` is.
const SYSTEM: &str = "/usr/bin/python3";

/// The interpreter with PyTorch.
fn interpreter() -> Result<OsString> {
    let named = std::env::var_os(VARIABLE);
    let program = named.unwrap_or_else(|| SYSTEM.into());
    let imports = Command::new(&program)
        .args(["-c", "import torch"])
        .stderr(Stdio::null())
        .status();
    let works = imports.is_ok_and(|status| status.success());
    works.then_some(program).with_context(|| {
        format!(
            "{SYSTEM} has no PyTorch: install python3-torch, or name an interpreter with it in \
             {VARIABLE}"
        )
    })
}

/// Both trainers; `None`, with a printed reason, without PyTorch.
///
/// # Errors
/// A pose that is not finite, or a training that fails.
pub(crate) fn plain(views: &WalkViews, steps: usize) -> Result<Option<Value>> {
    let python = match interpreter() {
        Ok(python) => python,
        Err(reason) => {
            eprintln!("skipped: the plain PyTorch trainer: {reason:#}");
            return Ok(None);
        }
    };
    let training = pinhole_views(views, Part::Training, TRAINING)?;
    let tests = pinhole_views(views, Part::Validation, TESTS)?;
    let mut start = splats::StartConfig::default();
    start.max_points = GAUSSIANS;
    let scene = Scene {
        splats: splats_from_points(&points_from_views(&training, &start))?,
        background: Background::Constant([0.5; 3]),
    };
    let config = train_config(steps);
    let mut trainer = Trainer::new(
        scene.clone(),
        without_depth(&training),
        config,
        RenderConfig::default(),
        1,
    )?;
    let before = trainer.evaluate(&tests).mean_psnr_db();
    let mut order = Vec::new();
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(THREADS)
        .build()?;
    let (result, own) = pool.install(|| {
        timed(|| {
            for _ in 0..steps {
                order.push(trainer.step()?.view);
            }
            Ok::<(), splats::SplatError>(())
        })
    });
    result?;
    let after = trainer.evaluate(&tests).mean_psnr_db();
    let question = question(&scene, &training, &tests, &order, &config);
    let answer = python::ask_with(python, "splats/plain.py", &question)?;
    let walk = views.prepared.walk;
    let peer_cpu_s = answer["cpu_s"].as_f64().unwrap_or(f64::NAN);
    Ok(Some(json!({
        "walk": short_name(walk.kind, walk.light),
        "size": [SIZE.0, SIZE.1],
        "case": "plain",
        "steps": steps,
        "threads": THREADS,
        "gaussians": scene.splats.len(),
        "training_views": training.len(),
        "test_views": tests.len(),
        "ours": {
            "psnr_before_db": before,
            "psnr_db": after,
            "cpu_s": own.cpu_s,
            "wall_s": own.wall_s,
        },
        "plain": answer,
        "cpu_ratio": peer_cpu_s / own.cpu_s,
    })))
}

/// Left images without distortion, at the poses of a part, evenly over it.
fn pinhole_views(views: &WalkViews, part: Part, most: usize) -> Result<Vec<TrainingView>> {
    let (width, height) = SIZE;
    let focal = 0.5 * f64::from(width);
    let center = [width, height].map(|edge| 0.5 * f64::from(edge - 1));
    let intrinsics = [focal, focal, center[0], center[1]];
    let model = CameraModel::new(SIZE, intrinsics, Distortion::None);
    let poses = views.poses(part)?;
    let every = poses.len().div_ceil(most).max(1);
    poses
        .iter()
        .step_by(every)
        .enumerate()
        .map(|(number, (camera, _, pose))| {
            let mut view = views.pinhole(*camera, model, pose)?;
            (view.instant, view.exposure_group) = (number as u32, number as u32);
            view.depth_sigma_m = view.depth_m.iter().map(|z| 0.01 * z).collect();
            Ok(view)
        })
        .collect()
}

fn without_depth(views: &[TrainingView]) -> Vec<TrainingView> {
    let mut views = views.to_vec();
    for view in &mut views {
        view.depth_m.clear();
        view.depth_sigma_m.clear();
    }
    views
}

/// Full size in all steps, no growth, no removal, degree 0.
fn train_config(steps: usize) -> TrainConfig {
    let mut config = TrainConfig::default();
    config.steps = steps;
    config.degree = 0;
    (config.quarter_until, config.full_from) = (0.0, 0.0);
    config.loss = LossConfig::default();
    config.loss.depth_weight = 0.0;
    config.growth.start = usize::MAX;
    config.growth.min_gain_db = 0.0;
    config
}

/// What the plain trainer is to do.
fn question(
    scene: &Scene,
    training: &[TrainingView],
    tests: &[TrainingView],
    order: &[usize],
    config: &TrainConfig,
) -> Value {
    let views = |views: &[TrainingView]| -> Vec<Value> {
        let one = |view: &TrainingView| {
            let pose = view.camera.camera_from_world();
            let (r, t) = (pose.rotation_rows(), pose.translation_m());
            let rows = [0, 1, 2].map(|k| [r[3 * k], r[3 * k + 1], r[3 * k + 2], t[k]]);
            json!({ "rgb": view.rgb, "pose": rows.as_flattened() })
        };
        views.iter().map(one).collect()
    };
    let model = training[0].camera.model();
    let OptimizerConfig {
        position_decay,
        scale,
        rotation,
        opacity,
        color,
        background,
        ..
    } = config.optimizer;
    json!({
        "threads": THREADS,
        "size": [model.width, model.height],
        "lens": [model.fx, model.fy, model.cx, model.cy],
        "training": views(training),
        "tests": views(tests),
        "planes": scene.splats.planes(),
        "background": [0.5, 0.5, 0.5],
        "order": order,
        "position_decay": position_decay,
        "rates": {
            "position": POSITION_RATE * radius_m(training),
            "scale": scale,
            "rotation": rotation,
            "opacity": opacity,
            "color": color,
            "background": background,
        },
    })
}

/// Unit of the learning rate of positions: the largest coordinate of a camera from their mean, m.
fn radius_m(views: &[TrainingView]) -> f32 {
    let centers = views.iter();
    let centers = centers.map(|view| view.camera.camera_from_world().inverse().translation_m());
    let centers: Vec<[f64; 3]> = centers.collect();
    let radius = [0, 1, 2].map(|k| {
        let mean = centers.iter().map(|c| c[k]).sum::<f64>() / centers.len() as f64;
        centers
            .iter()
            .map(|c| (c[k] - mean).abs())
            .fold(0.5, f64::max)
    });
    radius.into_iter().fold(0.5, f64::max) as f32
}
