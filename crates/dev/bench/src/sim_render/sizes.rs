//! Images per second over size and batch, and over their PSNR to the exact renderer.
//!
//! Speeds over batches are those of the simulator's cameras, conversion to 8 bits included. Those
//! over the PSNR are of the renderer alone, with its images in single precision: the simulator has
//! one setting of the levels of detail, and the curve shows what others would give.

use std::f64::consts::FRAC_PI_2;
use std::hint::black_box;

use anyhow::{Result, ensure};
use cad_transforms::RigidTransform;
use serde_json::{Value, json};
use simulation::{CameraBatch, CameraConfig, FrameRequest, Frames, Quality};
use splats::{Camera, DetailConfig, DetailScene, Exposure, Image};

use super::opened_scene::OpenedScene;
use crate::meter::quantile;
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
/// Bytes of a pixel: colors, depth and mask.
const PIXEL_BYTES: u64 = 8;
/// Pixels that a round renders, at least one batch.
const PIXELS: usize = 8 << 20;
/// Rounds of each batch, of which the median and the spread are stated.
const ROUNDS: usize = 5;
/// Batch of exact images and of those of the curve.
const BATCH: usize = 8;
/// Largest scales of merged Gaussians in the image, px, of the curve. The default is one of them.
const SIGMAS_PX: [f32; 6] = [0.2, 0.4, 0.8, 1.6, 3.2, 6.4];
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
        let settings = SIGMAS_PX.map(|sigma_px| Setting::new(scene, sigma_px));
        let settings: Vec<Setting> = settings.into_iter().collect::<Result<_>>()?;
        let sizes = SIZES
            .iter()
            .map(|size| of_size(scene, *size, &poses, &settings, quick));
        let sizes: Vec<Value> = sizes.collect::<Result<_>>()?;
        Ok(json!({
            "threads": THREADS,
            "goal_worst_db": WORST_DB,
            "goal_median_db": MEDIAN_DB,
            "default_max_sigma_px": DetailConfig::default().max_sigma_px,
            "sizes": sizes,
        }))
    })
}

/// Levels of detail with one setting.
struct Setting {
    max_sigma_px: f32,
    detail: DetailScene,
}

impl Setting {
    fn new(scene: &OpenedScene, max_sigma_px: f32) -> Result<Self> {
        let mut config = DetailConfig::for_compensation(scene.content.is_compensated);
        config.max_sigma_px = max_sigma_px;
        Ok(Self {
            max_sigma_px,
            detail: DetailScene::new(&scene.content.exact, &config)?,
        })
    }
}

fn of_size(
    scene: &OpenedScene,
    size: [u32; 2],
    poses: &[RigidTransform],
    settings: &[Setting],
    quick: bool,
) -> Result<Value> {
    let pixels = size[0] as usize * size[1] as usize;
    let mut speeds = Vec::new();
    for batch in BATCHES.into_iter().filter(|batch| *batch <= poses.len()) {
        speeds.extend(speed(scene, size, poses, batch, Quality::Detail, quick)?);
    }
    let exact = speed(scene, size, poses, BATCH, Quality::Exact, quick)?;
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
        "curve": curve(scene, &cameras, settings, quick),
        "paws_sim_fps": published.map(|(_, fps)| fps),
    });
    println!("  {}x{} done", size[0], size[1]);
    Ok(row)
}

/// Speed and PSNR with each setting of the levels of detail, and the speed of exact images.
fn curve(scene: &OpenedScene, cameras: &[Camera], settings: &[Setting], quick: bool) -> Value {
    let (renderer, exact) = (&scene.renderer, &scene.content.exact);
    let pixels = cameras.first().map_or(1, |camera| {
        camera.model().width as usize * camera.model().height as usize
    });
    let images = (PIXELS / pixels).clamp(BATCH, cameras.len());
    let timed = &cameras[..images / BATCH * BATCH];
    let speed = |render: &(dyn Fn(&[Camera]) -> Vec<Image> + Sync)| {
        Speed::measure(timed.len(), if quick { 1 } else { ROUNDS }, || {
            for cameras in timed.chunks_exact(BATCH) {
                black_box(render(cameras));
            }
        })
    };
    let rows: Vec<Value> = settings
        .iter()
        .map(|setting| {
            let detail = &setting.detail;
            let pairs = measure::differences(renderer, exact, detail, cameras);
            let render =
                |cameras: &[Camera]| renderer.render_detail_batch(detail, cameras, &Exposure::NONE);
            json!({
                "max_sigma_px": setting.max_sigma_px,
                "gaussians_p50_p95": counts(detail, cameras),
                "speed": speed(&render),
                "quality": measure::Quality::of_views(pairs),
            })
        })
        .collect();
    let render = |cameras: &[Camera]| renderer.render_batch(exact, cameras, &Exposure::NONE);
    json!({ "batch": BATCH, "rows": rows, "exact": speed(&render) })
}

/// Gaussians in the nodes that cameras take: median and 95th percentile.
fn counts(detail: &DetailScene, cameras: &[Camera]) -> [f64; 2] {
    let mut counts: Vec<f64> = cameras.iter().map(|own| detail.count(own) as f64).collect();
    counts.sort_by(f64::total_cmp);
    [0.5, 0.95].map(|share| quantile(&counts, share))
}

/// Speed of batches with memory of the caller, conversion to 8 bits included; none for a batch of
/// more bytes than a camera allows.
fn speed(
    scene: &OpenedScene,
    size: [u32; 2],
    poses: &[RigidTransform],
    batch: usize,
    quality: Quality,
    quick: bool,
) -> Result<Option<Value>> {
    let mut config = CameraConfig::pinhole(size, FRAC_PI_2)?;
    config.quality = quality;
    let pixels = size[0] as usize * size[1] as usize;
    let bytes = batch as u64 * pixels as u64 * PIXEL_BYTES;
    if bytes > config.max_bytes {
        println!(
            "  batch {batch} is left out: {bytes} bytes, allowed {}",
            config.max_bytes
        );
        return Ok(None);
    }
    let cameras = CameraBatch::new(scene.store.clone(), config)?;
    let images = (PIXELS / pixels).clamp(1, poses.len()).max(batch);
    let requests: Vec<FrameRequest> = poses[..images / batch * batch]
        .iter()
        .map(|pose| FrameRequest::new(0, *pose))
        .collect();
    let mut frames = touched(size, batch);
    // Warm: memory of the threads is there too.
    let mut warm = touched(size, batch.min(BATCH));
    cameras.render(&requests[..batch.min(BATCH)], &mut warm)?;
    let rounds = if quick { 1 } else { ROUNDS };
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
    row["bytes"] = json!(bytes);
    row["images"] = json!(requests.len());
    Ok(Some(row))
}

/// Memory of a batch, each page of which was written.
fn touched(size: [u32; 2], count: usize) -> Frames {
    let [width, height] = size.map(|edge| edge as usize);
    let pixels = count * width * height;
    Frames {
        count,
        height,
        width,
        rgb: vec![1; 3 * pixels],
        depth_m: vec![1.0; pixels],
        has_depth: vec![true; pixels],
    }
}
