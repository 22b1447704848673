//! Keyframe selection by motion, and poses of keyframes.
//!
//! Contract: a frame of a set is a keyframe if the rig has translated or rotated enough since the
//! previous keyframe of the same camera, and the rig is tracked at that time: dead reckoned poses
//! are too uncertain for a map. Its pose is that of its own time.

use std::collections::BTreeMap;

use scene_bundle::Trajectory;
use scene_bundle::outputs::keyframes::Keyframe;
use scene_bundle::outputs::rig::RigCamera;
use session_archive::index::Index;

use crate::pipeline::stages::keyframe_spacing::{KeyframeSelector, KeyframeSpacing};
use crate::pipeline::stages::pose_interpolation::pose_at;

/// Keyframes of a camera by their positions in its index. `number` is the camera's number in the
/// index, `place` that in the rig.
pub(super) fn keyframes(
    index: &Index,
    number: usize,
    (place, camera): (usize, &RigCamera),
    trajectory: &Trajectory,
    spacing: KeyframeSpacing,
) -> BTreeMap<usize, Keyframe> {
    let mut chosen = BTreeMap::new();
    let mut selector = KeyframeSelector::new(spacing);
    for set in &index.sets {
        let Some(position) = set.frames[number] else {
            continue;
        };
        let frame = &index.cameras[number].frames[position as usize];
        let Some(world_from_rig) = pose_at(trajectory, frame.time_ns) else {
            continue;
        };
        if !selector.is_keyframe(&world_from_rig) {
            continue;
        }
        let keyframe = Keyframe {
            set: set.number,
            frame: frame.number,
            time_ns: frame.time_ns,
            camera: place as u8,
            world_from_left: world_from_rig * camera.rig_from_left,
        };
        chosen.insert(position as usize, keyframe);
    }
    chosen
}
