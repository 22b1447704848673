//! A training as the stage `splats` runs it, with its costs.

use anyhow::{Context, Result, bail};
use reconstruction::pipeline::stages::Preset;
use reconstruction::pipeline::stages::splats::{SplatsConfig, start};
use splats::{
    Evaluation, GrowthByNeed, GrowthCheck, Renderer, Scene, TrainConfig, Trainer, TrainingView,
};

use crate::meter::{Timing, timed};

/// Names of presets: those of the stage, and that of PAWS.
pub(crate) const PRESETS: [&str; 4] = ["fast", "balanced", "accurate", "paws"];

/// The configuration of a preset, with another number of steps if one is given.
///
/// # Errors
/// There is no such preset.
pub(crate) fn config(preset: &str, steps: Option<usize>) -> Result<SplatsConfig> {
    let config = match preset {
        "fast" => SplatsConfig::preset(Preset::Fast, steps),
        "balanced" => SplatsConfig::preset(Preset::Balanced, steps),
        "accurate" => SplatsConfig::preset(Preset::Accurate, steps),
        "paws" => paws(steps),
        _ => bail!(
            "there is no preset {preset:?}, expected one of {}",
            PRESETS.join(", ")
        ),
    };
    Ok(config)
}

/// The settings of PAWS, their schedule scaled to the number of steps, on our start.
fn paws(steps: Option<usize>) -> SplatsConfig {
    let mut train = TrainConfig::preset(splats::Preset::Paws);
    if let Some(steps) = steps {
        let whole = train.steps;
        let scaled = |of: usize| (of * steps).div_ceil(whole);
        let growth = &mut train.growth;
        growth.start = scaled(growth.start);
        growth.interval = scaled(growth.interval);
        growth.reset_interval = scaled(growth.reset_interval);
        train.poses.start = scaled(train.poses.start);
        train.steps = steps;
    }
    let mut config = SplatsConfig::default();
    config.train = train;
    config
}

/// A trained scene and what it took.
pub(crate) struct Fit {
    pub(crate) scene: Scene,
    pub(crate) start_count: usize,
    pub(crate) checks: Vec<GrowthCheck>,
    /// Of the start, the steps and the checks, without evaluations.
    pub(crate) timing: Timing,
    /// Steps, those of the checks of growth included.
    pub(crate) steps: usize,
    pub(crate) curve: Vec<CurvePoint>,
}

/// The state after a part of the training.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CurvePoint {
    pub(crate) step: usize,
    pub(crate) cpu_s: f64,
    pub(crate) splats: usize,
    pub(crate) psnr_db: f64,
}

/// Trains a scene. `validation` decides the number of Gaussians; `points` times the scene is
/// compared with `curve_views`.
///
/// # Errors
/// No view has depth, or the training fails.
pub(crate) fn fit(
    training: Vec<TrainingView>,
    validation: &[TrainingView],
    config: &SplatsConfig,
    (curve_views, points): (&[TrainingView], usize),
) -> Result<Fit> {
    let (scene, timing) = timed(|| start(&training, config));
    let scene = scene?.context("no view has depth")?;
    let mut fit = fit_from(scene, training, validation, config, (curve_views, points))?;
    fit.timing.cpu_s += timing.cpu_s;
    fit.timing.wall_s += timing.wall_s;
    for point in &mut fit.curve {
        point.cpu_s += timing.cpu_s;
    }
    Ok(fit)
}

/// The same from a given start, whose time is not included.
///
/// # Errors
/// The training fails.
pub(crate) fn fit_from(
    scene: Scene,
    training: Vec<TrainingView>,
    validation: &[TrainingView],
    config: &SplatsConfig,
    (curve_views, points): (&[TrainingView], usize),
) -> Result<Fit> {
    let start_count = scene.splats.len();
    let mut trainer = Trainer::new(scene, training, config.train, config.render, config.seed)?;
    let mut growth = GrowthByNeed::new(&config.train);
    let mut total = Timing {
        wall_s: 0.0,
        cpu_s: 0.0,
    };
    let total_steps = config.train.steps;
    let mut curve = Vec::new();
    for point in 1..=points.max(1) {
        let until = total_steps * point / points.max(1);
        let (result, timing) = timed(|| {
            while trainer.steps() < until {
                growth.advance(&mut trainer, validation)?;
            }
            Ok::<(), splats::SplatError>(())
        });
        result?;
        total.wall_s += timing.wall_s;
        total.cpu_s += timing.cpu_s;
        if !curve_views.is_empty() {
            curve.push(CurvePoint {
                step: trainer.steps(),
                cpu_s: total.cpu_s,
                splats: trainer.scene().splats.len(),
                psnr_db: trainer.evaluate(curve_views).mean_psnr_db(),
            });
        }
    }
    let checks = growth.checks().to_vec();
    // Each check runs the steps of the scene that it discards, too.
    let discarded = checks.len() * config.train.growth.check_steps;
    Ok(Fit {
        scene: trainer.scene().clone(),
        start_count,
        steps: trainer.steps() + discarded,
        checks,
        timing: total,
        curve,
    })
}

/// Quality of a scene in views.
///
/// # Errors
/// The configuration of the renderer.
pub(crate) fn evaluate(
    scene: &Scene,
    views: &[TrainingView],
    config: &SplatsConfig,
) -> Result<Evaluation> {
    let renderer = Renderer::new(config.render)?;
    Ok(Evaluation::new(&renderer, scene, views))
}
