//! Depth images of the simulator's cameras.

use std::sync::Arc;

use anyhow::{Context, Result};
use cad_transforms::RigidTransform;
use serde_json::{Value, json};
use simulation::{
    Area, CameraBatch, CameraConfig, FrameRequest, Frames, GaussianSource, GaussianStore, Quality,
    Recording, ResidencyConfig, SceneData, Sector,
};
use splats::{Scene, TrainingView};

use crate::splats::views::{Part, TestView, ViewOptions, WalkViews};
use crate::splats::{fit, off_path};
use crate::terrain::walks::Walk;

/// Steps of the training, those of the demo.
pub(super) const STEPS: usize = 700;
pub(super) const QUICK_STEPS: usize = 100;
/// Every which view of the validation is compared, and how many of each offset and angle.
const ON_PATH_INTERVAL: usize = 2;
const OFF_PATH_VIEWS: usize = 2;
const SEED: u64 = 29;
/// Borders of the ranges of true depth, m.
const RANGES_M: [f64; 9] = [0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0];
/// The goal is the larger of a length, m, and what a disparity, px, is at the distance.
const GOAL_M: f64 = 0.01;
const GOAL_PX: f64 = 0.1;

/// # Errors
/// A walk that cannot be rendered or trained from.
pub(super) fn measure(walk: Walk, quick: bool) -> Result<Value> {
    let options = ViewOptions::STAGE;
    let views = WalkViews::load(walk.prepare()?, "truth")?;
    let mut tests: Vec<(f64, TestView)> = Vec::new();
    let on_path = views.poses(Part::Validation)?;
    for (camera, frame, pose) in on_path.iter().step_by(ON_PATH_INTERVAL) {
        tests.push((0.0, views.truth_at(*camera, *frame, pose, &options)?));
    }
    let off_path = off_path::off_path(&views, OFF_PATH_VIEWS, SEED, &options)?;
    tests.extend(off_path.into_iter().map(|own| (own.offset_m, own.test)));
    let steps = if quick { QUICK_STEPS } else { STEPS };
    let config = fit::config("fast", Some(steps))?;
    let training = views.recorded(Part::Training, &options)?;
    let validation = views.recorded(Part::Validation, &options)?;
    let measured = measured(&views, &training, &options)?;
    let fit = fit::fit(training, &validation, &config, (&[], 1))?;
    let references = views.poses(Part::Training)?;
    let references = references.into_iter().map(|(.., pose)| pose).collect();
    let count = fit.scene.splats.len();
    let store = store(fit.scene, config.render.compensate, references)?;
    let (fx, baseline_m) = stereo(&views, &tests)?;
    let bounds = RANGES_M.windows(2).zip(measured);
    let measured = bounds.map(|(bound, errors)| range(bound, errors, fx * baseline_m));
    let measured: Vec<Value> = measured.collect();
    let mut rows = Vec::new();
    for (name, quality) in [("exact", Quality::Exact), ("detail", Quality::Detail)] {
        let mut groups: Vec<(f64, Vec<Vec<f64>>, [usize; 2])> = Vec::new();
        for (offset_m, test) in &tests {
            let empty = || (*offset_m, vec![Vec::new(); RANGES_M.len() - 1], [0, 0]);
            let place = match groups.iter().position(|(own, ..)| own == offset_m) {
                Some(place) => place,
                None => {
                    groups.push(empty());
                    groups.len() - 1
                }
            };
            let (_, ranges, seen) = &mut groups[place];
            add_errors(&store, quality, test, ranges, seen)?;
        }
        for (offset_m, ranges, [known, lacking]) in groups {
            let bounds = RANGES_M.windows(2).zip(ranges);
            let found = bounds.map(|(bound, errors)| range(bound, errors, fx * baseline_m));
            rows.push(json!({
                "quality": name,
                "offset_m": offset_m,
                "ranges": found.collect::<Vec<_>>(),
                "no_depth_share": lacking as f64 / (known + lacking).max(1) as f64,
            }));
        }
    }
    Ok(json!({
        "steps": steps,
        "splats": count,
        "views": tests.len(),
        "fx_px": fx,
        "baseline_m": baseline_m,
        "measured": measured,
        "rows": rows,
    }))
}

/// Errors of a depth image by the range of the true depth; counts of pixels with depth and without.
fn add_errors(
    store: &Arc<GaussianStore>,
    quality: Quality,
    test: &TestView,
    ranges: &mut [Vec<f64>],
    [known, lacking]: &mut [usize; 2],
) -> Result<()> {
    let camera = &test.view.camera;
    let mut config = CameraConfig::new(*camera.model())?;
    config.quality = quality;
    let batch = CameraBatch::new(store.clone(), config)?;
    let mut frames = Frames::default();
    let pose = camera.camera_from_world().inverse();
    batch.render(&[FrameRequest::new(0, pose)], &mut frames)?;
    for (pixel, true_m) in test.view.depth_m.iter().map(|z| f64::from(*z)).enumerate() {
        let Some(bin) = range_of(true_m) else {
            continue;
        };
        if !frames.has_depth[pixel] {
            *lacking += 1;
            continue;
        }
        *known += 1;
        ranges[bin].push((f64::from(frames.depth_m[pixel]) - true_m).abs());
    }
    Ok(())
}

/// Errors of the depth from which the scene is trained, by the range of the true depth, m.
fn measured(
    views: &WalkViews,
    training: &[TrainingView],
    options: &ViewOptions,
) -> Result<Vec<Vec<f64>>> {
    let mut ranges = vec![Vec::new(); RANGES_M.len() - 1];
    // Left images, each followed by its right one.
    let truth = views.truth(Part::Training, options)?;
    for (own, truth) in training.iter().step_by(2).zip(&truth) {
        for (found_m, true_m) in own.depth_m.iter().zip(&truth.view.depth_m) {
            let (found_m, true_m) = (f64::from(*found_m), f64::from(*true_m));
            if let Some(bin) = range_of(true_m)
                && found_m > 0.0
                && found_m.is_finite()
            {
                ranges[bin].push((found_m - true_m).abs());
            }
        }
    }
    Ok(ranges)
}

/// Number of the range of a depth.
fn range_of(depth_m: f64) -> Option<usize> {
    let mut ranges = RANGES_M.windows(2);
    ranges.position(|own| own[0] <= depth_m && depth_m < own[1])
}

/// Quantiles of the errors of a range, with its goal: that of its middle.
fn range(bounds: &[f64], mut errors_m: Vec<f64>, focal_baseline: f64) -> Value {
    errors_m.sort_by(f64::total_cmp);
    let middle_m = 0.5 * (bounds[0] + bounds[1]);
    let quantile = |share: f64| match errors_m.is_empty() {
        true => Value::Null,
        false => (1e3 * crate::meter::quantile(&errors_m, share)).into(),
    };
    json!({
        "from_m": bounds[0],
        "to_m": bounds[1],
        "pixels": errors_m.len(),
        "median_mm": quantile(0.5),
        "p95_mm": quantile(0.95),
        "goal_mm": 1e3 * (GOAL_PX * middle_m * middle_m / focal_baseline).max(GOAL_M),
    })
}

/// The scene in memory, as one sector.
fn store(
    scene: Scene,
    compensate: bool,
    references: Vec<RigidTransform>,
) -> Result<Arc<GaussianStore>> {
    let places = references.iter().map(RigidTransform::translation_m);
    let bound = |k: usize, sign: f64| {
        let values = places.clone().map(|at| sign * at[k]);
        sign * (values.fold(f64::NEG_INFINITY, f64::max) + 5.0)
    };
    let sector = Sector {
        name: "walk".to_owned(),
        levels: None,
        area: Area::new(
            [bound(0, -1.0), bound(1, -1.0)],
            [bound(0, 1.0), bound(1, 1.0)],
        ),
        references: Arc::new(references),
        gaussians: Some(GaussianSource::new(scene, compensate)?),
        recording: Arc::new(Recording::default()),
        edges: Vec::new(),
    };
    let scene = Arc::new(SceneData::new("walk", vec![sector])?);
    Ok(Arc::new(GaussianStore::new(
        scene,
        ResidencyConfig::default(),
    )))
}

/// Focal length of the images, px, and the baseline of the stereo cameras, m.
fn stereo(views: &WalkViews, tests: &[(f64, TestView)]) -> Result<(f64, f64)> {
    let (_, first) = tests.first().context("a walk without test views")?;
    let rig = views.prepared.simulation.walker().rig(0.0);
    let camera = &views.prepared.simulation.cameras()[first.camera];
    let [left, right] = [0, 1].map(|eye| camera.world_from_eye(eye, &rig, None).0);
    Ok((first.view.camera.model().fx, (right - left).norm()))
}
