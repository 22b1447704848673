//! Beogym's measurement: an agent that walks, and its camera, on one thread.
//!
//! A step is the motion of the agent over the ground, which looks up the map, the sector that owns
//! the camera, and an image of 1280x720 with depth. The agent walks between two places on the
//! recorded path, there and back, along the shortest path. Sectors of a bundle have one world, and
//! maps for all of it: an agent keeps its pose where its sector changes.

use std::f64::consts::FRAC_PI_2;

use anyhow::{Context, Result, ensure};
use cad_transforms::RigidTransform;
use serde_json::{Value, json};
use simulation::{
    AgentConfig, AgentState, CameraBatch, CameraConfig, DistanceField, Drive, FrameRequest, Frames,
    Ground, Place, Quality, SceneData, advance,
};

use super::opened_scene::OpenedScene;
use crate::meter::{Timing, median, quantile, timed};

const SIZE: [u32; 2] = [1280, 720];
const STEPS: usize = 200;
const QUICK_STEPS: usize = 20;
/// Episodes of which each is the same.
const ROUNDS: usize = 5;
/// Steps that a change of sector counts for, from the first in the new one.
const CHANGE_STEPS: usize = 2;
const DT_S: f64 = 0.1;
/// Distance at which a goal is reached, m.
const REACHED_M: f64 = 0.5;
/// Action per radian of the angle to the path, and the angle at which the agent rotates in place,
/// rad.
const STEERING: f64 = 2.0;
const MAX_ANGLE_RAD: f64 = 0.3;
/// Places of the recorded path that are tried as goals.
const GOALS: usize = 12;
/// Beogym's published figure, images per second on a GPU that is not named.
const BEOGYM_FPS: f64 = 110.0;

pub(super) fn measure(scene: &OpenedScene, quick: bool) -> Result<Value> {
    let edges = scene.scene.sectors.iter().flat_map(|sector| &sector.edges);
    ensure!(
        edges.clone().all(|edge| !edge.is_imported),
        "expected a scene bundle, whose sectors have one world; found edges between recordings"
    );
    let (steps, rounds) = if quick {
        (QUICK_STEPS, 1)
    } else {
        (STEPS, ROUNDS)
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1);
    pool.build()?.install(|| {
        let of = |quality: Quality| -> Result<Value> {
            let rounds = (0..rounds).map(|_| episode(scene, quality, steps));
            let rounds: Vec<Episode> = rounds.collect::<Result<_>>()?;
            Ok(summary(&rounds))
        };
        Ok(json!({
            "threads": 1,
            "steps": steps,
            "rounds": rounds,
            "width": SIZE[0],
            "height": SIZE[1],
            "beogym_fps": BEOGYM_FPS,
            "detail": of(Quality::Detail)?,
            "exact": of(Quality::Exact)?,
        }))
    })
}

/// What an episode took.
struct Episode {
    reset: Timing,
    steps: Vec<Timing>,
    /// Whether each step is at a change of sector.
    is_change: Vec<bool>,
    changes: usize,
    blocked: usize,
    distance_m: f64,
}

fn episode(scene: &OpenedScene, quality: Quality, steps: usize) -> Result<Episode> {
    let agent = AgentConfig::default();
    let sector = &scene.scene.sectors[0];
    let levels = sector
        .levels
        .as_ref()
        .context("the scene has no output maps")?;
    let ground = Ground::new(levels.to_vec(), &agent)?;
    let mut config = CameraConfig::pinhole(SIZE, FRAC_PI_2)?;
    config.quality = quality;
    let eye = RigidTransform::from_translation_m([0.0, 0.0, agent.eye_height_m])?;
    config.body_from_camera = eye * RigidTransform::body_from_optical();
    let camera = CameraBatch::new(scene.store.clone(), config)?;
    let points = path(scene, &ground, agent.eye_height_m);
    let (there, begin) = longest(&ground, &agent, &points).context("no path on the ground")?;
    let back = DistanceField::new(&ground, &agent, begin);
    let mut frames = Frames::default();
    let render = |state: &AgentState, sector: usize, frames: &mut Frames| {
        let pose = state.world_from_body() * camera.config().body_from_camera;
        camera.render(&[FrameRequest::new(sector, pose)], frames)
    };
    let (start, reset) = timed(|| -> Result<(AgentState, usize)> {
        let yaw_rad = there
            .direction(begin)
            .map_or(0.0, |[x, y]| libm::atan2(y, x));
        let start = AgentState::on_ground(&ground, &agent, begin, yaw_rad);
        let start = start.context("no recorded pose is above the ground")?;
        let sector = owner(&scene.scene, 0, &start);
        render(&start, sector, &mut frames)?;
        Ok((start, sector))
    });
    let (mut state, mut sector) = start?;
    // Neighbors are loaded ahead in both places.
    scene.store.wait_for_prefetch();
    let mut found = Episode {
        reset,
        steps: Vec::new(),
        is_change: Vec::new(),
        changes: 0,
        blocked: 0,
        distance_m: 0.0,
    };
    let (mut is_back, mut since_change) = (false, CHANGE_STEPS);
    for _ in 0..steps {
        let before = sector;
        let (result, time) = timed(|| {
            let field = if is_back { &back } else { &there };
            let left_m = field.distance_m(state.position_m);
            is_back ^= left_m.is_some_and(|left_m| left_m < REACHED_M);
            let action = action(field, &state);
            let motion = advance(&ground, &agent, Drive::Differential, &state, &action, DT_S);
            state = motion.state;
            sector = owner(&scene.scene, sector, &state);
            found.blocked += usize::from(motion.blocked.is_some());
            found.distance_m += motion.distance_m;
            render(&state, sector, &mut frames)
        });
        result?;
        since_change = match sector == before {
            true => since_change + 1,
            false => 0,
        };
        found.changes += usize::from(sector != before);
        found.is_change.push(since_change < CHANGE_STEPS);
        found.steps.push(time);
    }
    Ok(found)
}

/// The sector that owns an agent which was in one before.
fn owner(scene: &SceneData, sector: usize, state: &AgentState) -> usize {
    let sector_from_body = state.world_from_body();
    scene
        .cross(&Place {
            sector,
            sector_from_body,
        })
        .sector
}

/// Medians and ranges over the rounds, and quantiles over the steps of all of them.
fn summary(rounds: &[Episode]) -> Value {
    let sum = |own: &Episode, of: fn(&Timing) -> f64| own.steps.iter().map(of).sum::<f64>();
    let rate = |own: &Episode, seconds: f64| own.steps.len() as f64 / seconds;
    let over = |of: &dyn Fn(&Episode) -> f64| {
        let mut values: Vec<f64> = rounds.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        json!({
            "median": median(values.iter().copied()),
            "range": [quantile(&values, 0.0), quantile(&values, 1.0)],
        })
    };
    let ms = |of: fn(&Timing) -> f64| {
        let times = |at_change: bool| {
            let steps = rounds
                .iter()
                .flat_map(|own| own.steps.iter().zip(&own.is_change));
            let own = steps.filter(|(_, is_change)| **is_change == at_change);
            let mut ms: Vec<f64> = own.map(|(time, _)| 1e3 * of(time)).collect();
            ms.sort_by(f64::total_cmp);
            ms
        };
        let [others, changes] = [false, true].map(times);
        let of_changes = |share: f64| (!changes.is_empty()).then(|| quantile(&changes, share));
        json!({
            "p50": quantile(&others, 0.5),
            "p95": quantile(&others, 0.95),
            "worst": quantile(&others, 1.0),
            "at_changes": { "steps": changes.len(), "p50": of_changes(0.5), "worst": of_changes(1.0) },
        })
    };
    let first = &rounds[0];
    json!({
        "sector_changes": first.changes,
        "fps": over(&|own| rate(own, sum(own, |time| time.wall_s))),
        "fps_by_processor_time": over(&|own| rate(own, sum(own, |time| time.cpu_s))),
        "fps_with_reset": over(&|own| rate(own, sum(own, |time| time.wall_s) + own.reset.wall_s)),
        "reset_ms": over(&|own| 1e3 * own.reset.wall_s),
        "cpu_ms": ms(|time| time.cpu_s),
        "wall_ms": ms(|time| time.wall_s),
        "distance_m": first.distance_m,
        "blocked_steps": first.blocked,
    })
}

/// Points on the ground below the recorded poses, in the order of their times, m.
fn path(scene: &OpenedScene, ground: &Ground, eye_height_m: f64) -> Vec<[f64; 3]> {
    let mut views: Vec<_> = scene.scene.sectors[0].recording.views.iter().collect();
    views.sort_by_key(|view| view.time_ns);
    let points = views.iter().filter_map(|view| {
        let [x, y, z] = view.world_from_camera.translation_m();
        let surface = ground.surface([x, y], z - eye_height_m)?;
        Some([x, y, surface.height_m])
    });
    points.collect()
}

/// The field of a goal and the point from which its shortest path is longest, of some goals on the
/// recorded path.
fn longest(
    ground: &Ground,
    agent: &AgentConfig,
    points: &[[f64; 3]],
) -> Option<(DistanceField, [f64; 3])> {
    let mut best: Option<(f64, DistanceField, [f64; 3])> = None;
    for goal in points.iter().step_by((points.len() / GOALS).max(1)) {
        let field = DistanceField::new(ground, agent, *goal);
        let reached = points
            .iter()
            .filter_map(|point| Some((field.distance_m(*point)?, *point)));
        let farthest = reached.max_by(|a, b| a.0.total_cmp(&b.0));
        if let Some((distance_m, from)) = farthest
            && best.as_ref().is_none_or(|best| distance_m > best.0)
        {
            best = Some((distance_m, field, from));
        }
    }
    best.map(|(_, field, from)| (field, from))
}

/// Forward along the shortest path; in place where it leads elsewhere.
fn action(field: &DistanceField, state: &AgentState) -> [f64; 2] {
    let Some([x, y]) = field.direction(state.position_m) else {
        return [0.0, 1.0];
    };
    let error = libm::atan2(y, x) - state.yaw_rad;
    let error = libm::atan2(libm::sin(error), libm::cos(error));
    let forward = if error.abs() < MAX_ANGLE_RAD {
        1.0
    } else {
        0.0
    };
    [forward, (STEERING * error).clamp(-1.0, 1.0)]
}
