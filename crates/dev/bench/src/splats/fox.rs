//! The fox of the shared data: 50 photos by a phone, every eighth held out.
//!
//! There is no depth and no sparse reconstruction: the scene starts at random points around what
//! all cameras look at. Lengths are in the units of the set.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use reconstruction::pipeline::stages::splats::SplatsConfig;
use rig_sim::random;
use serde_json::{Value, json};
use splats::{Background, Camera, Plane, Scene, Sky, StartPoint, TrainingView, splats_from_points};

use super::exam::scores;
use super::fit;
use crate::meter::median;

const SET: &str = "07_multiview/fox";
const HELD_OUT: usize = 8;
/// Factor by which the photos of 1080x1920 are reduced.
const REDUCTION: u32 = 4;
const POINTS: usize = 20_000;
/// Opacity at the start, as a logit: 0.1, so that light passes through empty space.
const OPACITY_LOGIT: f32 = -2.197;
const SEED: u64 = 5;
const STREAM: u64 = 0xe2;

/// A row per preset; `None`, with a printed reason, without the set.
///
/// # Errors
/// A photo that cannot be read, or a training that fails.
pub(crate) fn fox(presets: &[String], steps: Option<usize>) -> Result<Option<Vec<Value>>> {
    let folder = match harness::data::sets([SET]) {
        Ok([folder]) => folder,
        Err(reason) => {
            eprintln!("{reason}");
            return Ok(None);
        }
    };
    let views = photos(&folder)?;
    let is_held_out = |number: &usize| number.is_multiple_of(HELD_OUT);
    let part = |held_out: bool| -> Vec<TrainingView> {
        let numbers = (0..views.len()).filter(|number| is_held_out(number) == held_out);
        numbers.map(|number| views[number].clone()).collect()
    };
    let (training, held_out) = (part(false), part(true));
    let mut rows = Vec::new();
    for preset in presets {
        let mut config = fit::config(preset, steps)?;
        if preset == "fast" {
            // The photos are reduced already.
            config.train.full_from = 0.28;
        }
        rows.push(row(preset, &config, &training, &held_out)?);
    }
    Ok(Some(rows))
}

fn row(
    preset: &str,
    config: &SplatsConfig,
    training: &[TrainingView],
    held_out: &[TrainingView],
) -> Result<Value> {
    let start = start(training)?;
    let curve = (held_out, 7);
    // Held-out photos are the exam: growth ends by schedule.
    let mut own = *config;
    own.train.growth.min_gain_db = 0.0;
    let fit = fit::fit_from(start, training.to_vec(), &[], &own, curve)?;
    let model = training[0].camera.model();
    let mut row = json!({
        "walk": "fox",
        "size": [model.width, model.height],
        "case": "",
        "preset": preset,
        "steps": config.train.steps,
        "views": training.len(),
    });
    super::exam::add_costs(&mut row, &fit);
    row["held_out"] = scores(&fit::evaluate(&fit.scene, held_out, config)?);
    Ok(row)
}

/// Photos with their cameras, in order of their names. Poses of the list without a photo are left
/// out.
fn photos(folder: &Path) -> Result<Vec<TrainingView>> {
    let path = folder.join("transforms.json");
    let text = fs::read_to_string(&path).with_context(|| format!("reading {}", path.display()))?;
    let list: Value = serde_json::from_str(&text)?;
    let number = |of: &Value, key: &str| of[key].as_f64().with_context(|| format!("no {key}"));
    let size = (number(&list, "w")? as u32, number(&list, "h")? as u32);
    let intrinsics = ["fl_x", "fl_y", "cx", "cy"].map(|key| number(&list, key));
    let [fx, fy, cx, cy] = intrinsics;
    // Their principal point is counted from the corner of the image.
    let intrinsics = [fx?, fy?, cx? - 0.5, cy? - 0.5];
    let distortion = Distortion::RadTan5 {
        k1: number(&list, "k1")?,
        k2: number(&list, "k2")?,
        p1: number(&list, "p1")?,
        p2: number(&list, "p2")?,
        k3: 0.0,
    };
    let model = CameraModel::new(size, intrinsics, distortion);
    let frames = list["frames"].as_array().context("no frames")?;
    let mut found = Vec::new();
    for frame in frames {
        let file = frame["file_path"].as_str().context("no file_path")?;
        let path = folder.join(file);
        if path.exists() {
            found.push((file.to_owned(), path, pose(&frame["transform_matrix"])?));
        }
    }
    found.sort_by(|a, b| a.0.cmp(&b.0));
    found
        .par_iter()
        .enumerate()
        .map(|(number, (_, path, world_from_camera))| {
            let bytes = fs::read(path).with_context(|| format!("reading {}", path.display()))?;
            let mut decoder = zune_jpeg::JpegDecoder::new(std::io::Cursor::new(bytes));
            let rgb = decoder.decode().context("decoding a JPEG file")?;
            let expected = 3 * size.0 as usize * size.1 as usize;
            ensure!(
                rgb.len() == expected,
                "{} is of another size",
                path.display()
            );
            let camera = Camera::new(model, world_from_camera.inverse())?;
            Ok(TrainingView::new(camera, rgb, number as u32).reduced(REDUCTION)?)
        })
        .collect()
}

/// A pose of a camera that looks along -z, as one that looks along z with y down.
fn pose(matrix: &Value) -> Result<RigidTransform> {
    let at = |row: usize, column: usize| matrix[row][column].as_f64().context("no matrix");
    let mut rows = [0.0; 12];
    for row in 0..3 {
        for column in 0..4 {
            let sign = if column == 1 || column == 2 {
                -1.0
            } else {
                1.0
            };
            rows[4 * row + column] = sign * at(row, column)?;
        }
    }
    Ok(RigidTransform::from_rows_3x4(rows)?)
}

/// Random points in a cube around the point that is nearest to all optical axes.
fn start(views: &[TrainingView]) -> Result<Scene> {
    let (mut sum, mut right) = (Matrix3::zeros(), Vector3::zeros());
    let poses = views.iter();
    let poses = poses.map(|view| view.camera.camera_from_world().inverse());
    let poses: Vec<RigidTransform> = poses.collect();
    for pose in &poses {
        let axis = Vector3::from(pose.rotate([0.0, 0.0, 1.0]));
        let across = Matrix3::identity() - axis * axis.transpose();
        sum += across;
        right += across * pose.translation();
    }
    let focus = sum.try_inverse().context("all cameras look alike")? * right;
    let reach = median(poses.iter().map(|pose| (pose.translation() - focus).norm()));
    let spacing = 2.0 * reach / libm::cbrt(POINTS as f64);
    let point = |index: usize| {
        let draw = |k: u64| 2.0 * random::uniform(SEED, STREAM, 3 * index as u64 + k) - 1.0;
        let at = [0, 1, 2].map(|k| (focus[k as usize] + reach * draw(k)) as f32);
        StartPoint {
            position_m: at,
            normal: None,
            spacing_m: spacing as f32,
            sigma_m: 0.0,
            color: [0.5; 3],
        }
    };
    let points: Vec<StartPoint> = (0..POINTS).map(point).collect();
    let mut splats = splats_from_points(&points)?;
    splats.planes_mut()[Plane::OPACITY].fill(OPACITY_LOGIT);
    Ok(Scene {
        splats,
        background: Background::Sky(Sky::uniform(32, [0.5; 3])?),
    })
}
