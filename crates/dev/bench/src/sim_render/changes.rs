//! Frames at changes of sectors: on a loop of four sectors with exact truth, and on a reconstructed
//! scene of several sectors.
//!
//! A camera goes around the loop, or along the recorded path, at walking speed, and at each border
//! to and fro. Within one recording, sectors beyond the border are loaded ahead; across an imported
//! edge images of both sectors are cross-faded. *Cold* is neither: each change loads its sector
//! from nothing. On one thread; loading ahead is waited for outside of the times, so that they do
//! not depend on the speed of the machine.
//!
//! Views at borders may cost more than others without any change; *usual* frames, whose median is
//! what frames at changes are compared with, are those of the plain route alone. Other frames of
//! the route to and fro are stated apart.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use anyhow::{Context, Result};
use cad_transforms::RigidTransform;
use serde_json::{Value, json};
use simulation::testing::SyntheticScene;
use simulation::{
    CameraBatch, CameraConfig, FrameRequest, Frames, GaussianStore, Quality, ResidencyConfig,
    SceneData,
};

use super::route::{self, FRAME_M, Step, along_recording, around_loop};
use crate::meter::{Timing, quantile, thread_cpu_s, timed};

const SIZE: [u32; 2] = [320, 240];
/// Distance between Gaussians of surfaces, m: 0.2 million of them in the loop.
const SPACING_M: f64 = 0.03;
/// Frames that a change of sector counts for, from the first in the new one.
const CHANGE_FRAMES: usize = 2;
/// Frames at changes, of which the 99.9th percentile is one.
const CHANGES: usize = 1000;
/// At most this many times the median frame.
const PREFETCHED_GOAL: f64 = 2.0;
const FADED_GOAL: f64 = 2.5;

/// How a route is rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Mode {
    Prefetched,
    CrossFaded,
    Cold,
}

impl Mode {
    fn name(self) -> &'static str {
        match self {
            Self::Prefetched => "prefetched",
            Self::CrossFaded => "cross-faded",
            Self::Cold => "cold",
        }
    }

    fn goal(self) -> Option<f64> {
        match self {
            Self::Prefetched => Some(PREFETCHED_GOAL),
            Self::CrossFaded => Some(FADED_GOAL),
            Self::Cold => None,
        }
    }
}

/// Measures the loop, and a reconstructed scene if one is given and has several sectors.
///
/// # Errors
/// A scene that cannot be rendered.
pub(super) fn measure(recorded: Option<&Arc<SceneData>>, quick: bool) -> Result<Value> {
    let imported = SyntheticScene::corridor_loop_with(SPACING_M)?.scene;
    let mut sectors = imported.sectors.clone();
    for edge in sectors.iter_mut().flat_map(|own| &mut own.edges) {
        edge.is_imported = false;
    }
    let own = Arc::new(SceneData::new(&imported.name, sectors)?);
    let mut jobs = Vec::new();
    for (mode, scene, laps) in [
        (Mode::Prefetched, &own, 4),
        (Mode::CrossFaded, &imported, 2),
        (Mode::Cold, &own, 2),
    ] {
        let poses = around_loop(if quick { 1 } else { laps }, FRAME_M)?;
        jobs.push(("synthetic loop", mode, scene, poses));
    }
    if let Some(scene) = recorded.filter(|scene| scene.sectors.len() > 1) {
        for (mode, laps) in [(Mode::Prefetched, 4), (Mode::Cold, 2)] {
            let poses = along_recording(scene, if quick { 1 } else { laps }, FRAME_M)?;
            jobs.push(("reconstructed walk", mode, scene, poses));
        }
    }
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let mut rows = Vec::new();
    for (name, mode, scene, poses) in jobs {
        let steps = frames_of(scene, mode, &poses, quick)?;
        let mut row = pool.install(|| times(scene, mode, &steps))?;
        row["scene"] = json!(name);
        row["sectors"] = json!(scene.sectors.len());
        println!("  {name}, {} done", mode.name());
        rows.push(row);
    }
    Ok(json!({
        "threads": 1,
        "width": SIZE[0],
        "height": SIZE[1],
        "rows": rows,
    }))
}

/// The route, repeated at each border until there are enough frames at changes. Cold
/// changes take long, and each costs the same: none is repeated.
fn frames_of(
    scene: &Arc<SceneData>,
    mode: Mode,
    poses: &[RigidTransform],
    quick: bool,
) -> Result<Vec<Step>> {
    let plain = route::route(scene, poses, 0)?;
    let crossings = route::changes(&plain).max(1);
    let enough = if quick { CHANGES / 10 } else { CHANGES };
    match mode {
        Mode::Cold => Ok(plain),
        Mode::Prefetched | Mode::CrossFaded => {
            let passes = enough.div_ceil(2 * CHANGE_FRAMES * crossings);
            route::route(scene, poses, passes)
        }
    }
}

/// Times of the frames of a route.
fn times(scene: &Arc<SceneData>, mode: Mode, steps: &[Step]) -> Result<Value> {
    let mut residency = ResidencyConfig::default();
    // A sector and its neighbors: the fourth of the loop leaves.
    residency.budget_bytes = 3 * largest_sector(scene)?;
    if mode == Mode::Cold {
        residency.prefetch_m = 0.0;
        residency.budget_bytes = largest_sector(scene)?;
    }
    let store = Arc::new(GaussianStore::new(scene.clone(), residency));
    let mut config = CameraConfig::pinhole(SIZE, FRAC_PI_2)?;
    config.quality = Quality::Detail;
    let camera = CameraBatch::new(store.clone(), config)?;
    let mut frames = Frames::default();
    let (mut usual, mut near, mut changes, mut faded) = (Vec::new(), Vec::new(), Vec::new(), 0);
    let mut since_change = CHANGE_FRAMES;
    for (number, step) in steps.iter().enumerate() {
        let place = (step.sector, step.sector_from_body.translation_m());
        let pose = step.sector_from_body * RigidTransform::body_from_optical();
        let request = FrameRequest::new(step.sector, pose);
        // Of this thread: loading ahead is another's.
        let cpu_s = thread_cpu_s();
        let (report, mut time) = timed(|| -> Result<_> {
            store.update(&[place])?;
            Ok(camera.render(&[request], &mut frames)?)
        });
        time.cpu_s = thread_cpu_s() - cpu_s;
        let is_faded = report?.cross_faded_frames > 0;
        // The first frame of all loads its sector.
        if number == 0 {
            continue;
        }
        since_change = match step.is_change {
            true => 0,
            false => since_change + 1,
        };
        faded += usize::from(is_faded);
        let is_change = since_change < CHANGE_FRAMES || is_faded;
        match (is_change, step.is_pass) {
            (true, _) => changes.push(time),
            (false, true) => near.push(time),
            (false, false) => usual.push(time),
        }
        if mode != Mode::Cold {
            store.wait_for_prefetch();
        }
    }
    let of = |time: fn(&Timing) -> f64| {
        let [usual, near, changes] = [&usual, &near, &changes].map(|times| sorted(time, times));
        let median = quantile(&usual, 0.5);
        json!({
            "usual": shares(&usual),
            "near": shares(&near),
            "changes": shares(&changes),
            "changes_p999_over_median": quantile(&changes, 0.999) / median,
            "changes_worst_over_median": quantile(&changes, 1.0) / median,
        })
    };
    Ok(json!({
        "mode": mode.name(),
        "goal": mode.goal(),
        "frames": steps.len() - 1,
        "frames_usual": usual.len(),
        "frames_near": near.len(),
        "frames_at_changes": changes.len(),
        "faded": faded,
        "cpu_ms": of(|time| time.cpu_s),
        "wall_ms": of(|time| time.wall_s),
    }))
}

/// Times in ms, ascending.
fn sorted(of: fn(&Timing) -> f64, times: &[Timing]) -> Vec<f64> {
    let mut values: Vec<f64> = times.iter().map(|own| 1e3 * of(own)).collect();
    values.sort_by(f64::total_cmp);
    values
}

/// Quantiles of times; none of no time.
fn shares(sorted: &[f64]) -> Value {
    let of = |share: f64| (!sorted.is_empty()).then(|| quantile(sorted, share));
    json!({ "p50": of(0.5), "p99": of(0.99), "p999": of(0.999), "worst": of(1.0) })
}

/// Memory of the largest sector: where there is no more, each change loads a sector.
pub(super) fn largest_sector(scene: &SceneData) -> Result<u64> {
    let sources = scene
        .sectors
        .iter()
        .filter_map(|own| own.gaussians.as_ref());
    let bytes = sources.map(|source| source.resident_bytes());
    bytes.max().context("a scene without Gaussians")
}
