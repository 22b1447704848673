//! What the stages read, and edits of it.

use std::sync::Arc;

use anyhow::Result;
use cad_transforms::RigidTransform;
use rig_sim::simulation::StereoFrame;
use scene_bundle::outputs::rig::{RigModel, RigShoeTag};
use scene_bundle::{Pose, Status, Trajectory};

/// Inputs of the stages `tags` and `feet`, besides the ground.
#[derive(Clone)]
pub(super) struct Inputs {
    pub(super) rig: RigModel,
    pub(super) trajectory: Trajectory,
    pub(super) frames: Vec<Arc<StereoFrame>>,
    /// Time stamps minus true times of frames, ns.
    pub(super) time_offset_ns: i64,
    /// From here on the image of the right eye is black, ns.
    pub(super) right_black_from_ns: Option<i64>,
}

/// A wrong input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Edit {
    /// Numbers of the tags of both shoes, exchanged.
    ExchangedTags,
    /// Size of the tags, as a ratio.
    TagSize,
    /// Height of the tags above the sole, m.
    TagHeight,
    /// Pitch of the tags on the shoe, degrees.
    TagTilt,
    /// Sole outlines that are longer at both ends, m.
    SoleOutline,
    /// Time stamps of the feet camera, ms.
    Clock,
    /// Scale of the trajectory.
    PoseDrift,
    /// A jump of the trajectory in the middle, m.
    PoseJump,
    /// A dead-reckoned part in the middle, s, with an error to the side that grows with 0.05 m/s²
    /// and remains.
    DeadReckoned,
    /// Rotation of the right eye about its vertical axis, degrees.
    RightEyeYaw,
    /// About its horizontal axis, degrees.
    RightEyePitch,
    /// Baseline, as a ratio.
    Baseline,
    /// Right eye black for the last part of the walk, as a share of it.
    BlackEye,
}

/// Acceleration of the error of a dead-reckoned pose, m/s².
const DEAD_RECKONING_ERROR: f64 = 0.05;

impl Inputs {
    /// The same with an edit of this strength.
    ///
    /// # Errors
    /// A transform that is not finite.
    pub(super) fn edited(&self, edit: Edit, strength: f64) -> Result<Self> {
        let mut edited = self.clone();
        match edit {
            Edit::ExchangedTags => edited.exchange_tags(),
            Edit::TagSize => {
                edited.change_tags(|tag| {
                    tag.size_m *= 1.0 + strength;
                    Ok(())
                })?;
            }
            Edit::TagHeight => {
                let up = RigidTransform::from_translation_m([0.0, 0.0, strength])?;
                edited.change_tags(|tag| {
                    tag.foot_from_tag = up * tag.foot_from_tag;
                    Ok(())
                })?;
            }
            Edit::TagTilt => {
                let turn = [0.0, strength.to_radians(), 0.0];
                edited.change_tags(|tag| {
                    let place = tag.foot_from_tag;
                    let at = place.translation_m();
                    let turned = RigidTransform::from_rotation_vector(turn, [0.0; 3])? * place;
                    tag.foot_from_tag = RigidTransform::from_wxyz(turned.rotation_wxyz(), at)?;
                    Ok(())
                })?;
            }
            Edit::SoleOutline => {
                let [heel, toe] = [-0.13 - strength, 0.15 + strength];
                for shoe in &mut edited.rig.shoes {
                    shoe.outline_m =
                        [[heel, -0.05], [toe, -0.05], [toe, 0.05], [heel, 0.05]].into();
                }
            }
            Edit::Clock => edited.time_offset_ns = (1e6 * strength).round() as i64,
            Edit::PoseDrift => edited.change_poses(|poses| {
                let first = poses[0].world_from_rig.translation_m();
                for pose in poses {
                    let at = pose.world_from_rig.translation_m();
                    let from = [0, 1, 2].map(|k: usize| strength * (at[k] - first[k]));
                    shift(pose, from)?;
                }
                Ok(())
            })?,
            Edit::PoseJump => edited.change_poses(|poses| {
                let middle = poses.len() / 2;
                let mut after = poses[middle..].iter_mut();
                after.try_for_each(|pose| shift(pose, [0.0, strength, 0.0]))
            })?,
            Edit::DeadReckoned => edited.change_poses(|poses| {
                let middle_ns = poses[poses.len() / 2].time_ns;
                for pose in poses {
                    let since_s = 1e-9 * (pose.time_ns - middle_ns) as f64;
                    let dead_s = since_s.clamp(0.0, strength);
                    let error = 0.5 * DEAD_RECKONING_ERROR * dead_s * dead_s;
                    shift(pose, [0.0, error, 0.0])?;
                    if (0.0..strength).contains(&since_s) {
                        pose.status = Status::DeadReckoned;
                    }
                }
                Ok(())
            })?,
            Edit::RightEyeYaw => edited.turn_right_eye([0.0, strength.to_radians(), 0.0])?,
            Edit::RightEyePitch => edited.turn_right_eye([strength.to_radians(), 0.0, 0.0])?,
            Edit::Baseline => {
                for camera in &mut edited.rig.cameras {
                    let old = camera.right_from_left;
                    let at = old.translation_m().map(|v| (1.0 + strength) * v);
                    camera.right_from_left = RigidTransform::from_wxyz(old.rotation_wxyz(), at)?;
                }
            }
            Edit::BlackEye => {
                let last = self.frames.len().saturating_sub(1);
                let from = ((1.0 - strength) * last as f64).round() as usize;
                edited.right_black_from_ns = self.frames.get(from).map(|frame| frame.time_ns);
            }
        }
        Ok(edited)
    }

    fn exchange_tags(&mut self) {
        if let [left, right] = self.rig.shoes.as_mut_slice() {
            let pairs = left.tags.iter_mut().zip(&mut right.tags);
            pairs.for_each(|(left, right)| std::mem::swap(&mut left.id, &mut right.id));
        }
    }

    fn change_tags(&mut self, mut change: impl FnMut(&mut RigShoeTag) -> Result<()>) -> Result<()> {
        let mut tags = self.rig.shoes.iter_mut().flat_map(|shoe| &mut shoe.tags);
        tags.try_for_each(&mut change)
    }

    fn change_poses(&mut self, change: impl FnOnce(&mut [Pose]) -> Result<()>) -> Result<()> {
        let mut poses = std::mem::take(&mut self.trajectory).into_poses();
        change(&mut poses)?;
        self.trajectory = Trajectory::new(poses)?;
        Ok(())
    }

    fn turn_right_eye(&mut self, turn: [f64; 3]) -> Result<()> {
        for camera in &mut self.rig.cameras {
            let turn = RigidTransform::from_rotation_vector(turn, [0.0; 3])?;
            camera.right_from_left = turn * camera.right_from_left;
        }
        Ok(())
    }
}

/// Shifts a pose in the world, m.
fn shift(pose: &mut Pose, by: [f64; 3]) -> Result<()> {
    pose.world_from_rig = RigidTransform::from_translation_m(by)? * pose.world_from_rig;
    Ok(())
}
