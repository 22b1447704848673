//! Initial poses of cameras and targets from poses of single views.
//!
//! Contract: nominal extrinsics are taken as they are; without any, the first camera is the origin
//! of the rig ([`Input::origin`]). Poses propagate through instants at which a known and an unknown
//! element are observed together. Of several candidates the medoid is taken (the one nearest to all
//! others), so that single wrong poses do no harm. Elements that cannot be reached stay unknown.

use cad_transforms::RigidTransform;

use super::config::PoseGraphConfig;
use super::input::{Camera, Input};

/// Pose of one target in one eye.
#[derive(Clone, Copy, Debug)]
pub(super) struct PosedView {
    pub(super) instant: usize,
    pub(super) eye: usize,
    pub(super) target: usize,
    pub(super) eye_from_target: RigidTransform,
    /// Number of corners behind the pose; 0 if it may be the mirrored solution.
    pub(super) trust: usize,
}

/// Initial poses.
#[derive(Clone, Debug)]
pub(super) struct InitialPoses {
    /// `rig_from_left` by camera.
    pub(super) cameras: Vec<Option<RigidTransform>>,
    /// `left_from_right` by camera.
    pub(super) pairs: Vec<Option<RigidTransform>>,
    /// `world_from_target` by target; the world is the target observed most often.
    pub(super) targets: Vec<Option<RigidTransform>>,
    /// Index of the world target.
    pub(super) world: usize,
    /// `rig_from_world` by instant.
    pub(super) instants: Vec<Option<RigidTransform>>,
}

/// The candidate nearest to all others.
fn medoid(candidates: &[RigidTransform], config: &PoseGraphConfig) -> Option<RigidTransform> {
    let step = candidates.len().div_ceil(config.max_candidates).max(1);
    let few: Vec<&RigidTransform> = candidates.iter().step_by(step).collect();
    let apart = |a: &RigidTransform, b: &RigidTransform| {
        let off = a.inverse() * *b;
        (off.distance_m() + config.metres_per_radian * off.angle_rad()).min(config.max_distance_m)
    };
    let sum = |a: &RigidTransform| few.iter().map(|b| apart(a, b)).sum::<f64>();
    let sums: Vec<f64> = few.iter().map(|a| sum(a)).collect();
    let least = (0..few.len()).min_by(|&a, &b| sums[a].total_cmp(&sums[b]))?;
    Some(*few[least])
}

/// Propagates poses until no further one is found.
pub(super) fn connect(
    input: &Input,
    posed: &[PosedView],
    config: &PoseGraphConfig,
) -> InitialPoses {
    let origin = input.origin();
    let mut seen = vec![0usize; input.targets.len()];
    // Everything that is connected with the origin can be reached from a target that the origin
    // observes.
    for p in posed {
        let counts = origin.is_none_or(|origin| input.cameras[origin].left == p.eye);
        seen[p.target] += usize::from(counts);
    }
    let world = (0..seen.len())
        .max_by_key(|&t| (seen[t], std::cmp::Reverse(t)))
        .unwrap_or(0);
    let mut known = InitialPoses {
        cameras: input
            .cameras
            .iter()
            .map(|c| c.rig_from_left.as_ref().map(|t| t.transform))
            .collect(),
        pairs: input
            .cameras
            .iter()
            .map(|camera| pair(camera, posed, config))
            .collect(),
        targets: vec![None; input.targets.len()],
        world,
        instants: vec![None; input.times_ns.len()],
    };
    if let Some(target) = known.targets.get_mut(world) {
        *target = Some(RigidTransform::identity());
    }
    if let Some(origin) = origin {
        known.cameras[origin] = Some(RigidTransform::body_from_optical());
    }
    while propagate(input, posed, &mut known, config) {}
    known
}

/// `left_from_right` from instants at which both eyes observe a target; otherwise the nominal
/// value.
fn pair(camera: &Camera, posed: &[PosedView], config: &PoseGraphConfig) -> Option<RigidTransform> {
    let right = camera.right?;
    let of = |eye: usize| posed.iter().filter(move |p| p.eye == eye && p.trust > 0);
    let candidates: Vec<RigidTransform> = of(camera.left)
        .filter_map(|l| {
            let r = of(right).find(|r| (r.instant, r.target) == (l.instant, l.target))?;
            Some(l.eye_from_target * r.eye_from_target.inverse())
        })
        .collect();
    medoid(&candidates, config).or_else(|| camera.left_from_right.as_ref().map(|t| t.transform))
}

impl InitialPoses {
    /// `rig_from_eye`.
    pub(super) fn eye(&self, input: &Input, eye: usize) -> Option<RigidTransform> {
        let number = input.camera_of(eye)?;
        let rig_from_left = self.cameras[number]?;
        match input.cameras[number].left == eye {
            true => Some(rig_from_left),
            false => Some(rig_from_left * self.pairs[number]?),
        }
    }
}

/// One round of propagation; true if a pose was added.
fn propagate(
    input: &Input,
    posed: &[PosedView],
    known: &mut InitialPoses,
    config: &PoseGraphConfig,
) -> bool {
    let mut changed = false;
    // The view with most corners gives the pose of the rig.
    let mut trusted: Vec<&PosedView> = posed.iter().collect();
    trusted.sort_by_key(|p| (p.instant, std::cmp::Reverse(p.trust), p.eye, p.target));
    for p in trusted {
        if known.instants[p.instant].is_some() {
            continue;
        }
        if let (Some(rig_from_eye), Some(world_from_target)) =
            (known.eye(input, p.eye), known.targets[p.target])
        {
            known.instants[p.instant] =
                Some(rig_from_eye * p.eye_from_target * world_from_target.inverse());
            changed = true;
        }
    }
    for target in 0..known.targets.len() {
        if known.targets[target].is_some() {
            continue;
        }
        let candidates: Vec<RigidTransform> = posed
            .iter()
            .filter(|p| p.target == target && p.trust > 0)
            .filter_map(|p| {
                let rig_from_world = known.instants[p.instant]?;
                Some(rig_from_world.inverse() * known.eye(input, p.eye)? * p.eye_from_target)
            })
            .collect();
        known.targets[target] = medoid(&candidates, config);
        changed |= known.targets[target].is_some();
    }
    for number in 0..known.cameras.len() {
        if known.cameras[number].is_some() {
            continue;
        }
        let left = input.cameras[number].left;
        let candidates: Vec<RigidTransform> = posed
            .iter()
            .filter(|p| p.eye == left && p.trust > 0)
            .filter_map(|p| {
                let rig_from_world = known.instants[p.instant]?;
                let world_from_target = known.targets[p.target]?;
                Some(rig_from_world * world_from_target * p.eye_from_target.inverse())
            })
            .collect();
        known.cameras[number] = medoid(&candidates, config);
        changed |= known.cameras[number].is_some();
    }
    changed
}
