//! True poses of the rig.

use std::sync::Arc;

use cad_transforms::RigidTransform;
use rig_sim::simulation::Simulation;

/// Source of true poses.
#[derive(Clone, Debug)]
pub enum Truth {
    /// Measured poses at times, ns, ascending.
    Measured(Vec<(i64, RigidTransform)>),
    /// Poses of a walk, at any time.
    Walk(Arc<Simulation>),
}

impl Truth {
    /// `world_from_rig`, interpolated linearly in position and rotation between measured poses;
    /// `None` before the first, after the last, and for a rotation of 180° between two.
    pub fn at(&self, time_ns: i64) -> Option<RigidTransform> {
        match self {
            Self::Walk(simulation) => {
                let end_ns = (simulation.settings().seconds * 1e9) as i64;
                let (p, q) = simulation.world_from_rig(time_ns);
                (0..=end_ns).contains(&time_ns).then(|| {
                    RigidTransform::from_wxyz([q.w, q.i, q.j, q.k], p.into())
                        .expect("the pose of a walker is finite")
                })
            }
            Self::Measured(poses) => {
                let next = poses.partition_point(|(t, _)| *t < time_ns);
                let (to_ns, to) = poses.get(next)?;
                if *to_ns == time_ns {
                    return Some(*to);
                }
                let (from_ns, from) = poses.get(next.checked_sub(1)?)?;
                let share = (time_ns - from_ns) as f64 / (to_ns - from_ns) as f64;
                let p = from.translation().lerp(to.translation(), share);
                let q = from.rotation().try_slerp(to.rotation(), share, 1e-9)?;
                RigidTransform::from_wxyz([q.w, q.i, q.j, q.k], p.into()).ok()
            }
        }
    }

    /// All measured poses; empty for a walk, which is known at any time.
    pub fn measured(&self) -> &[(i64, RigidTransform)] {
        match self {
            Self::Measured(poses) => poses,
            Self::Walk(_) => &[],
        }
    }

    /// The walk, with all ground truth.
    pub fn simulation(&self) -> Option<&Arc<Simulation>> {
        match self {
            Self::Walk(simulation) => Some(simulation),
            Self::Measured(_) => None,
        }
    }
}
