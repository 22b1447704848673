//! Pedestrians.
//!
//! A person is twelve rigid bodies: torso, head, and two each of thigh, shin, foot, upper arm, and
//! forearm with hand. Each person follows a closed path at a constant speed on level ground at
//! height 0; feet are fixed where they land (`gait.rs`), legs reach from hips to feet, arms swing.
//! Poses are functions of the distance walked, so they are continuous in time and the same for the
//! same seed. Their light is computed once, as the mean over positions along the path: it does not
//! follow the sun as a person changes direction, and they neither cast nor receive shadows.

use std::sync::Arc;

use nalgebra::{UnitQuaternion, Vector3};

use super::body::Body;
use super::build::Builder;
use super::bvh::Bvh;
use super::light::Light;
use super::mesh::Mesh;
use crate::walker::Side;
use crate::walker::path::Path;
use cad_transforms::so3;

mod gait;
pub mod shape;

use self::gait::Gait;
use self::shape::Wardrobe;

// Lengths of a person 1.75 m tall (Drillis and Contini 1966, rounded), m.
/// Hip to knee.
const THIGH: f64 = 0.43;
/// Knee to ankle.
const SHIN: f64 = 0.43;
/// Ankle to ground.
const SOLE: f64 = 0.07;
/// From the ankle forward to where the heel touches the ground.
const HEEL: f64 = -0.055;
/// From the ankle forward to the ball of the foot.
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

/// Number of positions along the path at which the light is sampled.
const LIGHT_SAMPLES: u32 = 6;

/// Walk of a person.
#[derive(Clone, Debug, PartialEq)]
pub struct Stroll {
    /// Corners of a closed polygon in x and y, m: control points of the smooth path.
    pub points: Vec<[f64; 2]>,
    /// Position on the path at time 0, as a fraction of a lap.
    pub start: f64,
    /// Speed, m/s.
    pub speed: f64,
}

/// Body part of a person.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Limb {
    /// With the hips.
    Torso,
    /// With the neck.
    Head,
    /// Left or right.
    Thigh(Side),
    /// From the knee to the ankle.
    Shin(Side),
    /// With its shoe.
    Foot(Side),
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
    /// All twelve.
    pub const ALL: [Self; 12] = [
        Self::Torso,
        Self::Head,
        Self::Thigh(Side::Left),
        Self::Thigh(Side::Right),
        Self::Shin(Side::Left),
        Self::Shin(Side::Right),
        Self::Foot(Side::Left),
        Self::Foot(Side::Right),
        Self::UpperArm(Side::Left),
        Self::UpperArm(Side::Right),
        Self::Forearm(Side::Left),
        Self::Forearm(Side::Right),
    ];
}

/// Motion that all limbs of a person share.
#[derive(Debug)]
struct Walk {
    path: Path,
    start_m: f64,
    /// Speed, m/s.
    speed: f64,
    gait: Gait,
    /// Frequency of looking around, Hz.
    look_hz: f64,
}

/// A limb before lighting.
#[derive(Clone, Debug)]
pub struct Part {
    mesh: Mesh,
    walk: Arc<Walk>,
    limb: Limb,
}

/// A moving body.
#[derive(Clone, Debug)]
pub struct Moving {
    /// Geometry in its own frame: origin at the joint, x forward, y left, z up.
    pub body: Body,
    /// Body part.
    pub limb: Limb,
    walk: Arc<Walk>,
}

impl Moving {
    /// Position and rotation that map the body frame to the world.
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
        gait: Gait { stride_m, scale },
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
    /// The limb with its lighting.
    pub fn lit(self, light: &Light) -> Moving {
        let nothing = Bvh::new(std::iter::empty());
        let round_s = self.walk.path.length_m() / self.walk.speed;
        let mut mean = vec![[0.0; 3]; self.mesh.triangles.len()];
        for k in 0..LIGHT_SAMPLES {
            let time_s = round_s * f64::from(k) / f64::from(LIGHT_SAMPLES);
            let (position, rotation) = self.walk.pose(self.limb, time_s);
            let there = light.baked(&self.mesh.transformed(&rotation, &position), &nothing);
            for (mean, there) in mean.iter_mut().flatten().zip(there.iter().flatten()) {
                *mean += there / LIGHT_SAMPLES as f32;
            }
        }
        Moving {
            body: Body::new(&self.mesh, &mean),
            limb: self.limb,
            walk: self.walk,
        }
    }
}

/// Rotation about the axis to the left: from forward to down.
fn pitch(angle: f64) -> UnitQuaternion<f64> {
    so3::exp(Vector3::y() * angle)
}

impl Walk {
    fn pose(&self, limb: Limb, time_s: f64) -> (Vector3<f64>, UnitQuaternion<f64>) {
        let walked_m = self.start_m + self.speed * time_s;
        let scale = self.gait.scale;
        let ([x, y], [dx, dy]) = self.path.at(walked_m);
        let hips = Vector3::new(x, y, self.gait.hips(walked_m));
        let heading = so3::exp(Vector3::z() * libm::atan2(dy, dx));
        // Shoulders rotate against the hips.
        let turn = -0.07 * self.gait.swing(Side::Left, walked_m);
        let torso = heading * so3::exp(Vector3::z() * turn) * pitch(0.04);
        let leg = |side: Side| {
            let joint = hips + heading * Vector3::y() * (sign(side) * HALF_HIPS * scale);
            let foot = self.gait.foot(&self.path, side, walked_m);
            let [thigh, shin] = gait::leg(&joint, &foot.ankle, &heading, scale);
            (joint, thigh, shin, foot)
        };
        let arm = |side: Side| {
            let shoulder = Vector3::new(0.0, sign(side) * HALF_SHOULDERS, SHOULDERS);
            let swing = 0.38 * self.gait.swing(side, walked_m);
            let away = so3::exp(Vector3::x() * (0.07 * sign(side)));
            let upper = torso * pitch(0.9 * swing - 0.05) * away;
            (hips + torso * shoulder * scale, upper, swing)
        };
        match limb {
            Limb::Torso => (hips, torso),
            Limb::Head => {
                let turn = 2.0 * std::f64::consts::PI * self.look_hz * time_s;
                let look = so3::exp(Vector3::z() * (0.35 * libm::sin(turn + self.start_m)));
                (hips + torso * Vector3::z() * (NECK * scale), heading * look)
            }
            Limb::Thigh(side) => {
                let (joint, thigh, _, _) = leg(side);
                (joint, thigh)
            }
            Limb::Shin(side) => {
                let (joint, thigh, shin, _) = leg(side);
                (joint - thigh * Vector3::z() * (THIGH * scale), shin)
            }
            Limb::Foot(side) => {
                let (_, _, _, foot) = leg(side);
                (foot.ankle, foot.rotation)
            }
            Limb::UpperArm(side) => {
                let (joint, upper, _) = arm(side);
                (joint, upper)
            }
            Limb::Forearm(side) => {
                let (joint, upper, swing) = arm(side);
                // Flexed more while it swings forward, opposite to the leg.
                (
                    joint - upper * Vector3::z() * (UPPER_ARM * scale),
                    upper * pitch(-0.4 + 0.6 * swing),
                )
            }
        }
    }
}

#[cfg(test)]
mod tests;
