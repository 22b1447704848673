//! What an eye really sees, and where that goes.
//!
//! Contract: there is no blur, no noise and no exposure; each row is taken at its own instant, the middle
//! of its exposure. [`TrueEye::see`] says what the ray of each pixel's centre meets first. Panes count as
//! what is seen. [`TrueEye::flow`] follows that to the picture of another time, through lens, shutter and
//! everything that moves. Which surface a pixel sees is the rasteriser's answer, true to its 0.1 px at
//! edges; all that is computed on that surface is f64.

use calib::CameraModel;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::placed::{Placed, Still};
use super::raster::{NOTHING, View, Visibility};
use super::{Shutter, shade};
use crate::lens::Lens;
use crate::scene::Scene;
use crate::scene::body::Surface;
use crate::scene::surface::Class;

/// What is nearer to the eye than this is behind it, m.
const NEAR_M: f64 = 0.03;
/// A point is hidden by what is nearer by this share and this length: more than facets and f32 need.
const HIDES: (f64, f64) = (1e-3, 1e-3);

/// Position and rotation that take a frame to the world.
pub type Pose = (Vector3<f64>, UnitQuaternion<f64>);

/// What each pixel sees at one time; rows first.
#[derive(Clone, Debug)]
pub struct Truth {
    /// Distance along the optical axis, m; infinite for the sky.
    pub depth: Vec<f32>,
    /// What it is.
    pub class: Vec<Class>,
    /// Which thing; 0 for the sky.
    pub instance: Vec<u16>,
    /// Triangle among those of all bodies, panes last; [`NOTHING`] for the sky.
    triangle: Vec<u32>,
    /// Of each body, panes last: for all rows, or for each.
    looks: Vec<Vec<Look>>,
}

/// Where what each pixel sees is in the picture of another time; rows first.
#[derive(Clone, Debug, PartialEq)]
pub struct Flow {
    /// To the right and down, px. Not a number where the point is behind the lens then, or farther
    /// outside the picture than the lens is known. The sky is infinitely far away.
    pub moved: Vec<[f32; 2]>,
    /// Whether the other picture shows the point: it is inside and nothing is before it.
    pub shown: Vec<bool>,
}

/// A point in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spot {
    /// px.
    pub u: f64,
    /// px.
    pub v: f64,
    /// Whether it is inside the picture and nothing is before it.
    pub shown: bool,
}

/// Where the eye is in a body's frame.
#[derive(Clone, Copy, Debug)]
struct Look {
    /// Optical centre, m.
    origin: Vector3<f64>,
    /// Takes vectors in the optical frame to the body's.
    turn: Matrix3<f64>,
}

/// Something that does not change in a body's frame.
#[derive(Clone, Copy)]
enum Thing {
    Point(Vector3<f64>),
    /// Infinitely far away.
    Direction(Vector3<f64>),
}

/// Where a thing is seen.
struct Found {
    u: f64,
    v: f64,
    /// In the optical frame.
    at: Vector3<f64>,
    /// Row whose instant this is.
    row: usize,
}

/// An eye without a sensor.
#[derive(Debug)]
pub struct TrueEye {
    lens: Lens,
    shutter: Shutter,
    rays: Vec<[f32; 2]>,
    visibility: Visibility,
}

impl TrueEye {
    /// An eye with this lens and shutter.
    pub fn new(model: &CameraModel, shutter: Shutter) -> Self {
        let lens = Lens::new(model);
        Self {
            rays: lens.rays((0.0, 0.0)),
            visibility: Visibility::new(&lens),
            lens,
            shutter,
        }
    }

    /// What the pixels see at a time, s. `eye_pose` is that of the optical frame in the world; the
    /// first body is [`Scene::fixed`], at the world's origin.
    pub fn see(
        &mut self,
        scene: &Scene,
        placed: &[Placed<'_>],
        eye_pose: &dyn Fn(f64) -> Pose,
        time_s: f64,
    ) -> Truth {
        let bodies = with_panes(scene, placed);
        let looks = self.looks(&bodies, eye_pose, time_s);
        self.visibility.clear();
        for (body, looks) in bodies.iter().zip(&looks) {
            let views: Vec<View> = looks.iter().map(Look::view).collect();
            self.visibility
                .draw(body.body, body.first, &self.lens, (0.0, 0.0), &views);
        }
        let count = self.rays.len();
        let mut truth = Truth {
            depth: vec![f32::INFINITY; count],
            class: vec![Class::Sky; count],
            instance: vec![0; count],
            triangle: self.visibility.triangle.clone(),
            looks,
        };
        for (i, &id) in self.visibility.triangle.iter().enumerate() {
            if id == NOTHING {
                continue;
            }
            let (body, surface) = surface(&bodies, id);
            let look = row_of(&truth.looks[body], i / self.visibility.width);
            truth.depth[i] = look.depth(surface, &self.ray(i)) as f32;
            truth.class[i] = shade::class(scene, surface);
            truth.instance[i] = surface.instance;
        }
        truth
    }

    /// Where what each pixel sees in the picture `from` is in the picture `to`. Both were seen by this
    /// eye, in this scene with these bodies.
    pub fn flow(&self, scene: &Scene, placed: &[Placed<'_>], from: &Truth, to: &Truth) -> Flow {
        let bodies = with_panes(scene, placed);
        let width = self.visibility.width;
        let pixels = (0..self.rays.len()).map(|i| {
            let id = from.triangle[i];
            let (row, ray) = (i / width, self.ray(i));
            let (body, thing) = if id == NOTHING {
                let look = row_of(&from.looks[0], row);
                (0, Thing::Direction(look.turn * ray))
            } else {
                let (body, surface) = surface(&bodies, id);
                let look = row_of(&from.looks[body], row);
                let reach = look.depth(surface, &ray);
                (body, Thing::Point(look.origin + look.turn * ray * reach))
            };
            match self.find(&to.looks[body], thing, row) {
                None => ([f32::NAN; 2], false),
                Some(found) => {
                    let moved = [
                        (found.u - (i % width) as f64) as f32,
                        (found.v - row as f64) as f32,
                    ];
                    (moved, self.shows(&bodies, to, thing, &found))
                }
            }
        });
        let (moved, shown) = pixels.unzip();
        Flow { moved, shown }
    }

    /// Where a picture has a point of body number `body`, or `None` where it is behind the lens or
    /// farther outside the picture than the lens is known.
    pub fn spot(
        &self,
        scene: &Scene,
        placed: &[Placed<'_>],
        truth: &Truth,
        body: usize,
        point: Vector3<f64>,
    ) -> Option<Spot> {
        let thing = Thing::Point(point);
        let found = self.find(&truth.looks[body], thing, self.visibility.height / 2)?;
        let shown = self.shows(&with_panes(scene, placed), truth, thing, &found);
        Some(Spot {
            u: found.u,
            v: found.v,
            shown,
        })
    }

    /// The direction of a pixel's centre, 1 long along the optical axis.
    fn ray(&self, pixel: usize) -> Vector3<f64> {
        let [x, y] = self.rays[pixel];
        Vector3::new(f64::from(x), f64::from(y), 1.0)
    }

    /// Where the eye is in the frames of bodies: once, or for each row.
    fn looks(
        &self,
        bodies: &[Placed<'_>],
        eye_pose: &dyn Fn(f64) -> Pose,
        time_s: f64,
    ) -> Vec<Vec<Look>> {
        let height = self.visibility.height;
        let rows = match self.shutter {
            Shutter::Global => 1,
            Shutter::Rolling { .. } => height,
        };
        let times = (0..rows).map(|row| time_s + self.shutter.row_s(row, height));
        let eyes: Vec<(f64, Pose)> = times.map(|t| (t, eye_pose(t))).collect();
        let of = |body: &Placed<'_>| {
            let look = |(t, eye): &(f64, Pose)| Look::new(eye, &body.pose.at(*t));
            eyes.iter().map(look).collect()
        };
        bodies.iter().map(of).collect()
    }

    /// Looks for a thing, first in the row `start`. A rolling shutter takes each row at its own
    /// instant, so the row has to be found that sees the thing at the time it is exposed; between two
    /// rows motion is even.
    fn find(&self, looks: &[Look], thing: Thing, start: usize) -> Option<Found> {
        let seen = |row: usize| {
            let look = &looks[row.min(looks.len() - 1)];
            let at = look.locate(thing);
            let (x, y) = (at.x / at.z, at.y / at.z);
            (at.z > NEAR_M && self.lens.is_known(x, y)).then(|| {
                let (u, v) = self.lens.project(x, y);
                Found { u, v, at, row }
            })
        };
        if looks.len() < 2 {
            return seen(0);
        }
        let mut row = start.min(looks.len() - 2);
        for _ in 0..4 {
            row = seen(row)?.v.clamp(0.0, (looks.len() - 2) as f64) as usize;
        }
        let (a, b) = (seen(row)?, seen(row + 1)?);
        let part = (a.v - row as f64) / (1.0 - (b.v - a.v));
        Some(Found {
            u: a.u + (b.u - a.u) * part,
            v: a.v + (b.v - a.v) * part,
            at: a.at + (b.at - a.at) * part,
            row,
        })
    }

    /// Whether a picture shows a thing that is found there: the surface that the nearest pixel sees,
    /// continued to the spot, is not before it.
    fn shows(&self, bodies: &[Placed<'_>], truth: &Truth, thing: Thing, found: &Found) -> bool {
        let (width, height) = (self.visibility.width, self.visibility.height);
        let (column, row) = ((found.u + 0.5).floor(), (found.v + 0.5).floor());
        let inside = |v: f64, size: usize| v >= 0.0 && v < size as f64;
        if !inside(column, width) || !inside(row, height) {
            return false;
        }
        let id = truth.triangle[row as usize * width + column as usize];
        if id == NOTHING {
            return true;
        }
        let Thing::Point(_) = thing else {
            return false;
        };
        let (body, surface) = surface(bodies, id);
        let look = row_of(&truth.looks[body], found.row);
        let there = look.depth(surface, &(found.at / found.at.z));
        !(there > 0.0 && there < found.at.z * (1.0 - HIDES.0) - HIDES.1)
    }
}

/// All bodies, then the panes, which stand where the first one does.
fn with_panes<'a>(scene: &'a Scene, placed: &[Placed<'a>]) -> Vec<Placed<'a>> {
    let first = placed.last().map_or(0, Placed::next);
    let panes = Placed {
        body: &scene.glass,
        first,
        pose: &Still,
    };
    placed.iter().copied().chain([panes]).collect()
}

/// A triangle's body and surface.
fn surface<'a>(bodies: &[Placed<'a>], id: u32) -> (usize, &'a Surface) {
    let number = bodies.partition_point(|p| p.first <= id) - 1;
    let body = &bodies[number];
    (number, &body.body.surfaces[(id - body.first) as usize])
}

/// The look of a row where there is one for each, or the one for all.
fn row_of(looks: &[Look], row: usize) -> &Look {
    &looks[row.min(looks.len() - 1)]
}

impl Look {
    fn new(eye: &Pose, body: &Pose) -> Self {
        let back = body.1.inverse();
        Self {
            origin: back * (eye.0 - body.0),
            turn: (back * eye.1).to_rotation_matrix().into_inner(),
        }
    }

    fn view(&self) -> View {
        let m = &self.turn;
        View {
            rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[(j, i)] as f32)),
            origin: [0, 1, 2].map(|i| self.origin[i] as f32),
        }
    }

    /// In the optical frame.
    fn locate(&self, thing: Thing) -> Vector3<f64> {
        match thing {
            Thing::Point(point) => self.turn.tr_mul(&(point - self.origin)),
            Thing::Direction(direction) => self.turn.tr_mul(&direction),
        }
    }

    /// How many times `ray`, in the optical frame, reaches from the eye to a surface's plane.
    fn depth(&self, surface: &Surface, ray: &Vector3<f64>) -> f64 {
        let normal = Vector3::from(surface.normal.map(f64::from));
        let away = f64::from(surface.offset) - normal.dot(&self.origin);
        away / normal.dot(&(self.turn * ray))
    }
}

#[cfg(test)]
mod tests;
