//! `odometry_scale`: scale of paths in small, compressed images.
//!
//! One camera without IMU, 10 s, 336x188 and 672x376. A codec quantizes both eyes in blocks at the
//! same pixels of the image, which could draw disparities towards multiples of a block, and so make
//! all paths too long. Walks are rendered once per size and quantized as MJPEG and intra frames are
//! (`rig_sim::camera::codec`), with blocks at the same pixels of both eyes, and with those of the
//! right eye shifted by half a block, which would have the opposite effect. The calibration is
//! exact; it states its covariance or not.

use anyhow::{Context, Result};
use harness::sequences::{OwnedFrameSet, Sequence, WalkSettings, walk};
use harness::tracking::{self, Tracking};
use rig_sim::camera::{Quality, codec};
use rig_sim::scene::{Kind, Lighting};
use scene_bundle::Trajectory;
use serde::Serialize;
use serde_json::json;

use super::{results, settings};
use crate::arguments::Arguments;
use crate::{stamp, trajectory_errors};

/// Scenes, each with these seeds; no constant was chosen on them.
const SCENES: [Kind; 5] = [
    Kind::Pavement,
    Kind::Plaza,
    Kind::Stairs,
    Kind::Trail,
    Kind::Room,
];
const SEEDS: [u64; 2] = [91, 92];
const SECONDS: f64 = 10.0;
/// Columns and rows of one eye.
const SIZES: [[u32; 2]; 2] = [[336, 188], [672, 376]];
/// Quantization step of the lowest frequency, gray levels; 0: not compressed.
const STEPS: [f32; 3] = [0.0, 12.0, 32.0];
/// Side length of a block, px.
const BLOCK_PX: usize = 8;

/// One walk with one quantization.
#[derive(Clone, Debug, Serialize)]
struct Point {
    scene: String,
    seed: u64,
    columns: u32,
    is_covariance_stated: bool,
    step: f32,
    /// Offset of the right eye's blocks against those of the left eye along both axes, px.
    block_offset_px: usize,
    /// Scale errors of causal and refined poses, %: positive if the path is too long.
    scale_percent: [f64; 2],
    /// Poses of both beyond three stated sigmas.
    silently_wrong: [u64; 2],
}

/// Runs the benchmark: `[--quick] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let Arguments { quick, out } = Arguments::parse(args)?;
    let mut points = Vec::new();
    let walks = SCENES.into_iter().flat_map(|s| SEEDS.map(|seed| (s, seed)));
    for ((scene, seed), size) in walks.flat_map(|walk| SIZES.map(|size| (walk, size))) {
        let settings = WalkSettings {
            quality: Quality::FAST,
            size,
            cameras: vec!["left_shoulder".to_owned()],
            with_imu: false,
            ..WalkSettings::new(scene, Lighting::Day, seed, SECONDS)
        };
        let exact = walk(&settings)?;
        let sets: Vec<OwnedFrameSet> = exact.frame_sets()?.collect::<Result<_>>()?;
        for is_covariance_stated in [true, false] {
            let sequence = exact.clone().with_nominal_rig(|rig| {
                for camera in rig.cameras.iter_mut().filter(|_| !is_covariance_stated) {
                    camera.right_from_left_covariance = None;
                }
            });
            for step in STEPS {
                for block_offset_px in [0, BLOCK_PX / 2] {
                    if step == 0.0 && block_offset_px > 0 {
                        continue;
                    }
                    let [causal, refined] = track(&sequence, &sets, step, block_offset_px)?;
                    let point = Point {
                        scene: format!("{scene:?}").to_lowercase(),
                        seed,
                        columns: size[0],
                        is_covariance_stated,
                        step,
                        block_offset_px,
                        scale_percent: [causal.0, refined.0],
                        silently_wrong: [causal.1, refined.1],
                    };
                    println!("{}", serde_json::to_string(&point)?);
                    points.push(point);
                }
            }
        }
        if quick {
            break;
        }
    }
    let report = json!({
        "benchmark": "odometry_scale",
        "stamp": stamp::stamp("odometry_scale", args)?,
        "groups": groups(&points),
        "points": points,
    });
    for group in report["groups"].as_array().into_iter().flatten() {
        println!("{group}");
    }
    results::write(
        &out,
        vec![("odometry_scale.json".to_owned(), format!("{report:#}\n"))],
    )
}

/// Scale error, %, and number of silently wrong poses: causal, refined.
fn track(
    sequence: &Sequence,
    sets: &[OwnedFrameSet],
    step: f32,
    block_offset_px: usize,
) -> Result<[(f64, u64); 2]> {
    let mut tracking = Tracking::new(sequence.rig(), settings::parse("balanced")?, true);
    for set in sets {
        let mut set = set.clone();
        for view in set.views.iter_mut().flatten() {
            let size = [view.width, view.height];
            view.left = quantized(&view.left, size, step, 0);
            view.right = quantized(&view.right, size, step, block_offset_px);
        }
        tracking.add(&set)?;
    }
    let truth = tracking::truth(sequence)?;
    let of = |trajectory: &Trajectory| -> Result<(f64, u64)> {
        let errors = trajectory_errors::errors(trajectory, &truth);
        Ok((
            errors["scale_percent"].as_f64().context("a scale")?,
            errors["silently_wrong"].as_u64().context("covariances")?,
        ))
    };
    let causal = of(tracking.causal())?;
    let refined = tracking.refine()?.context("mapping is in use")?;
    Ok([causal, of(&refined.trajectory)?])
}

/// The image after a codec whose blocks begin `offset` pixels before its corner.
fn quantized(image: &[u8], [width, height]: [usize; 2], step: f32, offset: usize) -> Vec<u8> {
    let padded = |size: usize| (size + offset).next_multiple_of(BLOCK_PX);
    let (stride, rows) = (padded(width), padded(height));
    let inside = |at: usize, size: usize| at.saturating_sub(offset).min(size - 1);
    let mut luma: Vec<u8> = (0..stride * rows)
        .map(|i| image[inside(i / stride, height) * width + inside(i % stride, width)])
        .collect();
    codec::quantize(&mut luma, stride, [stride, rows], step);
    (0..width * height)
        .map(|i| luma[(i / width + offset) * stride + i % width + offset])
        .collect()
}

/// Mean, standard deviation and standard error of the scale errors of all walks.
fn groups(points: &[Point]) -> Vec<serde_json::Value> {
    let key = |p: &Point| {
        let step = p.step.to_bits();
        (p.columns, p.is_covariance_stated, step, p.block_offset_px)
    };
    let mut keys: Vec<_> = points.iter().map(key).collect();
    keys.sort_unstable();
    keys.dedup();
    let group = |of| {
        let own: Vec<&Point> = points.iter().filter(|p| key(p) == of).collect();
        let statistics = [0, 1].map(|k| {
            let count = own.len() as f64;
            let mean = own.iter().map(|p| p.scale_percent[k]).sum::<f64>() / count;
            let squares = own.iter().map(|p| (p.scale_percent[k] - mean).powi(2));
            let deviation = (squares.sum::<f64>() / (count - 1.0)).sqrt();
            json!({ "mean": mean, "deviation": deviation, "error_of_mean": deviation / count.sqrt() })
        });
        let wrong = |k: usize| own.iter().map(|p| p.silently_wrong[k]).sum::<u64>();
        json!({
            "columns": own[0].columns,
            "is_covariance_stated": own[0].is_covariance_stated,
            "step": own[0].step,
            "block_offset_px": own[0].block_offset_px,
            "walks": own.len(),
            "causal_scale_percent": statistics[0],
            "refined_scale_percent": statistics[1],
            "silently_wrong": [wrong(0), wrong(1)],
        })
    };
    keys.into_iter().map(group).collect()
}
