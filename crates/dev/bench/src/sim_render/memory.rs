//! Exam 6.15 with images: resident memory, files and threads over frames between which Gaussians
//! are loaded and leave.
//!
//! A camera goes through the sectors with memory for one sector and the next: each change loads a
//! sector, ahead or, with memory for one alone, when it is needed.

use std::f64::consts::FRAC_PI_2;
use std::sync::Arc;

use anyhow::Result;
use cad_transforms::RigidTransform;
use serde_json::{Value, json};
use simulation::testing::SyntheticScene;
use simulation::{
    CameraBatch, CameraConfig, FrameRequest, Frames, GaussianStore, ResidencyConfig, SceneData,
};

use super::changes::largest_sector;
use super::route::{self, along_recording, around_loop};
use crate::odometry::run::forget_peak;
use crate::resident::Samples;

const SIZE: [u32; 2] = [64, 48];
/// Path length between two frames, m: there are to be many changes among them.
const FRAME_M: f64 = 0.5;
/// Distance between Gaussians of the synthetic loop, m.
const SPACING_M: f64 = 0.1;
const FRAMES: usize = 4000;
const QUICK_FRAMES: usize = 400;
const SAMPLES: usize = 50;

/// # Errors
/// A scene that cannot be rendered.
pub(super) fn measure(recorded: Option<&Arc<SceneData>>, quick: bool) -> Result<Value> {
    let count = if quick { QUICK_FRAMES } else { FRAMES };
    let synthetic = SyntheticScene::corridor_loop_with(SPACING_M)?.scene;
    let lap = around_loop(1, FRAME_M)?.len();
    let poses = around_loop(count.div_ceil(lap), FRAME_M)?;
    let mut rows = vec![frames(&synthetic, "synthetic loop", &poses[..count], 2)?];
    if let Some(scene) = recorded.filter(|scene| scene.sectors.len() > 1) {
        let lap = along_recording(scene, 1, FRAME_M)?.len();
        let poses = along_recording(scene, count.div_ceil(lap), FRAME_M)?;
        rows.push(frames(scene, "reconstructed walk", &poses[..count], 1)?);
    }
    Ok(json!({ "width": SIZE[0], "height": SIZE[1], "rows": rows }))
}

/// Frames along a route with memory for some sectors.
fn frames(
    scene: &Arc<SceneData>,
    name: &str,
    poses: &[RigidTransform],
    sectors: u64,
) -> Result<Value> {
    let mut residency = ResidencyConfig::default();
    residency.budget_bytes = sectors * largest_sector(scene)?;
    let store = Arc::new(GaussianStore::new(scene.clone(), residency));
    let camera = CameraBatch::new(store.clone(), CameraConfig::pinhole(SIZE, FRAC_PI_2)?)?;
    let mut images = Frames::default();
    let steps = route::route(scene, poses, 0)?;
    let per_sample = steps.len() / SAMPLES;
    // What other parts left free.
    forget_peak()?;
    let mut samples = Samples::default();
    let (mut loaded, mut left, mut before) = (0, 0, Vec::new());
    for (number, step) in steps.iter().enumerate() {
        let pose = step.sector_from_body * RigidTransform::body_from_optical();
        camera.render(&[FrameRequest::new(step.sector, pose)], &mut images)?;
        // So that every run loads the same.
        store.wait_for_prefetch();
        let resident = store.resident();
        let missing = |from: &[usize], other: &[usize]| {
            from.iter().filter(|own| !other.contains(own)).count()
        };
        loaded += missing(&resident, &before);
        left += missing(&before, &resident);
        before = resident;
        if (number + 1).is_multiple_of(per_sample) {
            samples.take()?;
        }
    }
    println!("  {name} done");
    Ok(json!({
        "scene": name,
        "sectors": scene.sectors.len(),
        "budget_bytes": sectors * largest_sector(scene)?,
        "frames": steps.len(),
        "changes": route::changes(&steps),
        "loaded": loaded,
        "left": left,
        "resident_bytes": samples.resident_bytes(),
        "samples_mb": samples.megabytes(),
        "bytes_per_1000_frames": 1e3 * samples.bytes_per_unit(per_sample as f64),
        "files": samples.files(),
        "threads": samples.threads(),
    }))
}
