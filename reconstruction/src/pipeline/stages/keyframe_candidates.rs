//! Frames that will probably be keyframes, known while the odometry reads them.
//!
//! Keyframes are selected by the poses of the bundle adjustment, and those differ little from the
//! causal ones over the distance between two keyframes. So the same selection by causal poses finds
//! nearly all of them, and their images need not be decoded again by later stages. Nothing depends
//! on it but time: frames that were not found are decoded again.

use std::collections::VecDeque;

use scene_bundle::{Pose, Trajectory};

use super::keyframe_spacing::{KeyframeSelector, KeyframeSpacing};
use super::pose_interpolation::pose_at;

/// Number of poses by which a set is judged: of the set itself, the one before and the one after.
const POSES: usize = 3;

/// A frame with its time, ns.
pub(super) type TimedFrame<F> = (i64, F);

/// See the module. `F` is a decoded frame.
#[derive(Debug)]
pub(super) struct KeyframeCandidates<F> {
    /// One for each camera.
    selectors: Vec<KeyframeSelector>,
    /// The newest poses.
    poses: VecDeque<Pose>,
    /// Frames of the set of the newest pose, one for each camera; judged when the next pose is
    /// known.
    pending: Vec<Option<TimedFrame<F>>>,
}

impl<F> KeyframeCandidates<F> {
    pub(super) fn new(cameras: usize, spacing: KeyframeSpacing) -> Self {
        Self {
            selectors: vec![KeyframeSelector::new(spacing); cameras],
            poses: VecDeque::new(),
            pending: Vec::new(),
        }
    }

    /// Adds a set with its causal pose; returns candidates of the set before.
    pub(super) fn push(&mut self, pose: Pose, frames: Vec<Option<TimedFrame<F>>>) -> Vec<F> {
        self.poses.push_back(pose);
        let before = std::mem::replace(&mut self.pending, frames);
        let found = self.judge(before);
        if self.poses.len() == POSES {
            self.poses.pop_front();
        }
        found
    }

    /// Candidates of the last set.
    pub(super) fn finish(mut self) -> Vec<F> {
        let last = std::mem::take(&mut self.pending);
        self.judge(last)
    }

    fn judge(&mut self, frames: Vec<Option<TimedFrame<F>>>) -> Vec<F> {
        let Ok(trajectory) = Trajectory::new(self.poses.iter().cloned().collect()) else {
            return Vec::new();
        };
        let mut found = Vec::new();
        for (selector, frame) in self.selectors.iter_mut().zip(frames) {
            let Some((time_ns, frame)) = frame else {
                continue;
            };
            let pose = pose_at(&trajectory, time_ns);
            if pose.is_some_and(|pose| selector.is_keyframe(&pose)) {
                found.push(frame);
            }
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use cad_transforms::RigidTransform;
    use scene_bundle::Status;

    use super::*;
    use crate::pipeline::stages::preset::Preset;

    #[test]
    fn candidates_are_the_keyframes_of_the_same_poses() {
        // 1 m/s at 15 Hz; the second camera is exposed 20 ms after the first.
        let pose = |k: i64| Pose {
            status: match k {
                40..50 => Status::DeadReckoned,
                _ => Status::Tracked,
            },
            ..Pose::new(
                k * 66_000_000,
                RigidTransform::from_translation_m([k as f64 / 15.0, 0.0, 0.0]).expect("finite"),
            )
        };
        let poses: Vec<Pose> = (0..100).map(pose).collect();
        let spacing = KeyframeSpacing::preset(Preset::Balanced);
        let delays_ns = [0, 20_000_000];
        let mut candidates = KeyframeCandidates::new(2, spacing);
        let mut found = Vec::new();
        for pose in &poses {
            let frame = |camera| {
                let time_ns = pose.time_ns + delays_ns[camera];
                Some((time_ns, (camera, time_ns)))
            };
            found.extend(candidates.push(pose.clone(), vec![frame(0), frame(1)]));
        }
        found.extend(candidates.finish());
        let trajectory = Trajectory::new(poses.clone()).expect("rising");
        for (camera, delay_ns) in delays_ns.into_iter().enumerate() {
            let mut selector = KeyframeSelector::new(spacing);
            let times = poses.iter().map(|pose| pose.time_ns + delay_ns);
            let expected = times.filter(|time_ns| {
                pose_at(&trajectory, *time_ns).is_some_and(|pose| selector.is_keyframe(&pose))
            });
            let of_camera = found.iter().filter(|(of, _)| *of == camera);
            assert!(of_camera.map(|(_, time_ns)| *time_ns).eq(expected));
        }
        assert!(found.len() > 20, "{}", found.len());
    }
}
