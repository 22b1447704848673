//! Depth on pairs of the rendered walk whose true disparities the renderer gives.

use std::fs;

use anyhow::{Context, Result, ensure};
use cad_transforms::RigidTransform;
use depth::{Band, Config, Geometry, Matcher, Preset};
use harness::sequences::OwnedFrameSet;
use serde_json::{Value, json};

use super::Walk;
use crate::depth::coverage::Coverage;
use crate::depth::frames::Frame;
use crate::depth::peers::{Peers, SgbmConfig};
use crate::depth::race::Race;

/// Number of disparities: the nearest surfaces are 0.5 m away.
const RANGE: usize = 64;
/// Times that each pair is matched for its time.
const RUNS: usize = 3;
/// Disparity by which a nearer surface hides a farther one, px.
const HIDING_PX: f32 = 1.0;

/// Our settings and OpenCV's in one run, and coverage of the sigmas of each preset.
pub(super) fn results(walk: &Walk) -> Result<Value> {
    let frames = frames(walk)?;
    let all: Vec<&Frame> = frames.iter().collect();
    let race = Race::run(&mut Peers::start()?, &SgbmConfig::few(), &all, RUNS)?;
    race.print("foreign renderer");
    let coverage = Preset::ALL.map(|preset| coverage(preset, &frames));
    let coverage = coverage.into_iter().collect::<Result<Vec<Value>>>()?;
    Ok(json!({ "race": race.json(), "coverage": coverage }))
}

/// Ratio of errors within two stated sigmas on all frames, in each quarter of the sigmas, the
/// smallest first.
fn coverage(preset: Preset, frames: &[Frame]) -> Result<Value> {
    let mut coverage = Coverage::default();
    for frame in frames {
        let [left, right] = frame.images();
        let band = Band::full(0, frame.range, frame.height)?;
        let mut matcher = Matcher::new(Config::preset(preset), frame.width, frame.height)?;
        coverage.add(matcher.run(&left, &right, &band)?, frame);
    }
    let shares = coverage.shares();
    Ok(json!({
        "matcher": preset.name(),
        "within_two_sigmas": shares.all,
        "within_by_quarter": shares.quarters,
        "median_sigma_px": shares.median_sigma,
    }))
}

/// The pairs with true disparities.
fn frames(walk: &Walk) -> Result<Vec<Frame>> {
    let camera = &walk.sequence.rig().cameras[0];
    let baseline_m = -camera.right_from_left.translation_m()[0];
    let mut frames = Vec::new();
    walk.sequence.for_each(|set| {
        let path = walk.folder.join(format!("disparity/{}.f32", set.time_ns));
        if path.exists() {
            let bytes = fs::read(&path).with_context(|| format!("reading {}", path.display()))?;
            let truth = bytes.chunks_exact(4);
            let truth = truth.map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]]));
            let geometry = Geometry {
                focal_px: camera.left.fx,
                center: [camera.left.cx, camera.left.cy],
                baseline_m,
                offset_px: camera.right.cx - camera.left.cx,
            };
            frames.push(frame(&set, truth.collect(), geometry)?);
        }
        Ok(())
    })?;
    ensure!(
        !frames.is_empty(),
        "there is no true disparity: {}",
        walk.folder.display()
    );
    Ok(frames)
}

fn frame(set: &OwnedFrameSet, truth: Vec<f32>, geometry: Geometry) -> Result<Frame> {
    let view = set.views[0].as_ref().context("a pair without images")?;
    let (found, expected) = (truth.len(), view.width * view.height);
    ensure!(
        found == expected,
        "found {found} true disparities, expected {expected}"
    );
    let mut visible = vec![false; truth.len()];
    for (row, visible) in truth.chunks(view.width).zip(visible.chunks_mut(view.width)) {
        // Nearest surface at each column of the right image.
        let mut nearest = vec![0.0_f32; view.width];
        let column = |x: usize| {
            let at = x as f32 - row[x];
            (at >= -0.5).then(|| at.round() as usize)
        };
        for (x, disparity) in row.iter().enumerate() {
            if let Some(at) = column(x) {
                nearest[at] = nearest[at].max(*disparity);
            }
        }
        for (x, visible) in visible.iter_mut().enumerate() {
            *visible = column(x).is_some_and(|at| row[x] >= nearest[at] - HIDING_PX);
        }
    }
    Ok(Frame {
        name: set.time_ns.to_string(),
        width: view.width,
        height: view.height,
        eyes: [view.left.clone(), view.right.clone()],
        truth,
        visible,
        range: RANGE,
        geometry,
        world_from_left: RigidTransform::identity(),
    })
}
