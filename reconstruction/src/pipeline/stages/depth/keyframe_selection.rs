//! Keyframe selection by motion, and poses of keyframes.
//!
//! Contract: a frame of a set is a keyframe if the rig has translated or rotated enough since the
//! previous keyframe of the same camera, and the rig is tracked at that time: dead reckoned poses
//! are too uncertain for a map. Its pose is that of its own time.

use std::collections::BTreeMap;

use cad_transforms::RigidTransform;
use scene_bundle::Trajectory;
use scene_bundle::outputs::keyframes::Keyframe;
use scene_bundle::outputs::rig::RigCamera;
use session_archive::index::Index;

use super::config::KeyframeSpacing;
use crate::pipeline::stages::pose_interpolation::pose_at;

impl KeyframeSpacing {
    fn is_reached(&self, last: &RigidTransform, now: &RigidTransform) -> bool {
        let motion = last.inverse() * *now;
        motion.distance_m() >= self.translation_m
            || motion.angle_rad().to_degrees() >= self.rotation_deg
    }
}

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
    let mut last: Option<RigidTransform> = None;
    for set in &index.sets {
        let Some(position) = set.frames[number] else {
            continue;
        };
        let frame = &index.cameras[number].frames[position as usize];
        let Some(world_from_rig) = pose_at(trajectory, frame.time_ns) else {
            continue;
        };
        if last.is_some_and(|last| !spacing.is_reached(&last, &world_from_rig)) {
            continue;
        }
        last = Some(world_from_rig);
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn either_motion_is_enough() {
        let spacing = KeyframeSpacing {
            translation_m: 0.5,
            rotation_deg: 10.0,
        };
        let origin = RigidTransform::identity();
        let motion = |w: f64, x: f64| {
            RigidTransform::from_rotation_vector([0.0, w, 0.0], [x, 0.0, 0.0]).expect("finite")
        };
        assert!(!spacing.is_reached(&origin, &motion(0.1, 0.4)));
        assert!(spacing.is_reached(&origin, &motion(0.2, 0.0)));
        assert!(spacing.is_reached(&origin, &motion(0.0, 0.6)));
    }
}
