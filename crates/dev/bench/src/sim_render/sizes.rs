//! Images per second over size and batch, and their quality.

use std::f64::consts::FRAC_PI_2;
use std::hint::black_box;

use anyhow::{Result, ensure};
use cad_transforms::RigidTransform;
use serde_json::{Value, json};
use simulation::{CameraBatch, CameraConfig, FrameRequest, Frames, Quality};
use splats::Camera;

use super::opened_scene::OpenedScene;
use crate::render_speed::PAWS_SIM;
use crate::render_speed::measure::{self, Speed};
use crate::render_speed::poses::{camera, reference_poses};

const THREADS: usize = 2;
const SIZES: [[u32; 2]; 6] = [
    [64, 64],
    [96, 96],
    [256, 256],
    [512, 512],
    [1024, 1024],
    [1280, 720],
];
const BATCHES: [usize; 4] = [1, 8, 64, 512];
/// Most pixels of a batch: larger ones are left out.
const MAX_BATCH_PIXELS: usize = 80 << 20;
/// Pixels that a measurement renders, at least one batch.
const PIXELS: usize = 8 << 20;
const MAX_ROUNDS: usize = 5;
/// Views whose quality is compared, and pixels of them in all.
const VIEWS: usize = 512;
const QUALITY_PIXELS: usize = 16 << 20;
/// Worst and median PSNR to the exact image that the fast one should have, dB.
const WORST_DB: f64 = 35.0;
const MEDIAN_DB: f64 = 40.0;

pub(super) fn measure(scene: &OpenedScene, quick: bool) -> Result<Value> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(THREADS);
    pool.build()?.install(|| {
        let sector = &scene.scene.sectors[0];
        let count = if quick { 64 } else { VIEWS };
        let exact = &scene.content.exact;
        let poses = reference_poses(&scene.renderer, exact, &sector.references, count)?;
        ensure!(
            poses.len() == count,
            "found {} views with less than half sky and nothing near, expected {count}",
            poses.len()
        );
        let sizes = SIZES
            .iter()
            .map(|size| of_size(scene, *size, &poses, quick));
        let sizes: Vec<Value> = sizes.collect::<Result<_>>()?;
        Ok(json!({
            "threads": THREADS,
            "goal_worst_db": WORST_DB,
            "goal_median_db": MEDIAN_DB,
            "sizes": sizes,
        }))
    })
}

fn of_size(
    scene: &OpenedScene,
    size: [u32; 2],
    poses: &[RigidTransform],
    quick: bool,
) -> Result<Value> {
    let pixels = size[0] as usize * size[1] as usize;
    let mut speeds = Vec::new();
    for batch in BATCHES {
        if batch > poses.len() || batch * pixels > MAX_BATCH_PIXELS {
            continue;
        }
        speeds.push(speed(scene, size, poses, batch, Quality::Detail, quick)?);
    }
    let exact = speed(scene, size, poses, 8, Quality::Exact, true)?;
    let views = (QUALITY_PIXELS / pixels).clamp(16, poses.len());
    let cameras: Vec<Camera> = poses[..views]
        .iter()
        .map(|pose| camera(size, pose))
        .collect::<Result<_, _>>()?;
    let content = &scene.content;
    let pairs = measure::differences(&scene.renderer, &content.exact, &content.detail, &cameras);
    let failures: Vec<Value> = pairs
        .iter()
        .zip(poses)
        .enumerate()
        .filter(|(_, ((psnr_db, _), _))| *psnr_db < WORST_DB)
        .map(|(view, ((psnr_db, _), pose))| {
            json!({
                "view": view,
                "psnr_db": psnr_db,
                "position_m": pose.translation_m(),
                "rotation_wxyz": pose.rotation_wxyz(),
            })
        })
        .collect();
    let published = PAWS_SIM.iter().find(|(edge, _)| size == [*edge as u32; 2]);
    let row = json!({
        "width": size[0],
        "height": size[1],
        "speeds": speeds,
        "exact": exact,
        "views": views,
        "quality": measure::Quality::of_views(pairs),
        "failures": failures,
        "paws_sim_fps": published.map(|(_, fps)| fps),
    });
    println!("  {}x{} done", size[0], size[1]);
    Ok(row)
}

/// Speed of batches with memory of the caller, conversion to 8 bits included.
fn speed(
    scene: &OpenedScene,
    size: [u32; 2],
    poses: &[RigidTransform],
    batch: usize,
    quality: Quality,
    quick: bool,
) -> Result<Value> {
    let mut config = CameraConfig::pinhole(size, FRAC_PI_2)?;
    config.quality = quality;
    let cameras = CameraBatch::new(scene.store.clone(), config)?;
    let pixels = size[0] as usize * size[1] as usize;
    let images = (PIXELS / pixels).clamp(1, poses.len()).max(batch);
    let requests: Vec<FrameRequest> = poses[..images / batch * batch]
        .iter()
        .map(|pose| FrameRequest::new(0, *pose))
        .collect();
    let mut frames = Frames::default();
    // Warm: memory of the caller and of the threads is there.
    cameras.render(&requests[..batch], &mut frames)?;
    let rounds = match quick || batch * pixels >= PIXELS {
        true => 1,
        false => MAX_ROUNDS,
    };
    let mut failed = None;
    let speed = Speed::measure(requests.len(), rounds, || {
        for requests in requests.chunks_exact(batch) {
            if let Err(error) = cameras.render(requests, &mut frames) {
                failed = Some(error);
            }
            black_box(&frames);
        }
    });
    if let Some(error) = failed {
        return Err(error.into());
    }
    let mut row = json!(speed);
    row["batch"] = json!(batch);
    row["images"] = json!(requests.len());
    row["rounds"] = json!(rounds);
    Ok(row)
}
