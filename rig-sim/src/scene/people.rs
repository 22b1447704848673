//! People who walk by.
//!
//! A person is ten rigid bodies: torso, head, and two each of thigh, shin with shoe, upper arm, and forearm
//! with hand. They follow a closed path of their own at a constant speed on level ground, at the height at
//! which the lower foot touches it. Joints swing by sines of the distance walked, so poses are
//! continuous in time and the same for the same seed. Their light is computed once, as the mean over
//! places along their path: it does not turn with the sun, and they neither cast nor receive shadows.

use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};

use super::body::Body;
use super::build::Builder;
use super::bvh::Bvh;
use super::light::Light;
use super::mesh::Mesh;
use crate::so3;
use crate::walker::Side;
use crate::walker::path::Path;

pub mod shape;

use self::shape::Wardrobe;

// Lengths of someone 1.75 m tall (Drillis and Contini 1966, rounded), m.
/// Hip to knee.
const THIGH: f64 = 0.43;
/// Knee to ankle.
const SHIN: f64 = 0.43;
/// Ankle to ground.
const SOLE: f64 = 0.07;
/// From the ankle forward to where the heel touches the ground.
const HEEL: f64 = -0.055;
/// The same for the ball of the foot.
const BALL: f64 = 0.15;
/// Half the distance of the hip joints.
const HALF_HIPS: f64 = 0.09;
/// Hips to shoulders.
const SHOULDERS: f64 = 0.48;
/// Half the distance of the shoulder joints.
const HALF_SHOULDERS: f64 = 0.19;
/// Hips to neck.
const NECK: f64 = 0.54;
/// Shoulder to elbow.
const UPPER_ARM: f64 = 0.31;

/// Places along the path at which the light is taken.
const LIGHT_PLACES: u32 = 6;

/// Where and how someone walks.
#[derive(Clone, Debug, PartialEq)]
pub struct Stroll {
    /// Corners of a closed polygon in x and y, m; the way is the smooth curve that they control.
    pub points: Vec<[f64; 2]>,
    /// How far along it at time 0, as a share of a round.
    pub start: f64,
    /// m/s.
    pub speed: f64,
}

/// Part of a person.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Limb {
    /// With the hips.
    Torso,
    /// With the neck.
    Head,
    /// Left or right.
    Thigh(Side),
    /// With foot and shoe.
    Shin(Side),
    /// From the shoulder to the elbow.
    UpperArm(Side),
    /// With the hand.
    Forearm(Side),
}

/// 1 for the left, where y is positive, and -1 for the right.
fn sign(side: Side) -> f64 {
    match side {
        Side::Left => 1.0,
        Side::Right => -1.0,
    }
}

impl Limb {
    /// All ten.
    pub const ALL: [Self; 10] = [
        Self::Torso,
        Self::Head,
        Self::Thigh(Side::Left),
        Self::Thigh(Side::Right),
        Self::Shin(Side::Left),
        Self::Shin(Side::Right),
        Self::UpperArm(Side::Left),
        Self::UpperArm(Side::Right),
        Self::Forearm(Side::Left),
        Self::Forearm(Side::Right),
    ];
}

/// What all limbs of a person share.
#[derive(Debug)]
struct Walk {
    path: Path,
    start_m: f64,
    /// m/s.
    speed: f64,
    /// Stature over 1.75 m.
    scale: f64,
    /// Length of two steps, m.
    stride_m: f64,
    /// Largest angle of the thighs, rad.
    reach: f64,
    /// Looks around at this pace, Hz.
    look_hz: f64,
}

/// A limb before the light is known.
#[derive(Clone, Debug)]
pub struct Part {
    mesh: Mesh,
    walk: Arc<Walk>,
    limb: Limb,
}

/// A body that moves by itself.
#[derive(Clone, Debug)]
pub struct Moving {
    /// What it looks like, in its own frame: origin at the joint, x forward, y left, z up.
    pub body: Body,
    /// Which part of a person.
    pub limb: Limb,
    walk: Arc<Walk>,
}

impl Moving {
    /// Position and rotation that take the body's frame to the world.
    pub fn pose(&self, time_s: f64) -> (Vector3<f64>, UnitQuaternion<f64>) {
        self.walk.pose(self.limb, time_s)
    }
}

/// Adds a person.
pub fn add(b: &mut Builder, wardrobe: &Wardrobe, stroll: &Stroll) {
    let path = Path::closed(&stroll.points);
    let scale = b.draw(0.92, 1.07);
    // Steps of 0.7 m at 1.3 m/s; length by speed after Grieve 1968.
    let stride_m = 1.4 * scale * libm::pow(stroll.speed / 1.3, 0.58);
    let walk = Arc::new(Walk {
        start_m: stroll.start * path.length_m(),
        path,
        speed: stroll.speed,
        scale,
        stride_m,
        reach: libm::asin(stride_m / (4.0 * scale * (THIGH + SHIN + SOLE))),
        look_hz: b.draw(0.05, 0.12),
    });
    let look = wardrobe.choose(b);
    for limb in Limb::ALL {
        let mut mesh = shape::mesh(limb, &look);
        for corner in mesh.triangles.iter_mut().flat_map(|t| &mut t.corners) {
            corner.position *= scale;
        }
        b.parts.push(Part {
            mesh,
            walk: Arc::clone(&walk),
            limb,
        });
    }
}

impl Part {
    /// With its light.
    pub fn lit(self, light: &Light) -> Moving {
        let nothing = Bvh::new(std::iter::empty());
        let round_s = self.walk.path.length_m() / self.walk.speed;
        let mut mean = vec![[0.0; 3]; self.mesh.triangles.len()];
        for k in 0..LIGHT_PLACES {
            let time_s = round_s * f64::from(k) / f64::from(LIGHT_PLACES);
            let (position, rotation) = self.walk.pose(self.limb, time_s);
            let there = light.baked(&self.mesh.moved(&rotation, &position), &nothing);
            for (mean, there) in mean.iter_mut().flatten().zip(there.iter().flatten()) {
                *mean += there / LIGHT_PLACES as f32;
            }
        }
        Moving {
            body: Body::new(&self.mesh, &mean),
            limb: self.limb,
            walk: self.walk,
        }
    }
}

/// Angles of a leg, rad.
struct Leg {
    /// How far the thigh points forward.
    hip: f64,
    /// How far the knee is bent.
    knee: f64,
}

impl Leg {
    /// How far the lowest point of the sole lies below the hip, for someone 1.75 m tall, m.
    fn reach(&self) -> f64 {
        let shin = self.hip - self.knee;
        let (s, c) = (libm::sin(shin), libm::cos(shin));
        let ankle = THIGH * libm::cos(self.hip) + SHIN * c;
        let sole = |x: f64| ankle + SOLE * c - x * s;
        sole(HEEL).max(sole(BALL))
    }
}

/// A turn about the axis to the left: from forward to down.
fn pitch(angle: f64) -> UnitQuaternion<f64> {
    so3::exp(Vector3::y() * angle)
}

impl Walk {
    fn leg(&self, side: Side, phase: f64) -> Leg {
        let phase = match side {
            Side::Left => phase,
            Side::Right => phase + std::f64::consts::PI,
        };
        // With this share of the third harmonic the slope hardly changes for a third of the stride, and
        // with this amplitude it is the person's speed: a foot that stands goes back with the ground.
        let hip = 0.76 * self.reach * (libm::sin(phase) - libm::sin(3.0 * phase) / 18.0);
        // Bent most in the middle of the swing, a little earlier than the thigh is upright.
        let bend = 0.5 + 0.5 * libm::cos(phase + 0.5);
        Leg {
            hip,
            knee: 0.05 + 2.5 * self.reach * bend * bend,
        }
    }

    fn pose(&self, limb: Limb, time_s: f64) -> (Vector3<f64>, UnitQuaternion<f64>) {
        let gone = self.start_m + self.speed * time_s;
        let ([x, y], [dx, dy]) = self.path.at(gone);
        let phase = 2.0 * std::f64::consts::PI * gone / self.stride_m;
        let reach = [Side::Left, Side::Right]
            .map(|side| self.leg(side, phase).reach())
            .into_iter()
            .fold(0.0, f64::max);
        let hips = Vector3::new(x, y, self.scale * reach);
        let heading = so3::exp(Vector3::z() * libm::atan2(dy, dx));
        // Shoulders turn against the hips.
        let twist = so3::exp(Vector3::z() * (-0.2 * self.reach * libm::sin(phase)));
        let torso = heading * twist * pitch(0.04);
        let arm = |side: Side| {
            let leg = self.leg(side, phase);
            let shoulder = hips
                + torso * Vector3::new(0.0, sign(side) * HALF_SHOULDERS, SHOULDERS) * self.scale;
            let away = so3::exp(Vector3::x() * (0.07 * sign(side)));
            (shoulder, torso * pitch(0.9 * leg.hip) * away, leg.hip)
        };
        let thigh = |side: Side| {
            let leg = self.leg(side, phase);
            let joint =
                hips + heading * Vector3::new(0.0, sign(side) * HALF_HIPS, 0.0) * self.scale;
            (joint, heading * pitch(-leg.hip), leg.knee)
        };
        match limb {
            Limb::Torso => (hips, torso),
            Limb::Head => {
                let turn = 2.0 * std::f64::consts::PI * self.look_hz * time_s;
                let look = so3::exp(Vector3::z() * (0.35 * libm::sin(turn + self.start_m)));
                (
                    hips + torso * Vector3::z() * (NECK * self.scale),
                    heading * look,
                )
            }
            Limb::Thigh(side) => {
                let (joint, rotation, _) = thigh(side);
                (joint, rotation)
            }
            Limb::Shin(side) => {
                let (joint, rotation, knee) = thigh(side);
                (
                    joint - rotation * Vector3::z() * (THIGH * self.scale),
                    rotation * pitch(knee),
                )
            }
            Limb::UpperArm(side) => {
                let (joint, rotation, _) = arm(side);
                (joint, rotation)
            }
            Limb::Forearm(side) => {
                let (joint, rotation, hip) = arm(side);
                // Bent more while it swings forward, which it does while the leg goes back.
                (
                    joint - rotation * Vector3::z() * (UPPER_ARM * self.scale),
                    rotation * pitch(-0.4 + 0.6 * hip),
                )
            }
        }
    }
}

#[cfg(test)]
mod tests;
