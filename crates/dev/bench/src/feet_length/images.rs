//! A session with images, and the measured stages on it.

use std::path::Path;

use anyhow::{Context, Result};
use scene_bundle::Scene;
use scene_bundle::outputs::{self, KEYFRAMES, TAG_DETECTIONS};

use super::map_size::MapSize;
use super::plain::new_bundle;
use super::runs::{IMAGES, Run};
use super::walk::Walk;
use super::{stage_run, walk};

/// Columns and rows of one eye.
const SIZE: [u32; 2] = [672, 376];
const RATE_HZ: f64 = 7.5;
const STAGES: [&str; 4] = ["tags", "terrain", "feet", "maps"];

/// Renders a walk of some minutes, and measures the stages on it.
///
/// # Errors
/// The walk cannot be rendered, or a stage fails.
pub(super) fn run(minutes: u32, disk: &Path) -> Result<Run> {
    let own = Walk::new(minutes, SIZE, RATE_HZ)?;
    let session = own.session(&disk.join(format!("images-{minutes}-session")))?;
    let path = disk.join(format!("images-{minutes}.scene"));
    let input = walk::open(&session)?;
    new_bundle(&own, &input, &path, i64::MAX)?;
    drop(input);
    stage_run::prepare(&session, &path, "depth", "cloud").context("preparing depth")?;
    let stages = stage_run::run(&session, &path, &STAGES, 1)?;
    let scene = Scene::open(&path)?;
    let run = Run {
        source: IMAGES.to_owned(),
        minutes,
        keyframes: outputs::keyframes::read(&scene.output(KEYFRAMES)?)?.len(),
        detections: outputs::tag_detections::read(&scene.output(TAG_DETECTIONS)?)?.len(),
        stages,
        map: MapSize::of(&path, &path)?,
    };
    run.print();
    Ok(run)
}
