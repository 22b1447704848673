//! The seam of two reconstructions of one place.
//!
//! A walk is recorded as two sessions that overlap. Odometry runs on each by itself, in a frame of
//! its own; Gaussians are trained at its poses, with depth of stereo. The trajectory of the second
//! session is aligned to that of the first, which gives the edge between both. Compared are poses
//! carried over the edge, there and back, and images and depths of both sides at one pose.

use std::ops::RangeInclusive;
use std::path::Path;
use std::sync::Arc;

use ::odometry::{Config, Preset};
use anyhow::{Context, Result, ensure};
use cad_transforms::RigidTransform;
use camera_models::CameraModel;
use harness::sequences::{self, Sequence, WalkSettings};
use harness::tracking::{self, Tracking};
use rig_sim::scene::{Kind, Lighting};
use scene_bundle::Trajectory;
use serde_json::{Value, json};
use simulation::{
    AlignmentConfig, AlignmentModel, Area, CameraBatch, CameraConfig, FrameRequest, Frames,
    GaussianSource, GaussianStore, Place, Quality, Recording, ResidencyConfig, SceneData, Sector,
    SectorEdge, Similarity, align_trajectories,
};
use splats::{Camera, Exposure, Image, RenderConfig, Renderer};

use super::depth::{QUICK_STEPS, STEPS};
use crate::meter::{self, quantile};
use crate::render_speed::measure::psnr_db;
use crate::splats::fit;
use crate::splats::views::{Part, ViewOptions, WalkViews};
use crate::terrain::walks::{SMALL, Walk};

/// The walk, on a path that turns: a straight one leaves a rotation about it open.
pub(super) const WALK: Walk = Walk {
    kind: Kind::Plaza,
    light: Lighting::Day,
    seed: 985,
    span_s: [0.0, 20.0],
    size: SMALL,
};
/// Both sessions, as shares of the walk; the path turns where they overlap.
const SESSIONS: [[f64; 2]; 2] = [[0.0, 0.4], [0.2, 0.6]];
/// Goals of pose, of the 95th percentile of depths, and of PSNR.
const GOAL_M: f64 = 0.01;
const GOAL_DEG: f64 = 0.2;
const GOAL_DEPTH_M: f64 = 0.02;
const GOAL_DB: f64 = 30.0;
/// Cameras this near to the crossing are compared, m.
const NEAR_M: f64 = 1.0;
/// Depths below which differences are stated apart, m.
const NEAR_DEPTH_M: f64 = 3.0;
/// Weights with which images of both sides are blended.
const BLENDED: RangeInclusive<f64> = 0.05..=0.95;
/// What belongs to a session beside its path, m.
const BESIDE_M: f64 = 5.0;

/// A session that was reconstructed by itself.
struct Session {
    trajectory: Trajectory,
    gaussians: splats::Scene,
    references: Vec<RigidTransform>,
    model: CameraModel,
}

/// # Errors
/// A walk that cannot be rendered, tracked, trained from or aligned.
pub(super) fn measure(walk: Walk, quick: bool) -> Result<Value> {
    let [_, end_s] = walk.span_s;
    let settings = WalkSettings::new(walk.kind, walk.light, walk.seed, end_s);
    let sequence = sequences::walk(&settings)?.cached(&images()?)?;
    let steps = if quick { QUICK_STEPS } else { STEPS };
    let config = fit::config("fast", Some(steps))?;
    let mut sessions = Vec::new();
    for share in SESSIONS {
        let trajectory = tracked(&sequence, share.map(|share| share * end_s))?;
        let poses = trajectory.usable();
        let poses = poses.map(|pose| (pose.time_ns, pose.world_from_rig));
        let views = WalkViews::load(walk.prepare()?, "truth")?.with_poses(poses.collect());
        let training = views.recorded(Part::Training, &ViewOptions::STAGE)?;
        let validation = views.recorded(Part::Validation, &ViewOptions::STAGE)?;
        let first = training.first().context("a session without views")?;
        let model = *first.camera.model();
        let fit = fit::fit(training, &validation, &config, (&[], 1))?;
        let references = views.poses(Part::Training)?;
        sessions.push(Session {
            trajectory,
            gaussians: fit.scene,
            references: references.into_iter().map(|(.., pose)| pose).collect(),
            model,
        });
        println!("  session of {share:?} of the walk reconstructed");
    }
    let sessions: [Session; 2] = sessions
        .try_into()
        .map_err(|_| anyhow::anyhow!("expected two sessions"))?;
    let mut row = compared(&sequence, &sessions, config.render)?;
    row["steps"] = json!(steps);
    row["walk_seconds"] = json!(end_s);
    row["sessions"] = json!(SESSIONS);
    Ok(row)
}

/// Refined poses of the sets within a span, s, in the frame in which odometry began.
fn tracked(sequence: &Sequence, span_s: [f64; 2]) -> Result<Trajectory> {
    let [from_ns, to_ns] = span_s.map(|s| (s * 1e9) as i64);
    let mut tracking = Tracking::new(sequence.rig(), Config::preset(Preset::Balanced), true);
    sequence.for_each(|set| {
        if (from_ns..=to_ns).contains(&set.time_ns) {
            tracking.add(&set)?;
        }
        Ok(())
    })?;
    let refined = tracking.refine()?.context("tracking without mapping")?;
    Ok(refined.trajectory)
}

/// The folder of images that `odometry` has too.
fn images() -> Result<std::path::PathBuf> {
    let programs = meter::on_disk(None)?;
    let target = programs.parent().unwrap_or(Path::new("."));
    Ok(target.join("walks"))
}

fn compared(sequence: &Sequence, sessions: &[Session; 2], render: RenderConfig) -> Result<Value> {
    let [first, second] = sessions;
    let model = AlignmentModel::Similarity;
    let config = AlignmentConfig::default();
    let alignment = align_trajectories(&second.trajectory, &first.trajectory, model, &config)?;
    let first_from_second = alignment.reference_from_estimate;
    let scene = joined(
        sessions,
        &first_from_second,
        alignment.residual_m,
        render.compensate,
    )?;
    let crossing = Crossing::find(&scene, &first.trajectory)?;
    // Against where the other session has the same instant.
    let errors = second.trajectory.usable().filter_map(|own| {
        let other = first.trajectory.at(own.time_ns)?;
        let carried = first_from_second.carry(&own.world_from_rig);
        Some(difference(&carried, &other.world_from_rig))
    });
    let (lengths_m, angles_deg): (Vec<f64>, Vec<f64>) = errors.unzip();
    let there = second
        .trajectory
        .at(crossing.time_ns)
        .context("the border is where only one session was")?;
    let at_crossing = difference(&crossing.second_from_rig, &there.world_from_rig);
    let to_truth = edge_to_truth(
        sequence,
        sessions,
        &first_from_second,
        &there.world_from_rig,
    )?;
    Ok(json!({
        "poses": lengths_m.len(),
        "inliers": alignment.inlier_count(),
        "residual_m": alignment.residual_m,
        "scale": first_from_second.scale(),
        "clock_offset_ns": alignment.clock_offset_ns,
        "gaussians": sessions.each_ref().map(|own| own.gaussians.splats.len()),
        "overlap": { "m": shares(lengths_m), "deg": shares(angles_deg) },
        "at_crossing": { "m": at_crossing.0, "deg": at_crossing.1 },
        "edge_to_truth": { "m": to_truth.0, "deg": to_truth.1 },
        "there_and_back_m": crossing.there_and_back_m,
        "images": both_sides(&scene, sessions, &crossing, render)?,
        "goal": {
            "pose_m": GOAL_M,
            "pose_deg": GOAL_DEG,
            "depth_p95_m": GOAL_DEPTH_M,
            "psnr_db": GOAL_DB,
        },
    }))
}

/// Distance, m, and angle, degrees.
fn difference(a: &RigidTransform, b: &RigidTransform) -> (f64, f64) {
    let off = a.inverse() * *b;
    (off.distance_m(), off.angle_rad().to_degrees())
}

/// How far a pose in the second session is carried from where it truly is in the first: both
/// sessions as they lie in the truth as a whole, without a scale.
fn edge_to_truth(
    sequence: &Sequence,
    sessions: &[Session; 2],
    first_from_second: &Similarity,
    second_from_rig: &RigidTransform,
) -> Result<(f64, f64)> {
    let truth = tracking::truth(sequence)?;
    let aligned = |own: &Session| {
        let (model, config) = (AlignmentModel::Rigid, AlignmentConfig::default());
        let alignment = align_trajectories(&own.trajectory, &truth, model, &config)?;
        Ok::<_, anyhow::Error>(alignment.reference_from_estimate)
    };
    let [first, second] = [aligned(&sessions[0])?, aligned(&sessions[1])?];
    let true_edge = first.inverse().compose(&second);
    let [found, expected] = [first_from_second, &true_edge].map(|edge| edge.carry(second_from_rig));
    Ok(difference(&found, &expected))
}

/// A scene of both sessions with an imported edge.
fn joined(
    sessions: &[Session; 2],
    first_from_second: &Similarity,
    residual_m: f64,
    is_compensated: bool,
) -> Result<Arc<SceneData>> {
    let second_from_first = first_from_second.inverse();
    let [first, second] = sessions;
    let areas = sessions.each_ref().map(|own| area(&own.trajectory));
    let sector = |own: &Session, number: usize, to_from_here: Similarity| -> Result<Sector> {
        Ok(Sector {
            name: ["first", "second"][number].to_owned(),
            levels: None,
            area: areas[number],
            references: Arc::new(own.references.clone()),
            gaussians: Some(GaussianSource::new(own.gaussians.clone(), is_compensated)?),
            recording: Arc::new(Recording::default()),
            edges: vec![SectorEdge {
                to: 1 - number,
                to_from_here,
                overlap: areas[number],
                residual_m: Some(residual_m),
                is_imported: true,
            }],
        })
    };
    let sectors = vec![
        sector(first, 0, second_from_first)?,
        sector(second, 1, *first_from_second)?,
    ];
    Ok(Arc::new(SceneData::new("two sessions", sectors)?))
}

/// The box around a path, with what is beside it.
fn area(trajectory: &Trajectory) -> Area {
    let (mut min_m, mut max_m) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for pose in trajectory.usable() {
        let at = pose.world_from_rig.translation_m();
        for k in 0..2 {
            min_m[k] = min_m[k].min(at[k] - BESIDE_M);
            max_m[k] = max_m[k].max(at[k] + BESIDE_M);
        }
    }
    Area::new(min_m, max_m)
}

/// Where the path of the first session leads over the edge.
struct Crossing {
    time_ns: i64,
    /// The pose before, and that after it.
    first_from_rig: RigidTransform,
    second_from_rig: RigidTransform,
    /// Distance from a pose of the path to where the path in reverse leads over the edge again, m.
    there_and_back_m: f64,
}

impl Crossing {
    fn find(scene: &SceneData, path: &Trajectory) -> Result<Self> {
        let poses: Vec<_> = path.usable().collect();
        let at = |sector: usize, pose: &RigidTransform| {
            scene.cross(&Place {
                sector,
                sector_from_body: *pose,
            })
        };
        let found = poses.iter().enumerate().find_map(|(number, pose)| {
            let place = at(0, &pose.world_from_rig);
            (place.sector == 1).then_some((number, place.sector_from_body))
        });
        let (number, second_from_rig) = found.context("the path never leaves its sector")?;
        let there = scene.sectors[0].edges[0].to_from_here;
        let back = poses[..number].iter().rev().find_map(|pose| {
            let place = at(1, &there.carry(&pose.world_from_rig));
            (place.sector == 0).then(|| difference(&place.sector_from_body, &pose.world_from_rig).0)
        });
        Ok(Self {
            time_ns: poses[number].time_ns,
            first_from_rig: poses[number].world_from_rig,
            second_from_rig,
            there_and_back_m: back.context("the path in reverse never leaves the other sector")?,
        })
    }
}

/// Images and depths of both sides at the poses of recorded cameras near the crossing.
fn both_sides(
    scene: &Arc<SceneData>,
    sessions: &[Session; 2],
    crossing: &Crossing,
    render: RenderConfig,
) -> Result<Value> {
    let renderer = Renderer::new(render)?;
    let there = scene.sectors[0].edges[0].to_from_here;
    let back = there.inverse();
    // Poses in the first session.
    let [first, second] = sessions.each_ref().map(|own| &own.references);
    let all = first
        .iter()
        .copied()
        .chain(second.iter().map(|pose| back.carry(pose)));
    let is_near = |pose: &RigidTransform| difference(pose, &crossing.first_from_rig).0 <= NEAR_M;
    let near: Vec<RigidTransform> = all.filter(is_near).collect();
    ensure!(!near.is_empty(), "no camera near the crossing");
    let (mut all_db, mut depths_m, mut near_depths_m) = (Vec::new(), Vec::new(), Vec::new());
    for pose in &near {
        let poses = [*pose, there.carry(pose)];
        let image = |side: usize| -> Result<Image> {
            let camera = Camera::new(sessions[side].model, poses[side].inverse())?;
            Ok(renderer.render(&sessions[side].gaussians, &camera, &Exposure::NONE))
        };
        let [here, other] = [image(0)?, image(1)?];
        all_db.push(psnr_db(&other, &here));
        for (a, b) in here.median_depth_m.iter().zip(&other.median_depth_m) {
            let [a, b] = [f64::from(*a), f64::from(*b) / there.scale()];
            if a.is_finite() && b.is_finite() {
                depths_m.push((a - b).abs());
                if a < NEAR_DEPTH_M {
                    near_depths_m.push((a - b).abs());
                }
            }
        }
    }
    all_db.sort_by(f64::total_cmp);
    Ok(json!({
        "views": near.len(),
        "psnr_median_db": quantile(&all_db, 0.5),
        "psnr_worst_db": quantile(&all_db, 0.0),
        "depth_m": shares(depths_m),
        "depth_below_3_m": shares(near_depths_m),
        "cross_faded": cross_faded(scene, sessions[0].model, &near)?,
    }))
}

/// Cross-faded images with levels of detail, whose side of the smaller weight has half the size,
/// against those of two exact images; and images of the first session alone, the same way.
fn cross_faded(
    scene: &Arc<SceneData>,
    model: CameraModel,
    near: &[RigidTransform],
) -> Result<Value> {
    let mut first = scene.sectors[0].clone();
    first.edges.clear();
    let alone = SceneData::new("one session", vec![first])?;
    let compare = |scene: Arc<SceneData>, poses: &[RigidTransform]| -> Result<Value> {
        let requests: Vec<FrameRequest> = poses
            .iter()
            .map(|pose| FrameRequest::new(0, *pose))
            .collect();
        let store = Arc::new(GaussianStore::new(scene, ResidencyConfig::default()));
        let mut rendered = Vec::new();
        for quality in [Quality::Exact, Quality::Detail] {
            let mut config = CameraConfig::new(model)?;
            config.quality = quality;
            let mut frames = Frames::default();
            CameraBatch::new(store.clone(), config)?.render(&requests, &mut frames)?;
            rendered.push(frames);
        }
        let [exact, fast] = [&rendered[0], &rendered[1]];
        let pixels = exact.width * exact.height;
        let images = exact
            .rgb
            .chunks(3 * pixels)
            .zip(fast.rgb.chunks(3 * pixels));
        let mut all_db: Vec<f64> = images.map(|(a, b)| bytes_psnr_db(a, b)).collect();
        all_db.sort_by(f64::total_cmp);
        let depths = exact.depth_m.iter().zip(&fast.depth_m);
        let are_known = exact.has_depth.iter().zip(&fast.has_depth);
        let found = depths.zip(are_known).filter(|(_, (a, b))| **a && **b);
        let depths_m = found.map(|((a, b), _)| f64::from((a - b).abs())).collect();
        Ok(json!({
            "views": poses.len(),
            "psnr_median_db": quantile(&all_db, 0.5),
            "psnr_worst_db": quantile(&all_db, 0.0),
            "depth_m": shares(depths_m),
        }))
    };
    // Beyond the band one side alone counts.
    let is_faded = |pose: &&RigidTransform| {
        let fade = scene.fade(0, pose.translation_m());
        fade.is_some_and(|(_, weight)| BLENDED.contains(&weight))
    };
    let faded: Vec<RigidTransform> = near.iter().filter(is_faded).copied().collect();
    if faded.is_empty() {
        return Ok(Value::Null);
    }
    Ok(json!({
        "two": compare(scene.clone(), &faded)?,
        "one": compare(Arc::new(alone), &faded)?,
    }))
}

/// PSNR of colors of 8 bits.
fn bytes_psnr_db(a: &[u8], b: &[u8]) -> f64 {
    let squares = a
        .iter()
        .zip(b)
        .map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
    let mean = squares.sum::<f64>() / a.len() as f64;
    10.0 * libm::log10(255.0_f64.powi(2) / mean.max(1e-9))
}

/// Median, 95th percentile and greatest value.
fn shares(mut values: Vec<f64>) -> Value {
    values.sort_by(f64::total_cmp);
    let [p50, p95, worst] = [0.5, 0.95, 1.0].map(|share| quantile(&values, share));
    json!({ "p50": p50, "p95": p95, "worst": worst })
}
