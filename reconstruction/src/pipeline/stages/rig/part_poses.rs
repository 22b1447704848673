//! Extrinsics of the parts of a rig.
//!
//! Contract: the rig file has precedence over the recorded transforms. A session of one camera
//! without extrinsics gets a rig of its own, whose origin is the left camera and whose x axis is
//! its optical axis.

use cad_transforms::frame::{Frame, FramePart};
use cad_transforms::{Covariance, Rig, RigidTransform};
use session_archive::record::FrameTransform;

use crate::input::Input;
use crate::pipeline::Report;

/// A pose on the rig with its covariance.
pub(super) type PoseWithCovariance = (RigidTransform, Option<Covariance>);

pub(super) struct PartPoses<'a> {
    rig: Option<&'a Rig>,
    /// Parent, child, `parent_from_child`.
    recorded: Vec<(String, String, RigidTransform)>,
}

impl<'a> PartPoses<'a> {
    pub(super) fn new(rig: Option<&'a Rig>, input: &Input, report: &mut Report) -> Self {
        let mut part_poses = Self {
            rig,
            recorded: input.transforms().iter().filter_map(read).collect(),
        };
        if let [camera] = &input.manifest().cameras[..]
            && part_poses.on_rig(&camera.name, FramePart::Left).is_none()
        {
            let left = format!("{}/left", camera.name);
            let forward = RigidTransform::body_from_optical();
            part_poses
                .recorded
                .push((Frame::rig().to_string(), left, forward));
            let note = format!(
                "no rig: the left camera of {} is taken as its origin",
                camera.name
            );
            report.notes.push(note);
        }
        part_poses
    }

    /// Pose of a part of a camera on the rig.
    pub(super) fn on_rig(&self, camera: &str, part: FramePart) -> Option<PoseWithCovariance> {
        let part = Frame::of_camera(camera, part).ok()?;
        if let Some(rig) = self.rig
            && let Ok(place) = rig.transform(&Frame::rig(), &part)
        {
            let covariance = rig.covariance(&Frame::rig(), &part).ok().flatten();
            return Some((place, covariance));
        }
        let place = self.recorded(Frame::rig().as_str(), part.as_str())?;
        Some((place, None))
    }

    /// `b_from_a` of two parts of a camera, with the covariance that the rig file states: of a
    /// small motion of `a` in its own axes.
    pub(super) fn transform(
        &self,
        camera: &str,
        b: FramePart,
        a: FramePart,
    ) -> Option<PoseWithCovariance> {
        let b = Frame::of_camera(camera, b).ok()?;
        let a = Frame::of_camera(camera, a).ok()?;
        if let Some(rig) = self.rig
            && let Ok(transform) = rig.transform(&b, &a)
        {
            return Some((transform, rig.covariance(&b, &a).ok().flatten()));
        }
        Some((self.recorded(b.as_str(), a.as_str())?, None))
    }

    /// `b_from_a` by recorded transforms. There are few, so the search is simple: from known frames
    /// until no new one is found.
    fn recorded(&self, b: &str, a: &str) -> Option<RigidTransform> {
        let mut known = vec![(a, RigidTransform::identity())];
        let mut next = 0;
        while let Some((at, at_from_a)) = known.get(next).copied() {
            if at == b {
                return Some(at_from_a);
            }
            for (parent, child, parent_from_child) in &self.recorded {
                let (to, to_from_at) = if child == at {
                    (parent.as_str(), *parent_from_child)
                } else if parent == at {
                    (child.as_str(), parent_from_child.inverse())
                } else {
                    continue;
                };
                if known.iter().all(|(name, _)| *name != to) {
                    known.push((to, to_from_at * at_from_a));
                }
            }
            next += 1;
        }
        None
    }
}

/// `None` if it is not a rigid transform.
fn read(t: &FrameTransform) -> Option<(String, String, RigidTransform)> {
    let q = t.rotation.as_ref()?;
    let p = t.translation.as_ref()?;
    // The message names the components; the transform takes w first.
    let place = RigidTransform::from_wxyz([q.w, q.x, q.y, q.z], [p.x, p.y, p.z]).ok()?;
    Some((t.parent_frame_id.clone(), t.child_frame_id.clone(), place))
}
