//! How a foot usually moves from one contact to the next.
//!
//! Contract: the motion begins and ends at rest in the poses of the contacts, rolls over the toe
//! until it leaves the ground, and over the heel after its strike. It is a function of both
//! contacts and the dimensions of the sole alone: nothing in it is learned from a wearer.
//! Deviations from it are learned, see [`swing_habit`](crate::swing_habit).
//!
//! Sources of the shape, approximated by hand from published mean curves of healthy adults at their
//! own speed: height of the toe with 2 cm at mid-swing, Winter, "Foot trajectory in human gait",
//! Phys. Ther. 72, 1992, and Moosabhoy and Gard, Gait Posture 24, 2006; angle of the foot to the
//! ground, Perry and Burnfield, "Gait Analysis", 2nd ed., 2010.

use cad_transforms::RigidTransform;
use nalgebra::{UnitQuaternion, Vector3};

use crate::contact::Contact;
pub use crate::contact::SoleEdges;
use crate::poses::pose;

/// Phases of a swing at which shapes are known.
const NODES: usize = 11;
/// Angle of the foot, toe up, rad.
const PITCH: [f64; NODES] = [
    -1.05, -1.08, -0.95, -0.74, -0.50, -0.28, -0.09, 0.08, 0.22, 0.31, 0.33,
];
/// Height of the toe above the line from contact to contact, m.
const TOE_HEIGHT_M: [f64; NODES] = [
    0.0, 0.025, 0.040, 0.036, 0.026, 0.020, 0.029, 0.053, 0.083, 0.102, 0.091,
];
/// Progress of the toe from where it lifts to where it is at the strike.
const PROGRESS: [f64; NODES] = [
    0.0, 0.035, 0.115, 0.225, 0.350, 0.480, 0.615, 0.745, 0.865, 0.955, 1.0,
];

/// The usual motion between two contacts.
#[derive(Clone, Debug)]
pub struct UsualMotion<'a> {
    from: &'a Contact,
    to: &'a Contact,
    sole: SoleEdges,
    /// Axes of the step in the world: forward, left, up.
    axes: UnitQuaternion<f64>,
}

impl<'a> UsualMotion<'a> {
    /// From a contact to the next one of the same foot.
    pub fn new(from: &'a Contact, to: &'a Contact, sole: SoleEdges) -> Self {
        let [a, b] = [from, to].map(|contact| &contact.stance.world_from_foot);
        let step = b.translation() - a.translation();
        let heading = match step.x.hypot(step.y) > 0.1 {
            true => libm::atan2(step.y, step.x),
            false => {
                let toe = a.rotation() * Vector3::x();
                libm::atan2(toe.y, toe.x)
            }
        };
        Self {
            from,
            to,
            sole,
            axes: UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading),
        }
    }

    /// Axes of the step in the world: forward, left, up.
    pub fn axes(&self) -> UnitQuaternion<f64> {
        self.axes
    }

    /// Pose of the foot in the world at a time, s.
    pub fn at(&self, time_s: f64) -> RigidTransform {
        let (lift_s, off_s) = (self.from.heel_off.time_s, self.from.toe_off.time_s);
        let (strike_s, flat_s) = (self.to.heel_strike.time_s, self.to.foot_flat.time_s);
        let share = |from: f64, to: f64| ((time_s - from) / (to - from).max(1e-3)).clamp(0.0, 1.0);
        if time_s < off_s {
            // The heel lifts slowly at first.
            let share = share(lift_s, off_s);
            let pitch = PITCH[0] * share * share;
            return roll(&self.from.stance.world_from_foot, self.sole.toe_m, pitch);
        }
        if time_s > strike_s {
            let pitch = PITCH[NODES - 1] * (1.0 - share(strike_s, flat_s));
            return roll(&self.to.stance.world_from_foot, -self.sole.heel_m, pitch);
        }
        self.swing(share(off_s, strike_s))
    }

    /// Pose at a phase of the swing.
    fn swing(&self, phase: f64) -> RigidTransform {
        let toe = [self.sole.toe_m, 0.0, 0.0];
        let [a, b] = [&self.from, &self.to].map(|contact| contact.stance.world_from_foot);
        let at_strike = roll(&b, -self.sole.heel_m, PITCH[NODES - 1]);
        let [from, to] = [a.apply(toe), at_strike.apply(toe)].map(Vector3::from);
        let end_height = (self.sole.heel_m + self.sole.toe_m) * libm::sin(PITCH[NODES - 1]);
        // Heights are above the ground; that of the toe at the strike is in the pose already.
        let height = curve(&TOE_HEIGHT_M, phase)
            + (end_height - TOE_HEIGHT_M[NODES - 1]) * phase.powi(4)
            - end_height * curve(&PROGRESS, phase);
        let mut at = from + (to - from) * curve(&PROGRESS, phase);
        at.z += height;
        let level = a.rotation().slerp(b.rotation(), curve(&PROGRESS, phase));
        let rotation = level * turn(curve(&PITCH, phase));
        let middle = at - rotation * Vector3::from(toe);
        pose(&rotation, &middle).unwrap_or(a)
    }
}

/// A foot that has rolled about an edge of its sole, at a distance before the middle, to an angle,
/// toe up.
fn roll(world_from_foot: &RigidTransform, edge_m: f64, pitch: f64) -> RigidTransform {
    let rotation = turn(pitch);
    let edge = Vector3::new(edge_m, 0.0, 0.0);
    let shift = edge - rotation * edge;
    let Some(motion) = pose(&rotation, &shift) else {
        return *world_from_foot;
    };
    *world_from_foot * motion
}

/// Rotation of a foot by an angle, toe up.
fn turn(pitch: f64) -> UnitQuaternion<f64> {
    UnitQuaternion::from_axis_angle(&Vector3::y_axis(), -pitch)
}

/// Cubic interpolation of a curve over a phase from 0 to 1 (Catmull-Rom).
fn curve(nodes: &[f64; NODES], phase: f64) -> f64 {
    let place = phase.clamp(0.0, 1.0) * (NODES - 1) as f64;
    let k = (place as usize).min(NODES - 2);
    let t = place - k as f64;
    let slope = |k: usize| match k {
        0 => nodes[1] - nodes[0],
        _ if k == NODES - 1 => nodes[k] - nodes[k - 1],
        _ => 0.5 * (nodes[k + 1] - nodes[k - 1]),
    };
    let (a, b, c, d) = (nodes[k], nodes[k + 1], slope(k), slope(k + 1));
    let (t2, t3) = (t * t, t * t * t);
    a * (2.0 * t3 - 3.0 * t2 + 1.0)
        + c * (t3 - 2.0 * t2 + t)
        + b * (3.0 * t2 - 2.0 * t3)
        + d * (t3 - t2)
}

#[cfg(test)]
mod tests {
    use cad_transforms::Covariance;

    use super::*;
    use crate::contact::Event;
    use crate::stance::Stance;

    const SOLE: SoleEdges = SoleEdges {
        heel_m: 0.13,
        toe_m: 0.15,
    };

    pub(crate) fn contact(x: f64, z: f64, strike_s: f64) -> Contact {
        let event = |after_s: f64| Event {
            time_s: strike_s + after_s,
            sigma_s: 0.01,
            is_seen: true,
        };
        Contact {
            stance: Stance {
                observations: 0..1,
                times_ns: [0.07, 0.4].map(|after| ((strike_s + after) * 1e9) as i64),
                world_from_foot: RigidTransform::from_translation_m([x, 0.1, z]).unwrap(),
                covariance: Covariance::from_sigmas([0.003; 3], [0.01; 3]).unwrap(),
            },
            heel_strike: event(0.0),
            foot_flat: event(0.07),
            heel_off: event(0.4),
            toe_off: event(0.65),
        }
    }

    #[test]
    fn motion_is_continuous_and_stays_above_the_ground() {
        for (x, z) in [(1.4, 0.0), (0.6, 0.17), (0.6, -0.17), (0.0, 0.0)] {
            let (a, b) = (contact(0.0, 0.0, 0.0), contact(x, z, 1.1));
            let motion = UsualMotion::new(&a, &b, SOLE);
            assert_eq!(motion.at(0.3), a.stance.world_from_foot);
            assert_eq!(motion.at(1.3), b.stance.world_from_foot);
            let mut last = motion.at(0.3);
            let mut lowest = f64::INFINITY;
            for n in 300..=1200 {
                let time_s = f64::from(n) * 1e-3;
                let pose = motion.at(time_s);
                let step = (pose.translation() - last.translation()).norm();
                assert!(step < 0.006, "{x} {z} {time_s}: {step}");
                last = pose;
                let between = if x > 0.0 {
                    pose.translation().x / x
                } else {
                    0.0
                };
                let ground = z * between.clamp(0.0, 1.0);
                for edge in [SOLE.toe_m, -SOLE.heel_m] {
                    lowest = lowest.min(pose.apply([edge, 0.0, 0.0])[2] - ground);
                }
            }
            if z == 0.0 {
                assert!(lowest > -1e-9, "{lowest}");
            }
        }
    }

    #[test]
    fn toe_clears_the_ground_by_two_centimetres_at_mid_swing() {
        let (a, b) = (contact(0.0, 0.0, 0.0), contact(1.4, 0.0, 1.1));
        let motion = UsualMotion::new(&a, &b, SOLE);
        let toe = motion.at(0.5 * (0.65 + 1.1)).apply([SOLE.toe_m, 0.0, 0.0]);
        assert!((0.015..0.03).contains(&toe[2]), "{}", toe[2]);
    }
}
