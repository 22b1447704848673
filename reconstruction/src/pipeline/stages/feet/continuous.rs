//! A trajectory without its jumps, and transforms from places by it to those with them.

use std::borrow::Cow;

use ::feet::checks::Jump;
use ::feet::events::Contact;
use cad_transforms::RigidTransform;
use nalgebra::Vector3;
use scene_bundle::{Pose, Trajectory};

/// A trajectory whose poses after jumps are displaced so that feet at rest are not.
pub(super) struct Continuous<'a> {
    pub(super) trajectory: Cow<'a, Trajectory>,
    /// Time of the first pose after each jump, ns, and its displacement, m.
    jumps: Vec<(i64, Vector3<f64>)>,
}

impl<'a> Continuous<'a> {
    pub(super) fn new(trajectory: &'a Trajectory, jumps: &[Jump]) -> Self {
        let poses = trajectory.poses();
        let after = |jump: &Jump| {
            let shift = Vector3::from(jump.shift_m);
            let first = poses.partition_point(|pose| pose.time_ns <= jump.times_ns[0]);
            let end = poses.partition_point(|pose| pose.time_ns <= jump.times_ns[1]);
            let along = |k: &usize| {
                let before = poses[k.saturating_sub(1)].world_from_rig.translation();
                (poses[*k].world_from_rig.translation() - before).dot(&shift)
            };
            let mut steps = first..(end + 1).min(poses.len());
            let largest = steps.clone().max_by(|a, b| along(a).total_cmp(&along(b)));
            let step = largest.or(steps.next())?;
            Some((poses[step].time_ns, shift))
        };
        let mut own = Self {
            trajectory: Cow::Borrowed(trajectory),
            jumps: jumps.iter().filter_map(after).collect(),
        };
        if !own.has_jumps() {
            return own;
        }
        let moved = poses.iter().map(|pose| Pose {
            world_from_rig: own.back(pose.time_ns).inverse() * pose.world_from_rig,
            ..*pose
        });
        if let Ok(moved) = Trajectory::new(moved.collect()) {
            own.trajectory = Cow::Owned(moved);
        }
        own
    }

    /// Whether it has any.
    pub(super) fn has_jumps(&self) -> bool {
        !self.jumps.is_empty()
    }

    /// From places by this trajectory to those by the one with jumps, at a time, ns.
    pub(super) fn back(&self, time_ns: i64) -> RigidTransform {
        let before = self.jumps.iter().filter(|(at_ns, _)| *at_ns <= time_ns);
        let shift: Vector3<f64> = before.map(|(_, shift)| shift).sum();
        RigidTransform::from_translation_m(shift.into())
            .unwrap_or_else(|_| RigidTransform::identity())
    }

    /// Contacts where the trajectory with jumps has them, in the middle of their frames.
    pub(super) fn contacts_back(&self, contacts: &[Contact]) -> Vec<Contact> {
        let back = |own: &Contact| {
            let mut own = own.clone();
            let [from, to] = own.stance.times_ns;
            let place = &mut own.stance.world_from_foot;
            *place = self.back(from.midpoint(to)) * *place;
            own
        };
        contacts.iter().map(back).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn jumps_are_taken_out_and_put_back() {
        let pose = |n: i64| {
            let jumped = if n >= 12 { 0.2 } else { 0.0 };
            let at = RigidTransform::from_translation_m([0.05 * n as f64, jumped, 1.3]);
            Pose::new(n * 33_000_000, at.expect("finite"))
        };
        let trajectory = Trajectory::new((0..30).map(pose).collect()).expect("rising");
        let jump = Jump {
            times_ns: [10 * 33_000_000, 13 * 33_000_000],
            shift_m: [0.0, 0.2, 0.0],
        };
        let own = Continuous::new(&trajectory, &[jump]);
        for (a, b) in own.trajectory.poses().iter().zip(trajectory.poses()) {
            assert!(a.world_from_rig.translation().y.abs() < 1e-12);
            let back = own.back(a.time_ns) * a.world_from_rig;
            let error = back.translation() - b.world_from_rig.translation();
            assert!(error.norm() < 1e-12, "{} ns", a.time_ns);
        }
    }
}
