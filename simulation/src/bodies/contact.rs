//! Where bodies touch.

use rapier3d::prelude::{PhysicsWorld, RigidBodyHandle};

use super::single::vector_f64;

/// A point at which a body touches something.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyContact {
    /// The point on the body, in the world, m. It and the gap were found at the begin of the last
    /// step and moved with the body since.
    pub point_m: [f64; 3],
    /// Unit vector from what it touches to the body, in the world.
    pub normal: [f64; 3],
    /// Distance along the normal, m; negative where the body is inside of what it touches.
    pub gap_m: f64,
    /// Force along the normal, N.
    pub force_n: f64,
}

/// Contacts of a body that carry a force, or whose gap is closed.
pub(super) fn contacts(
    world: &PhysicsWorld,
    body: RigidBodyHandle,
    step_s: f64,
) -> Vec<BodyContact> {
    let mut found = Vec::new();
    for collider in world.bodies[body].colliders() {
        for pair in world.narrow_phase.contact_pairs_with(*collider) {
            let is_first = pair.collider1 == *collider;
            let pose = world.colliders[*collider].position();
            for manifold in pair.solver_manifolds() {
                let subshape = match is_first {
                    true => manifold.subshape_pos1(),
                    false => manifold.subshape_pos2(),
                };
                let sign = if is_first { -1.0 } else { 1.0 };
                for point in &manifold.points {
                    let local = if is_first {
                        point.local_p1
                    } else {
                        point.local_p2
                    };
                    let local = subshape.map_or(local, |own| own.transform_point(local));
                    let force_n = f64::from(point.data.impulse) / step_s;
                    if point.dist > 0.0 && force_n == 0.0 {
                        continue;
                    }
                    found.push(BodyContact {
                        point_m: vector_f64(pose.transform_point(local)),
                        normal: vector_f64(manifold.data.normal * sign),
                        gap_m: f64::from(point.dist),
                        force_n,
                    });
                }
            }
        }
    }
    found
}
