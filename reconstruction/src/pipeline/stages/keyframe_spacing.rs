//! How far keyframes of a camera are apart.

use cad_transforms::RigidTransform;
use estimator_config::config;

use super::preset::Preset;

config! {
    /// Keyframe spacing: a keyframe is due as soon as one of the two is reached.
    pub(super) struct KeyframeSpacing {
        /// Translation of the rig, m: one step of a person. Half of it doubles time and size.
        pub translation_m: f64 = 0.5,
        /// Rotation of the rig, degrees: a third of the vertical field of view of 60 degrees.
        pub rotation_deg: f64 = 20.0,
    }
}

impl KeyframeSpacing {
    /// Spacing of a preset: two steps, one step, half a step.
    pub(super) fn preset(preset: Preset) -> Self {
        let (translation_m, rotation_deg) = match preset {
            Preset::Fast => (1.0, 30.0),
            Preset::Balanced => return Self::default(),
            Preset::Accurate => (0.25, 10.0),
        };
        Self {
            translation_m,
            rotation_deg,
        }
    }

    fn is_reached(&self, last: &RigidTransform, now: &RigidTransform) -> bool {
        let motion = last.inverse() * *now;
        motion.distance_m() >= self.translation_m
            || motion.angle_rad().to_degrees() >= self.rotation_deg
    }
}

/// Selects keyframes of one camera out of its tracked frames, in order of time.
#[derive(Clone, Copy, Debug)]
pub(super) struct KeyframeSelector {
    spacing: KeyframeSpacing,
    /// Pose of the rig at the last keyframe.
    last: Option<RigidTransform>,
}

impl KeyframeSelector {
    pub(super) fn new(spacing: KeyframeSpacing) -> Self {
        let last = None;
        Self { spacing, last }
    }

    /// Whether a frame with this pose of the rig is a keyframe. The first one is.
    pub(super) fn is_keyframe(&mut self, world_from_rig: &RigidTransform) -> bool {
        let is_near =
            (self.last).is_some_and(|last| !self.spacing.is_reached(&last, world_from_rig));
        if !is_near {
            self.last = Some(*world_from_rig);
        }
        !is_near
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn either_motion_is_enough() {
        let spacing = KeyframeSpacing::preset(Preset::Balanced);
        let origin = RigidTransform::identity();
        let motion = |w: f64, x: f64| {
            RigidTransform::from_rotation_vector([0.0, w, 0.0], [x, 0.0, 0.0]).expect("finite")
        };
        assert!(!spacing.is_reached(&origin, &motion(0.1, 0.4)));
        assert!(spacing.is_reached(&origin, &motion(0.4, 0.0)));
        assert!(spacing.is_reached(&origin, &motion(0.0, 0.6)));
        let mut selector = KeyframeSelector::new(spacing);
        let found = [0.0, 0.3, 0.6, 0.9, 1.2].map(|x| selector.is_keyframe(&motion(0.0, x)));
        assert_eq!(found, [true, false, true, false, true]);
    }
}
