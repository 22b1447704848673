//! Keyframes with depth and their poses, by instant.

use std::collections::BTreeMap;

use cad_transforms::RigidTransform;
use scene_bundle::outputs::depth::{DepthIndex, DepthKey};
use scene_bundle::outputs::{self, rig::RigModel};
use scene_bundle::{OutputReader, Trajectory};
use terrain::RowMotion;

use super::rolling_shutter::row_motion;
use crate::pipeline::StageError;

/// A depth map with its pose.
#[derive(Clone, Copy, Debug)]
pub(super) struct DepthFrame {
    pub(super) key: DepthKey,
    /// Pose at the exposure of its middle row.
    pub(super) world_from_view: RigidTransform,
    pub(super) row_motion: RowMotion,
}

/// Depth frames of each instant, in order.
pub(super) fn instants(
    rig: &RigModel,
    index: &DepthIndex,
    keyframes: &OutputReader,
    trajectory: &Trajectory,
) -> Result<Vec<Vec<DepthFrame>>, StageError> {
    let mut poses = BTreeMap::new();
    for keyframe in outputs::keyframes::read(keyframes)? {
        let camera = rig.cameras.get(usize::from(keyframe.camera));
        let name = camera.map_or("", |camera| camera.name.as_str());
        poses.insert((name, keyframe.frame), keyframe.world_from_left);
    }
    let mut instants: BTreeMap<u64, Vec<DepthFrame>> = BTreeMap::new();
    for key in &index.images {
        let view = &index.views[key.view];
        let Some(world_from_left) = poses.get(&(view.camera.as_str(), key.frame)) else {
            let (frame, camera) = (key.frame, &view.camera);
            return Err(format!("frame {frame} of {camera} has depth and is no keyframe").into());
        };
        let world_from_view = *world_from_left * view.view_from_left.inverse();
        let camera = rig.camera(&view.camera).map(|(_, camera)| camera);
        let row_motion = camera.map(|camera| row_motion(camera, view, trajectory, key.time_ns));
        let depth_frame = DepthFrame {
            key: *key,
            world_from_view,
            row_motion: row_motion.unwrap_or_default(),
        };
        instants.entry(key.set).or_default().push(depth_frame);
    }
    Ok(instants.into_values().collect())
}
