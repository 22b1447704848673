//! Beogym's measurement: an agent that walks, and its camera, on one thread.
//!
//! A step is the motion of the agent over the ground, which looks up the map, and an image of
//! 1280x720 with depth. The agent walks between two places on the recorded path, there and back,
//! along the shortest path.

use std::f64::consts::FRAC_PI_2;

use anyhow::{Context, Result};
use cad_transforms::RigidTransform;
use serde_json::{Value, json};
use simulation::{
    AgentConfig, AgentState, CameraBatch, CameraConfig, DistanceField, Drive, FrameRequest, Frames,
    Ground, Quality, advance,
};

use super::opened_scene::OpenedScene;
use crate::meter::{quantile, timed};

const SIZE: [u32; 2] = [1280, 720];
const STEPS: usize = 200;
const QUICK_STEPS: usize = 20;
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
    let steps = if quick { QUICK_STEPS } else { STEPS };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1);
    pool.build()?.install(|| {
        let runs = [Quality::Detail, Quality::Exact].map(|quality| episode(scene, quality, steps));
        let [detail, exact] = runs;
        Ok(json!({
            "threads": 1,
            "steps": steps,
            "width": SIZE[0],
            "height": SIZE[1],
            // Of the first sector alone; the part `changes` has changes.
            "sector_changes": 0,
            "beogym_fps": BEOGYM_FPS,
            "detail": detail?,
            "exact": exact?,
        }))
    })
}

fn episode(scene: &OpenedScene, quality: Quality, steps: usize) -> Result<Value> {
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
    let render = |state: &AgentState, frames: &mut Frames| {
        let pose = state.world_from_body() * camera.config().body_from_camera;
        camera.render(&[FrameRequest::new(0, pose)], frames)
    };
    let (start, reset) = timed(|| -> Result<AgentState> {
        let yaw_rad = there
            .direction(begin)
            .map_or(0.0, |[x, y]| libm::atan2(y, x));
        let start = AgentState::on_ground(&ground, &agent, begin, yaw_rad);
        let start = start.context("no recorded pose is above the ground")?;
        render(&start, &mut frames)?;
        Ok(start)
    });
    let mut state = start?;
    let (mut is_back, mut blocked, mut distance_m) = (false, 0, 0.0);
    let (mut walls_s, mut cpus_s) = (Vec::new(), Vec::new());
    for _ in 0..steps {
        let (result, time) = timed(|| {
            let field = if is_back { &back } else { &there };
            let left_m = field.distance_m(state.position_m);
            is_back ^= left_m.is_some_and(|left_m| left_m < REACHED_M);
            let action = action(field, &state);
            let motion = advance(&ground, &agent, Drive::Differential, &state, &action, DT_S);
            state = motion.state;
            blocked += usize::from(motion.blocked.is_some());
            distance_m += motion.distance_m;
            render(&state, &mut frames)
        });
        result?;
        walls_s.push(time.wall_s);
        cpus_s.push(time.cpu_s);
    }
    let (wall_s, cpu_s): (f64, f64) = (walls_s.iter().sum(), cpus_s.iter().sum());
    cpus_s.sort_by(f64::total_cmp);
    walls_s.sort_by(f64::total_cmp);
    let ms = |sorted: &[f64], share: f64| 1e3 * quantile(sorted, share);
    Ok(json!({
        "fps": steps as f64 / wall_s,
        "fps_by_processor_time": steps as f64 / cpu_s,
        "fps_with_reset": steps as f64 / (wall_s + reset.wall_s),
        "reset_ms": 1e3 * reset.wall_s,
        "cpu_ms": { "p50": ms(&cpus_s, 0.5), "p95": ms(&cpus_s, 0.95), "worst": ms(&cpus_s, 1.0) },
        "wall_ms": {
            "p50": ms(&walls_s, 0.5),
            "p95": ms(&walls_s, 0.95),
            "worst": ms(&walls_s, 1.0),
        },
        "distance_m": distance_m,
        "blocked_steps": blocked,
    }))
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
