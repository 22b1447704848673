//! Failures at rising strength: quality on test views of a training from damaged views.

use std::sync::Arc;

use anyhow::{Context, Result};
use cad_transforms::RigidTransform;
use reconstruction::pipeline::stages::splats::SplatsConfig;
use rig_sim::random;
use rig_sim::simulation::Imaging;
use serde_json::Value;
use splats::TrainingView;

use super::exam::Exam;
use super::fit;
use super::views::{KnownExposure, Part, ViewOptions};
use crate::terrain::walks::{Walk, WalkInputs};

const SEED: u64 = 23;
const STREAM: u64 = 0xe1;
/// Rotations of poses with a displacement of 1 cm, degrees.
const DEG_PER_CM: f64 = 0.2;
const GAMMA: f64 = 2.2;

/// A kind of damage, its unit, and its strengths.
struct Kind {
    name: &'static str,
    unit: &'static str,
    strengths: &'static [f64],
    damage: fn(Vec<TrainingView>, f64) -> Result<Vec<TrainingView>>,
}

const KINDS: [Kind; 6] = [
    Kind {
        name: "pose noise",
        unit: "cm",
        strengths: &[0.5, 2.0, 5.0],
        damage: pose_noise,
    },
    Kind {
        name: "exposure jumps",
        unit: "log gain",
        strengths: &[0.1, 0.3, 0.6],
        damage: exposure_jumps,
    },
    Kind {
        name: "few views",
        unit: "every",
        strengths: &[2.0, 4.0, 8.0],
        damage: few_views,
    },
    Kind {
        name: "depth scale",
        unit: "%",
        strengths: &[3.0, 10.0, 30.0],
        damage: depth_scale,
    },
    Kind {
        name: "views without depth",
        unit: "%",
        strengths: &[75.0, 95.0, 100.0],
        damage: no_depth,
    },
    Kind {
        name: "views without mask",
        unit: "%",
        strengths: &[25.0, 100.0],
        damage: no_mask,
    },
];

/// Exposure times of motion blur, s.
const BLUR_S: [f64; 2] = [0.008, 0.02];

/// A row per kind and strength, the undamaged one first.
///
/// # Errors
/// A preset that there is not, or a pose that is not finite.
pub(crate) fn failures(exam: &Exam, preset: &str, steps: Option<usize>) -> Result<Vec<Value>> {
    let (config, options) = setting(preset, steps)?;
    let training = exam.views.recorded(Part::Training, &options)?;
    let mut rows = Vec::new();
    let mut add = |kind: &str, unit: &str, strength: f64, views| -> Result<()> {
        let case = format!("{kind} {strength} {unit}");
        let mut row = exam.run_with(&case, preset, &config, views, &options)?;
        row["kind"] = kind.into();
        row["unit"] = unit.into();
        row["strength"] = strength.into();
        rows.push(row);
        Ok(())
    };
    add("none", "", 0.0, training.clone())?;
    for kind in &KINDS {
        for strength in kind.strengths {
            let views = (kind.damage)(training.clone(), *strength)?;
            add(kind.name, kind.unit, *strength, views)?;
        }
    }
    Ok(rows)
}

/// A row per exposure time: images with motion blur, whose gains are known.
///
/// # Errors
/// A preset that there is not, or an I/O error.
pub(crate) fn blur(walk: Walk, preset: &str, steps: Option<usize>) -> Result<Vec<Value>> {
    let (config, options) = setting(preset, steps)?;
    let options = ViewOptions {
        exposure: KnownExposure::TimeAndGain,
        ..options
    };
    let mut rows = Vec::new();
    for seconds in BLUR_S {
        let usual = walk.prepare()?;
        let imaging = Imaging {
            exposure_s: Some(seconds),
            ..Imaging::USUAL
        };
        let simulation = (*usual.simulation).clone().with_imaging(imaging);
        let prepared = WalkInputs {
            walk,
            simulation: Arc::new(simulation.context("preparing the walk")?),
        };
        let exam = Exam::new(prepared, &format!("-{}ms", 1e3 * seconds), 0)?;
        let case = format!("motion blur {} ms", 1e3 * seconds);
        let mut row = exam.run(&case, preset, &config, &options)?;
        row["kind"] = "motion blur".into();
        row["unit"] = "ms".into();
        row["strength"] = (1e3 * seconds).into();
        rows.push(row);
    }
    Ok(rows)
}

fn setting(preset: &str, steps: Option<usize>) -> Result<(SplatsConfig, ViewOptions)> {
    let config = fit::config(preset, steps)?;
    let options = ViewOptions {
        reduction: config.reduction,
        ..ViewOptions::STAGE
    };
    Ok((config, options))
}

/// Of a frame: both images of it move and change together.
fn group(view: &TrainingView) -> u64 {
    u64::from(view.exposure_group)
}

fn pose_noise(mut views: Vec<TrainingView>, sigma_cm: f64) -> Result<Vec<TrainingView>> {
    for view in &mut views {
        let draw = |k: u64| random::bell(SEED, STREAM, 8 * group(view) + k);
        let position = [0, 1, 2].map(|k| 0.01 * sigma_cm * draw(k));
        let rotation = [3, 4, 5].map(|k| (sigma_cm * DEG_PER_CM).to_radians() * draw(k));
        let motion = RigidTransform::from_rotation_vector(rotation, position)?;
        let pose = motion * *view.camera.camera_from_world();
        view.camera = view.camera.clone().with_pose(pose);
    }
    Ok(views)
}

/// Unknown gains, independent from frame to frame.
fn exposure_jumps(mut views: Vec<TrainingView>, sigma: f64) -> Result<Vec<TrainingView>> {
    for view in &mut views {
        let log = sigma * random::bell(SEED, STREAM + 1, group(view));
        let factor = libm::exp(log / GAMMA);
        for value in &mut view.rgb {
            *value = (f64::from(*value) * factor + 0.5) as u8;
        }
    }
    Ok(views)
}

fn few_views(mut views: Vec<TrainingView>, every: f64) -> Result<Vec<TrainingView>> {
    let every = every as u32;
    views.retain(|view| view.instant % every == 0);
    Ok(views)
}

fn depth_scale(mut views: Vec<TrainingView>, percent: f64) -> Result<Vec<TrainingView>> {
    for view in &mut views {
        let factor = (1.0 + 0.01 * percent) as f32;
        view.depth_m.iter_mut().for_each(|z| *z *= factor);
        view.depth_sigma_m.iter_mut().for_each(|s| *s *= factor);
    }
    Ok(views)
}

fn is_chosen(view: &TrainingView, percent: f64) -> bool {
    100.0 * random::uniform(SEED, STREAM + 2, group(view)) < percent
}

fn no_depth(mut views: Vec<TrainingView>, percent: f64) -> Result<Vec<TrainingView>> {
    for view in views.iter_mut().filter(|view| is_chosen(view, percent)) {
        view.depth_m.clear();
        view.depth_sigma_m.clear();
    }
    Ok(views)
}

fn no_mask(mut views: Vec<TrainingView>, percent: f64) -> Result<Vec<TrainingView>> {
    for view in views.iter_mut().filter(|view| is_chosen(view, percent)) {
        view.mask.clear();
    }
    Ok(views)
}
