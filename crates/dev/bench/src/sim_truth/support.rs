//! The predicted PSNR of what agents see, against the truth.
//!
//! Agents stand where episodes start: anywhere on the ground within 3 m of the recorded path, with
//! any heading. No such view is one of the training, and the constants of the prediction come from
//! other walks.
//!
//! The PSNR is that at the brightness of the scene, see [`brightness`]; that without the factor is
//! stated beside.

use std::sync::Arc;

use anyhow::{Context, Result};
use rayon::prelude::*;
use reconstruction::pipeline::stages::map_levels;
use serde_json::{Value, json};
use simulation::{
    Area, GaussianSource, ObservedScene, Recording, SceneData, Sector, SupportConfig, Task, World,
    WorldConfig, pinhole,
};
use splats::{Camera, Coverage, Image, Renderer, Scene, TrainingView, psnr_db};
use terrain::FusionConfig;

use super::depth::{QUICK_STEPS, STEPS};
use crate::meter;
use crate::splats::views::{Part, ViewOptions, WalkViews};
use crate::splats::{brightness, fit};
use crate::terrain::keyframes::{Source, depth_frames, keyframes};
use crate::terrain::surface::surface;
use crate::terrain::walks::Walk;

/// Mean absolute error that a prediction may have, dB.
const GOAL_DB: f64 = 1.5;
/// Below this PSNR views count as bad, as in the benchmark `confidence`, dB.
const BAD_DB: f64 = 18.0;
/// Agents, and the size of the images that are compared with the truth and of those that are
/// judged, px.
const AGENTS: usize = 200;
const QUICK_AGENTS: usize = 20;
const SIZE: [u32; 2] = [192, 144];
const JUDGED_SIZE: [u32; 2] = [48, 36];
const SEED: u64 = 67;
/// Grids that are compared: distance of the places, m, and headings. The first is the default.
const GRIDS: [(f64, usize); 3] = [(0.5, 8), (0.5, 16), (1.0, 8)];

/// A view of an agent: what images, and grids, say of its PSNR, dB.
struct Sample {
    psnr_db: f64,
    psnr_without_gain_db: f64,
    judged_db: f64,
    grids_db: Vec<f64>,
    distance_m: f64,
    angle_rad: f64,
}

/// # Errors
/// A walk that cannot be rendered or trained from.
pub(super) fn measure(walk: Walk, quick: bool) -> Result<Value> {
    let options = ViewOptions::STAGE;
    let views = WalkViews::load(walk.prepare()?, "truth")?;
    let steps = if quick { QUICK_STEPS } else { STEPS };
    let config = fit::config("fast", Some(steps))?;
    let training = views.recorded(Part::Training, &options)?;
    let validation = views.recorded(Part::Validation, &options)?;
    let fit = fit::fit(training.clone(), &validation, &config, (&[], 1))?;
    let renderer = Renderer::new(config.render)?;
    let coverage = Coverage::gather(&renderer, &fit.scene, &training, &config.coverage)?;
    let observed = ObservedScene::new(coverage);

    let rendered = keyframes(&views.prepared, &views.prepared.keyframes()?)?;
    let frames = depth_frames(&rendered, Source::Stereo)?;
    let levels = map_levels(surface(&frames, FusionConfig::default())?.levels);
    let (corner, size) = levels
        .first()
        .map(|level| (level.grid.corner_m(), level.grid.size_m()))
        .context("a walk without ground")?;
    let references = views.poses(Part::Training)?;
    let gaussians = GaussianSource::new(fit.scene.clone(), config.render.compensate)?;
    let sector = Sector {
        name: "walk".to_owned(),
        levels: Some(Arc::new(levels)),
        area: Area::new(corner, [0, 1].map(|k| corner[k] + size[k])),
        references: Arc::new(references.into_iter().map(|(.., pose)| pose).collect()),
        gaussians: Some(gaussians.with_observed(observed.clone())),
        recording: Arc::new(Recording::default()),
        edges: Vec::new(),
    };
    let scene = Arc::new(SceneData::new("walk", vec![sector])?);
    let grids = if quick { &GRIDS[..1] } else { &GRIDS[..] };
    let worlds = grids.iter().map(|grid| world(&scene, *grid, quick));
    let worlds: Vec<World> = worlds.collect::<Result<_>>()?;
    let agents: Vec<usize> = (0..worlds[0].environments()).collect();
    let field_of_view_rad = SupportConfig::default().field_of_view_rad;
    let pairs = images(&views, &renderer, &fit.scene, &worlds[0])?;
    let factors = pairs
        .iter()
        .map(|(found, truth)| brightness::factor(found, truth));
    let gain = meter::median(factors);
    let samples: Result<Vec<Sample>> = (agents.par_iter().zip(pairs))
        .map(|(agent, (found, truth))| {
            let (_, pose) = worlds[0].world_from_camera(*agent);
            let psnr_without_gain_db = psnr_db(&found, &truth);
            let found = brightness::scaled(found, gain);
            let judged = pinhole(JUDGED_SIZE, field_of_view_rad)?;
            let camera = Camera::new(judged, pose.inverse())?;
            let confidence = observed.confidence(&renderer, &fit.scene, &camera)?;
            let result = worlds[0].result();
            Ok(Sample {
                psnr_db: brightness::psnr_at_scene_db(&found, &truth, gain),
                psnr_without_gain_db,
                judged_db: f64::from(confidence.psnr_db),
                grids_db: (worlds.iter())
                    .map(|world| f64::from(world.result().support_db[*agent]))
                    .collect(),
                distance_m: f64::from(result.deviation_m[*agent]),
                angle_rad: f64::from(result.deviation_rad[*agent]),
            })
        })
        .collect();
    let samples = samples?;
    let grids = grids.iter().enumerate().map(|(k, (cell_m, headings))| {
        let mut row = scores(&samples, |own| own.grids_db[k]);
        row["cell_m"] = (*cell_m).into();
        row["headings"] = (*headings).into();
        row["places"] = worlds[k].support()[0].nodes().count().into();
        row["from_judged_db"] =
            mean(&samples, |own| (own.grids_db[k] - own.judged_db).abs()).into();
        row
    });
    let mean_db = mean(&samples, |own| own.psnr_db);
    let rows = samples.iter().map(|own| {
        json!({
            "psnr_db": own.psnr_db,
            "psnr_without_gain_db": own.psnr_without_gain_db,
            "judged_db": own.judged_db,
            "grid_db": own.grids_db[0],
            "distance_m": own.distance_m,
            "angle_rad": own.angle_rad,
        })
    });
    Ok(json!({
        "goal_mae_db": GOAL_DB,
        "steps": steps,
        "agents": samples.len(),
        "gain": gain,
        "mean_db": mean_db,
        "mean_without_gain_db": mean(&samples, |own| own.psnr_without_gain_db),
        "mae_db_of_mean": mean(&samples, |own| (own.psnr_db - mean_db).abs()),
        "judged": scores(&samples, |own| own.judged_db),
        "grids": grids.collect::<Vec<_>>(),
        "samples": rows.collect::<Vec<_>>(),
    }))
}

/// What each agent sees, rendered and in truth.
fn images(
    views: &WalkViews,
    renderer: &Renderer,
    scene: &Scene,
    world: &World,
) -> Result<Vec<(Image, TrainingView)>> {
    let shown = pinhole(SIZE, SupportConfig::default().field_of_view_rad)?;
    let image = |agent: usize| {
        let (_, pose) = world.world_from_camera(agent);
        let truth = views.pinhole(0, shown, &pose)?;
        let found = renderer.render(scene, &truth.camera, &truth.exposure);
        Ok((found, truth))
    };
    (0..world.environments())
        .into_par_iter()
        .map(image)
        .collect()
}

/// Agents at the starts of episodes, with predictions of a grid.
fn world(scene: &Arc<SceneData>, (cell_m, headings): (f64, usize), quick: bool) -> Result<World> {
    let mut support = SupportConfig::default();
    (support.cell_m, support.headings) = (cell_m, headings);
    let mut config = WorldConfig {
        environments: if quick { QUICK_AGENTS } else { AGENTS },
        seed: SEED,
        support: Some(support),
        ..WorldConfig::default()
    };
    config.task.task = Task::Velocity;
    let mut world = World::new(scene.clone(), config)?;
    world.reset(None, None)?;
    Ok(world)
}

fn mean(samples: &[Sample], of: impl Fn(&Sample) -> f64) -> f64 {
    samples.iter().map(of).sum::<f64>() / samples.len().max(1) as f64
}

/// Errors of a prediction, and how it divides good from bad views.
fn scores(samples: &[Sample], of: impl Fn(&Sample) -> f64) -> Value {
    let count = |is: &dyn Fn(&Sample) -> bool| samples.iter().filter(|own| is(own)).count();
    json!({
        "mae_db": mean(samples, |own| (of(own) - own.psnr_db).abs()),
        "bias_db": mean(samples, |own| of(own) - own.psnr_db),
        "bad_db": BAD_DB,
        "bad": count(&|own| own.psnr_db < BAD_DB),
        "bad_accepted": count(&|own| own.psnr_db < BAD_DB && of(own) >= BAD_DB),
        "good_refused": count(&|own| own.psnr_db >= BAD_DB && of(own) < BAD_DB),
    })
}
