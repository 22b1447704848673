//! Views away from the path: a camera of a training instant moved and turned, where nothing is in
//! its way.

use anyhow::Result;
use cad_transforms::RigidTransform;
use nalgebra::Vector3;
use rayon::prelude::*;
use rig_sim::random;

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

/// Views of each offset and angle, `count` of each at most: fewer where everything is in the way.
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
                let moved = moved(pose, *offset_m, *angle_deg, [uniform(1), uniform(2)])?;
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

/// Moved in a horizontal direction and turned about the vertical.
fn moved(
    pose: &RigidTransform,
    offset_m: f64,
    angle_deg: f64,
    [direction, side]: [f64; 2],
) -> Result<RigidTransform> {
    let turn = std::f64::consts::TAU * direction;
    let [x, y, z] = pose.translation_m();
    let to = [x + offset_m * libm::cos(turn), y + offset_m * libm::sin(turn), z];
    let angle = angle_deg.to_radians() * if side < 0.5 { -1.0 } else { 1.0 };
    let about = RigidTransform::from_rotation_vector([0.0, 0.0, angle], [0.0; 3])?;
    let at_origin = RigidTransform::from_translation_m([-x, -y, -z])? * *pose;
    Ok(RigidTransform::from_translation_m(to)? * about * at_origin)
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
