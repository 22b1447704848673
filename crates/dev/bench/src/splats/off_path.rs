//! Views away from the path: a camera of a training instant, moved and rotated to where free space
//! connects both poses.

use anyhow::Result;
use cad_transforms::RigidTransform;
use nalgebra::Vector3;
use rayon::prelude::*;
use rig_sim::random;
use simulation::testing::offset_pose;

use super::views::{Part, TestView, ViewOptions, WalkViews};

/// Distances from the path, m, and angles to its camera, degrees.
pub(crate) const OFFSETS_M: [f64; 4] = [0.1, 0.3, 1.0, 3.0];
pub(crate) const ANGLES_DEG: [f64; 3] = [0.0, 10.0, 30.0];
/// Nothing is nearer to a camera, m.
const CLEARANCE_M: f64 = 0.3;
/// Largest share of the sky.
const MAX_SKY: f64 = 0.5;
/// Random poses that are tried for each view.
const TRIES: u64 = 20;
const STREAM: u64 = 0xe0;

/// A test view at an offset and angle.
pub(crate) struct OffPathView {
    pub(crate) test: TestView,
    pub(crate) offset_m: f64,
    pub(crate) angle_deg: f64,
}

/// Views of each offset and angle, `count` of each at most: fewer where there is no space.
///
/// # Errors
/// A pose that is not finite.
pub(crate) fn off_path(
    views: &WalkViews,
    count: usize,
    seed: u64,
    options: &ViewOptions,
) -> Result<Vec<OffPathView>> {
    let poses = views.poses(Part::Training)?;
    let mut wanted = Vec::new();
    for offset_m in OFFSETS_M {
        for angle_deg in ANGLES_DEG {
            wanted.extend((0..count).map(|_| (offset_m, angle_deg)));
        }
    }
    let found: Result<Vec<Option<OffPathView>>> = wanted
        .par_iter()
        .enumerate()
        .map(|(number, (offset_m, angle_deg))| {
            for attempt in 0..TRIES {
                let index = 8 * (TRIES * number as u64 + attempt);
                let uniform = |k: u64| random::uniform(seed, STREAM, index + k);
                let (camera, frame, pose) = &poses[(uniform(0) * poses.len() as f64) as usize];
                let side = if uniform(2) < 0.5 { -1.0 } else { 1.0 };
                let along_rad = std::f64::consts::TAU * uniform(1);
                let yaw_rad = side * angle_deg.to_radians();
                let moved = offset_pose(pose, *offset_m, along_rad, yaw_rad)?;
                if !is_free(views, pose, &moved) {
                    continue;
                }
                let test = views.truth_at(*camera, *frame, &moved, options)?;
                let sky = test.view.depth_m.iter().filter(|z| z.is_nan()).count();
                if sky as f64 > MAX_SKY * test.view.depth_m.len() as f64 {
                    continue;
                }
                return Ok(Some(OffPathView {
                    test,
                    offset_m: *offset_m,
                    angle_deg: *angle_deg,
                }));
            }
            Ok(None)
        })
        .collect();
    Ok(found?.into_iter().flatten().collect())
}

/// Whether nothing is between the poses and around the second one.
fn is_free(views: &WalkViews, from: &RigidTransform, to: &RigidTransform) -> bool {
    let scene = views.prepared.simulation.scene();
    let (from, to) = (from.translation(), to.translation());
    if scene.is_hidden(from, &(to - from), 1.0) {
        return false;
    }
    let around = (0..26).map(|k| {
        let k = k + i32::from(k >= 13);
        let [x, y, z] = [k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1].map(f64::from);
        Vector3::new(x, y, z).normalize()
    });
    around
        .into_iter()
        .all(|direction| !scene.is_hidden(to, &direction, CLEARANCE_M))
}
