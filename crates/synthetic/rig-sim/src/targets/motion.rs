//! Motion of a rig that is carried in front of the boards.
//!
//! Contract: a function of cameras, boards, plan, length and seed. The rig is at rest for
//! [`DWELL_S`] in each view, where a camera has a board at a chosen position of its image, at
//! changing distances and rolls; cameras alternate, and the positions fill each image evenly. Every
//! third view of a camera shows two boards, from farther back. Transfers between views are smooth,
//! within [`Limits`]. After every fifth view the rig is rotated about one axis and translated along
//! another, back and forth. The rig is never exactly at rest: hands tremble.

use nalgebra::{UnitQuaternion, Vector3};

use super::board::Board;
use super::{HOME, Motion, Plan};
use crate::lens::Lens;
use crate::random;
use crate::rig::SimCamera;
use crate::spline::Spline;
use crate::walker::KNOT_S;
use cad_transforms::so3;

/// Time at rest in a view, s.
pub const DWELL_S: f64 = 0.55;
/// Excitation: duration, s; amplitudes of rotation and translation, rad and m; frequencies, Hz.
const SWING_S: f64 = 3.2;
const SWING: (f64, f64) = (0.28, 0.05);
const SWING_HZ: (f64, f64) = (0.7, 1.1);
/// Time in which an excitation grows and decays, s.
const FADE_S: f64 = 0.8;
/// Tremor, m and rad, each the sum of three waves.
const TREMOR: (f64, f64) = (2e-4, 2e-4);
/// Minimum distance of a board's middle from the image edge, as a fraction of the image size.
const MIN_EDGE_MARGIN: f64 = 0.06;
/// Maximum rotation of the rig from its start, rad.
const MAX_ROTATION_RAD: f64 = 1.15;
/// Number of views per excitation.
const VIEWS_PER_SWING: usize = 5;

/// Limits of the motion between views.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Maximum angular rate, rad/s.
    pub rate: f64,
    /// Maximum acceleration, m/s².
    pub acceleration: f64,
    /// Minimum duration, s.
    pub min_s: f64,
}

impl Limits {
    /// Limits of a kind of motion.
    pub const fn of(motion: Motion) -> Self {
        match motion {
            Motion::Varied | Motion::Parallel => Self {
                rate: 1.3,
                acceleration: 3.5,
                min_s: 0.5,
            },
            Motion::Still => Self {
                rate: 0.35,
                acceleration: 0.4,
                min_s: 1.0,
            },
        }
    }
}

type Pose = (Vector3<f64>, UnitQuaternion<f64>);

/// A part of the course.
#[derive(Clone, Copy, Debug)]
enum Part {
    Hold(Pose),
    Transfer(Pose, Pose),
    Swing {
        at: Pose,
        /// Axis of the rotation; the translation is along the next one.
        axis: usize,
        turns: bool,
    },
}

/// Parts with their begin times, s.
struct Course {
    parts: Vec<(f64, Part)>,
    end_s: f64,
}

/// Generator of views.
struct Views<'a> {
    cameras: &'a [SimCamera],
    boards: &'a [Board],
    facing: &'a [usize],
    motion: Motion,
    seed: u64,
}

/// Motion of the rig for `seconds`, as used by [`crate::walker::Walker`].
pub(crate) fn spline(
    cameras: &[SimCamera],
    boards: &[Board],
    facing: &[usize],
    plan: &Plan,
    seconds: f64,
    seed: u64,
) -> Spline {
    let views = Views {
        cameras,
        boards,
        facing,
        motion: plan.motion,
        seed,
    };
    let course = course(&views, plan, seconds + 2.0);
    let count = ((seconds + 2.0) / KNOT_S).ceil() as usize + 4;
    let controls = (0..count).map(|i| {
        // The first control is before the start.
        let t = (i as f64 - 1.0) * KNOT_S;
        let (position, rotation) = course.at(t.max(0.0));
        let (shift, turn) = tremor(seed, t);
        match plan.motion {
            Motion::Parallel => (position + shift, rotation),
            _ => (position + shift, rotation * so3::exp(turn)),
        }
    });
    Spline::new(KNOT_S, controls.collect())
}

fn course(views: &Views<'_>, plan: &Plan, seconds: f64) -> Course {
    let limits = Limits::of(plan.motion);
    let home = (Vector3::from(HOME), UnitQuaternion::identity());
    let mut course = Course {
        parts: Vec::new(),
        end_s: 0.0,
    };
    course.push(Part::Hold(home), DWELL_S);
    let mut here = home;
    let mut swings = 0;
    for n in 0..plan.views.unwrap_or(usize::MAX) {
        if course.end_s > seconds {
            break;
        }
        let there = views.view(n);
        course.push(Part::Transfer(here, there), limits.time_s(&here, &there));
        course.push(Part::Hold(there), DWELL_S);
        here = there;
        if plan.motion != Motion::Still && n % VIEWS_PER_SWING == VIEWS_PER_SWING - 1 {
            let swing = Part::Swing {
                at: there,
                axis: swings % 3,
                turns: plan.motion != Motion::Parallel,
            };
            course.push(swing, SWING_S);
            swings += 1;
        }
    }
    course.parts.push((course.end_s, Part::Hold(here)));
    course
}

impl Limits {
    /// Duration of a transfer, s: that of [`smooth`] whose maximum speed and acceleration are
    /// within the limits.
    fn time_s(&self, from: &Pose, to: &Pose) -> f64 {
        let (far, turned) = ((to.0 - from.0).norm(), from.1.angle_to(&to.1));
        let by_rate = 1.875 * turned / self.rate;
        let by_force = (5.774 * far / self.acceleration).sqrt();
        by_rate.max(by_force).max(self.min_s)
    }
}

impl Course {
    fn push(&mut self, part: Part, length_s: f64) {
        self.parts.push((self.end_s, part));
        self.end_s += length_s;
    }

    fn at(&self, time_s: f64) -> Pose {
        let next = self
            .parts
            .partition_point(|(begin, _)| *begin <= time_s)
            .max(1);
        let (begin, part) = self.parts[next - 1];
        let end = self.parts.get(next).map_or(self.end_s, |(begin, _)| *begin);
        let since = time_s - begin;
        match part {
            Part::Hold(pose) => pose,
            Part::Transfer((p, q), (to_p, to_q)) => {
                let s = smooth(since / (end - begin));
                let turn = so3::log(&(q.inverse() * to_q));
                (p + (to_p - p) * s, q * so3::exp(turn * s))
            }
            Part::Swing {
                at: (p, q),
                axis,
                turns,
            } => {
                let left = end - begin - since;
                let size = smooth(since / FADE_S) * smooth(left / FADE_S);
                let wave = |hz: f64| libm::sin(2.0 * std::f64::consts::PI * hz * since);
                let unit = |k: usize| Vector3::<f64>::ith(k % 3, 1.0);
                let angle = if turns { SWING.0 } else { 0.0 };
                let turn = unit(axis) * (angle * size * wave(SWING_HZ.0));
                let push = unit(axis + 1) * (SWING.1 * size * wave(SWING_HZ.1));
                (p + push, q * so3::exp(turn))
            }
        }
    }
}

impl Views<'_> {
    /// Pose of the rig in its `n`-th view.
    fn view(&self, n: usize) -> Pose {
        let camera = n % self.cameras.len();
        let round = n / self.cameras.len();
        let own = self.facing[camera];
        let draw = |k: u64, from: f64, to: f64| {
            let index = 16 * n as u64 + k;
            from + (to - from) * random::uniform(self.seed, random::WALK + 0x40, index)
        };
        let home = Vector3::from(HOME);
        if self.motion == Motion::Parallel {
            let place = Vector3::new(draw(0, -0.3, 0.3), draw(1, -0.45, 0.45), draw(2, -0.3, 0.3));
            return (home + place, UnitQuaternion::identity());
        }
        // Positions that fill the image evenly: Roberts' R2 sequence, 2018.
        let spread = |step: f64, k: u64| {
            let v = random::uniform(self.seed, random::WALK + 0x41, 2 * camera as u64 + k)
                + step * round as f64;
            MIN_EDGE_MARGIN + (1.0 - 2.0 * MIN_EDGE_MARGIN) * (v - v.floor())
        };
        let part = [
            spread(0.754_877_666_246_693, 0),
            spread(0.569_840_290_998_053, 1),
        ];
        let is_pair = round % 3 == 2 && self.boards.len() > 1;
        let middle = |board: usize| self.boards[board].pose().0;
        let place = match is_pair {
            true => Vector3::new(
                draw(0, -0.75, -0.45),
                draw(1, -0.2, 0.2),
                draw(2, -0.1, 0.2),
            ),
            false => Vector3::new(draw(0, -0.3, 0.2), draw(1, -0.3, 0.3), draw(2, -0.2, 0.2)),
        };
        let roll = draw(3, -0.55, 0.55);
        let position = home + place;
        // The own board alone, or the middle between it and another one that is not too far around.
        let others = (1..self.boards.len()).map(|k| (own + k + round / 3) % self.boards.len());
        let others: Vec<usize> = others.filter(|other| *other != own).collect();
        let pairs = others
            .iter()
            .map(|&other| (0.5 * (middle(own) + middle(other)), [0.5; 2]));
        let alone = [(middle(own), part), (middle(own), [0.5; 2])];
        let wanted: Vec<(Vector3<f64>, [f64; 2])> = match is_pair {
            true => pairs.chain(alone).collect(),
            false => alone.to_vec(),
        };
        let aimed = wanted.iter().flat_map(|(goal, part)| {
            [roll, 0.4 * roll, 0.0]
                .map(|roll| (position, self.aim(camera, &position, goal, *part, roll)))
        });
        let near = |pose: &Pose| pose.1.angle() <= MAX_ROTATION_RAD;
        aimed
            .into_iter()
            .find(near)
            .unwrap_or((position, UnitQuaternion::identity()))
    }

    /// Rotation of the rig, at a given position, that projects a world point to an image position
    /// of a camera, with a `roll` of the camera about the ray; otherwise the smallest one.
    fn aim(
        &self,
        camera: usize,
        position: &Vector3<f64>,
        goal: &Vector3<f64>,
        part: [f64; 2],
        roll: f64,
    ) -> UnitQuaternion<f64> {
        let camera = &self.cameras[camera];
        let model = &camera.models[0];
        let pixel = |part: f64, size: u32| part * f64::from(size) - 0.5;
        let (x, y) =
            Lens::new(model).unproject(pixel(part[0], model.width), pixel(part[1], model.height));
        let eye = camera.rig_from_eye[0];
        let ray = eye.rotation() * Vector3::new(x, y, 1.0).normalize();
        let mut rotation = UnitQuaternion::identity();
        let mut rolled = false;
        for _ in 0..8 {
            let arm = goal - (position + rotation * eye.translation());
            let (from, to) = (rotation * ray, arm.normalize());
            rotation = least_turn(&from, &to) * rotation;
            if !rolled {
                rotation = so3::exp(to * roll) * rotation;
                rolled = true;
            }
        }
        rotation
    }
}

/// The smallest rotation that maps one direction to another.
fn least_turn(from: &Vector3<f64>, to: &Vector3<f64>) -> UnitQuaternion<f64> {
    let axis = from.cross(to);
    let sine = axis.norm();
    if sine < 1e-12 {
        return UnitQuaternion::identity();
    }
    so3::exp(axis * (libm::atan2(sine, from.dot(to)) / sine))
}

/// 0 to 1 with no speed and no acceleration at the ends.
fn smooth(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * t * (10.0 + t * (6.0 * t - 15.0))
}

/// Tremor of the hands, m and rad.
fn tremor(seed: u64, time_s: f64) -> (Vector3<f64>, Vector3<f64>) {
    let wave = |k: u64| {
        (0..3).fold(0.0, |sum, j| {
            let draw = |n| random::uniform(seed, random::WALK + 0x42, 6 * k + 2 * j + n);
            let hz = 0.5 + 3.0 * draw(0);
            sum + libm::sin(2.0 * std::f64::consts::PI * (hz * time_s + draw(1)))
        })
    };
    let vector = |k: u64, size: f64| Vector3::new(wave(k), wave(k + 1), wave(k + 2)) * size;
    (vector(0, TREMOR.0), vector(3, TREMOR.1))
}
