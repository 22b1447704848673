//! Detections of the shoe tags by geometry.

use anyhow::{Context, Result};
use cad_transforms::rig::Foot;
use cad_transforms::{Covariance, RigidTransform};
use camera_models::Lens;
use rayon::prelude::*;
use rig_sim::scene::wearer::Part;
use rig_sim::simulation::seconds;
use rig_sim::walker::Side;
use scene_bundle::outputs::rig::{RigCamera, RigModel};
use scene_bundle::outputs::tag_detections::TagDetection;

use super::walk::{Walk, transform};

/// Standard deviations of a detected pose in the axes of the tag: m, and rad.
const SIGMA_M: [f64; 3] = [0.0015, 0.0015, 0.004];
const SIGMA_RAD: [f64; 3] = [0.02, 0.02, 0.008];
/// Cosine of the angle between the axis of a tag and the direction to the camera from which on it
/// is detected.
const MIN_COS: f64 = 0.26;
const SEED: u64 = 92;

/// A detection for each tag and frame that can show it, sorted by time and tag.
///
/// # Errors
/// A pose of the simulator is not finite.
pub(super) fn detections(walk: &Walk, rig: &RigModel) -> Result<Vec<TagDetection>> {
    let camera = rig.cameras.first().context("a camera")?;
    let covariance = Covariance::from_sigmas(SIGMA_M, SIGMA_RAD)?;
    let times: Vec<(u64, i64)> = (0..).zip(walk.frame_times()).collect();
    let scene = walk.simulation.scene();
    let of_frame = |&(frame, time_ns): &(u64, i64)| -> Result<Vec<TagDetection>> {
        let rig_from_world = walk.world_from_rig(time_ns)?.inverse();
        let mut found = Vec::new();
        for (number, tag) in scene.wearer.tags.iter().enumerate() {
            let walker = walk.simulation.walker();
            let (position, rotation) =
                scene
                    .wearer
                    .pose(Part::Tag(number), walker, seconds(time_ns));
            let rig_from_tag = rig_from_world * transform(&position, &rotation)?;
            if !is_in_view(camera, &rig_from_tag, tag.size_m) {
                continue;
            }
            let first = 12 * frame + 6 * number as u64;
            let noise =
                |k: usize, sigma: f64| sigma * counter_random::bell(SEED, 0, first + k as u64);
            let shift = [0, 1, 2].map(|k| noise(k, SIGMA_M[k]));
            let turn = [0, 1, 2].map(|k| noise(3 + k, SIGMA_RAD[k]));
            found.push(TagDetection {
                time_ns,
                frame,
                camera: 0,
                foot: match tag.side {
                    Side::Left => Foot::Left,
                    Side::Right => Foot::Right,
                },
                tag: tag.id as u64,
                rig_from_tag: rig_from_tag * RigidTransform::from_rotation_vector(turn, shift)?,
                covariance,
                visible_share: [1.0; 2],
                rms_levels: 2.0,
                wrong_bits: 0,
                second: None,
            });
        }
        found.sort_by_key(|own| own.tag);
        Ok(found)
    };
    let found = times.par_iter().map(of_frame);
    Ok(found.collect::<Result<Vec<_>>>()?.concat())
}

/// Whether both images have room for the whole tag, and its print faces the camera.
fn is_in_view(camera: &RigCamera, rig_from_tag: &RigidTransform, size_m: f64) -> bool {
    let left_from_tag = camera.rig_from_left.inverse() * *rig_from_tag;
    // z goes into the tag.
    let [x, y, z] = left_from_tag.inverse().translation_m();
    if -z < MIN_COS * (x * x + y * y + z * z).sqrt() {
        return false;
    }
    let eyes = [
        (&camera.left, left_from_tag),
        (&camera.right, camera.right_from_left * left_from_tag),
    ];
    eyes.iter().all(|(model, eye_from_tag)| {
        let lens = Lens::new(model);
        let size = [model.width, model.height].map(f64::from);
        let corners = [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]];
        corners.iter().all(|corner| {
            let [x, y] = corner.map(|side| 0.5 * side * size_m);
            let point = eye_from_tag.apply([x, y, 0.0]);
            let pixel = lens.project(point).filter(|_| point[2] > 0.0);
            pixel.is_some_and(|pixel| (0..2).all(|k| (0.0..size[k] - 1.0).contains(&pixel[k])))
        })
    })
}
