//! Frames at changes of sectors, on a loop of four sectors with exact truth.
//!
//! A camera goes around the loop at walking speed. Within one recording, sectors beyond the border
//! are loaded ahead; across an imported edge images of both sectors are cross-faded. *Cold* is
//! neither: each change loads its sector from nothing. On one thread; loading ahead is waited for
//! outside of the times, so that they do not depend on the speed of the machine.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use anyhow::{Context, Result};
use cad_transforms::RigidTransform;
use serde_json::{Value, json};
use simulation::testing::SyntheticScene;
use simulation::{
    CameraBatch, CameraConfig, FrameRequest, Frames, GaussianStore, Place, Quality,
    ResidencyConfig, SceneData, Similarity,
};

use crate::meter::{Timing, quantile, thread_cpu_s, timed};

const SIZE: [u32; 2] = [320, 240];
const LAPS: usize = 10;
const QUICK_LAPS: usize = 2;
/// Distance between Gaussians of surfaces, m: 0.2 million of them in the loop.
const SPACING_M: f64 = 0.03;
/// Way between two frames, m: a person who walks, at 10 frames per second.
const FRAME_M: f64 = 0.14;
/// The loop, m.
const CORNERS_M: [[f64; 2]; 4] = [[1.0, 1.0], [11.0, 1.0], [11.0, 11.0], [1.0, 11.0]];
const EYE_M: f64 = 1.4;
/// Frames that a change of sector counts for, from the first in the new one.
const CHANGE_FRAMES: usize = 2;
/// At most this many times the median frame.
const PREFETCHED_GOAL: f64 = 2.0;
const FADED_GOAL: f64 = 2.5;

/// # Errors
/// The scene cannot be rendered.
pub(super) fn measure(quick: bool) -> Result<Value> {
    let laps = if quick { QUICK_LAPS } else { LAPS };
    let imported = SyntheticScene::corridor_loop_with(SPACING_M)?.scene;
    let mut own = SceneData::clone(&imported);
    for edge in own.sectors.iter_mut().flat_map(|own| &mut own.edges) {
        edge.is_imported = false;
    }
    let own = Arc::new(own);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    let mut rows = Vec::new();
    for (name, scene, is_ahead, goal) in [
        ("prefetched", &own, true, Some(PREFETCHED_GOAL)),
        ("cross-faded", &imported, true, Some(FADED_GOAL)),
        ("cold", &own, false, None),
    ] {
        let mut row = pool.install(|| lap_times(scene, is_ahead, laps))?;
        row["mode"] = json!(name);
        row["goal"] = json!(goal);
        rows.push(row);
    }
    Ok(json!({
        "threads": 1,
        "width": SIZE[0],
        "height": SIZE[1],
        "laps": laps,
        "rows": rows,
    }))
}

/// Times of the frames of some laps.
fn lap_times(scene: &Arc<SceneData>, is_ahead: bool, laps: usize) -> Result<Value> {
    let mut residency = ResidencyConfig::default();
    // A sector and its neighbors: the fourth leaves.
    residency.budget_bytes = 3 * largest_sector(scene)?;
    if !is_ahead {
        residency.prefetch_m = 0.0;
        residency.budget_bytes = largest_sector(scene)?;
    }
    let store = Arc::new(GaussianStore::new(scene.clone(), residency));
    let mut config = CameraConfig::pinhole(SIZE, FRAC_PI_2)?;
    config.quality = Quality::Detail;
    let camera = CameraBatch::new(store.clone(), config)?;
    let mut frames = Frames::default();
    let mut walker = Walker::new(scene);
    let (mut usual, mut changes, mut faded) = (Vec::new(), Vec::new(), 0);
    let mut since_change = CHANGE_FRAMES;
    let lap_m = 4.0 * (CORNERS_M[1][0] - CORNERS_M[0][0]);
    let count = (laps as f64 * lap_m / FRAME_M) as usize;
    for number in 0..count {
        let before = walker.sector;
        let pose = walker.go_to(number as f64 * FRAME_M)?;
        let place = (walker.sector, pose.translation_m());
        let request = FrameRequest::new(walker.sector, pose * RigidTransform::body_from_optical());
        // Of this thread: loading ahead is another's.
        let cpu_s = thread_cpu_s();
        let (report, mut time) = timed(|| -> Result<_> {
            store.update(&[place])?;
            Ok(camera.render(&[request], &mut frames)?)
        });
        time.cpu_s = thread_cpu_s() - cpu_s;
        let is_faded = report?.faded > 0;
        // The first frame of all loads its sector.
        if number == 0 {
            continue;
        }
        since_change = match walker.sector == before {
            true => since_change + 1,
            false => 0,
        };
        faded += usize::from(is_faded);
        match since_change < CHANGE_FRAMES || is_faded {
            true => changes.push(time),
            false => usual.push(time),
        }
        if is_ahead {
            store.wait_for_prefetch();
        }
    }
    let sorted = |of: fn(&Timing) -> f64, times: &[Timing]| {
        let mut values: Vec<f64> = times.iter().map(|own| 1e3 * of(own)).collect();
        values.sort_by(f64::total_cmp);
        values
    };
    let of = |time: fn(&Timing) -> f64| {
        let (usual, changes) = (sorted(time, &usual), sorted(time, &changes));
        let median = quantile(&usual, 0.5);
        json!({
            "usual": { "p50": median, "p999": quantile(&usual, 0.999) },
            "changes": {
                "p50": quantile(&changes, 0.5),
                "worst": quantile(&changes, 1.0),
            },
            "changes_worst_over_median": quantile(&changes, 1.0) / median,
        })
    };
    Ok(json!({
        "frames": count,
        "frames_at_changes": changes.len(),
        "faded": faded,
        "cpu_ms": of(|time| time.cpu_s),
        "wall_ms": of(|time| time.wall_s),
    }))
}

/// Memory of the largest sector: where there is no more, each change loads a sector.
fn largest_sector(scene: &SceneData) -> Result<u64> {
    let sources = scene
        .sectors
        .iter()
        .filter_map(|own| own.gaussians.as_ref());
    let bytes = sources.map(|source| source.resident_bytes());
    bytes.max().context("a scene without Gaussians")
}

/// A camera that goes around the loop, from sector to sector.
struct Walker<'a> {
    scene: &'a SceneData,
    sector: usize,
    /// Transforms from the first sector to this one, in their order.
    chain: Vec<Similarity>,
}

impl<'a> Walker<'a> {
    fn new(scene: &'a SceneData) -> Self {
        Self {
            scene,
            sector: 0,
            chain: Vec::new(),
        }
    }

    /// The pose of the eye in its sector after a way, m.
    fn go_to(&mut self, way_m: f64) -> Result<RigidTransform> {
        let chained = self
            .chain
            .iter()
            .fold(eye(way_m)?, |pose, next| next.carry(&pose));
        let place = Place {
            sector: self.sector,
            sector_from_body: chained,
        };
        let next = self.scene.cross(&place);
        if next.sector != self.sector {
            let edges = &self.scene.sectors[self.sector].edges;
            let edge = edges.iter().find(|edge| edge.to == next.sector);
            let edge = edge.context("no edge to the next sector")?;
            self.chain.push(edge.to_from_here);
            self.sector = next.sector;
            if self.sector == 0 {
                self.chain.clear();
            }
        }
        Ok(next.sector_from_body)
    }
}

/// The eye on the loop in the frame of the first sector.
fn eye(way_m: f64) -> Result<RigidTransform> {
    let side_m = CORNERS_M[1][0] - CORNERS_M[0][0];
    let sides = way_m / side_m;
    let [from, to] = [0, 1].map(|next| CORNERS_M[(sides as usize + next) % CORNERS_M.len()]);
    let share = sides.fract();
    let [x, y] = [0, 1].map(|k| from[k] + share * (to[k] - from[k]));
    let yaw = libm::atan2(to[1] - from[1], to[0] - from[0]);
    Ok(RigidTransform::from_rotation_vector(
        [0.0, 0.0, yaw],
        [x, y, EYE_M],
    )?)
}
