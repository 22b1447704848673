//! What an eye really sees, and where that goes.
//!
//! Contract: there is no blur, no noise and no exposure; each row is taken at its own instant, the middle
//! of its exposure. [`TruthCamera::render`] says what the ray of each pixel's centre meets first. Panes count as
//! what is seen. [`TruthCamera::flow`] follows that to the picture of another time, through lens, shutter and
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
const MIN_DEPTH_M: f64 = 0.03;
/// A point is hidden by what is nearer by this share and this length: more than facets and f32 need.
const OCCLUSION_TOLERANCE: (f64, f64) = (1e-3, 1e-3);

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
    row_poses: Vec<Vec<RowPose>>,
}

/// Where what each pixel sees is in the picture of another time; rows first.
#[derive(Clone, Debug, PartialEq)]
pub struct Flow {
    /// To the right and down, px. Not a number where the point is behind the lens then, or farther
    /// outside the picture than the lens is known. The sky is infinitely far away.
    pub flow_px: Vec<[f32; 2]>,
    /// Whether the other picture shows the point: it is inside and nothing is before it.
    pub shown: Vec<bool>,
}

/// A point in a picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProjectedPoint {
    /// px.
    pub u: f64,
    /// px.
    pub v: f64,
    /// Whether it is inside the picture and nothing is before it.
    pub shown: bool,
}

/// Where the eye is in a body's frame.
#[derive(Clone, Copy, Debug)]
struct RowPose {
    /// Optical centre, m.
    origin: Vector3<f64>,
    /// Takes vectors in the optical frame to the body's.
    turn: Matrix3<f64>,
}

/// Something that does not change in a body's frame.
#[derive(Clone, Copy)]
enum Element {
    Point(Vector3<f64>),
    /// Infinitely far away.
    Direction(Vector3<f64>),
}

/// Where a thing is seen.
struct Projection {
    u: f64,
    v: f64,
    /// In the optical frame.
    at: Vector3<f64>,
    /// Row whose instant this is.
    row: usize,
}

/// An eye without a sensor.
#[derive(Debug)]
pub struct TruthCamera {
    lens: Lens,
    shutter: Shutter,
    rays: Vec<[f32; 2]>,
    visibility: Visibility,
}

impl TruthCamera {
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
    pub fn render(
        &mut self,
        scene: &Scene,
        placed: &[Placed<'_>],
        eye_pose: &dyn Fn(f64) -> Pose,
        time_s: f64,
    ) -> Truth {
        let bodies = with_panes(scene, placed);
        let row_poses = self.row_poses(&bodies, eye_pose, time_s);
        self.visibility.clear();
        for (body, row_poses) in bodies.iter().zip(&row_poses) {
            let views: Vec<View> = row_poses.iter().map(RowPose::view).collect();
            self.visibility
                .draw(body.body, body.first, &self.lens, (0.0, 0.0), &views);
        }
        let count = self.rays.len();
        let mut truth = Truth {
            depth: vec![f32::INFINITY; count],
            class: vec![Class::Sky; count],
            instance: vec![0; count],
            triangle: self.visibility.triangle.clone(),
            row_poses,
        };
        for (i, &id) in self.visibility.triangle.iter().enumerate() {
            if id == NOTHING {
                continue;
            }
            let (body, surface) = surface(&bodies, id);
            let look = row_of(&truth.row_poses[body], i / self.visibility.width);
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
            let (body, element) = if id == NOTHING {
                let look = row_of(&from.row_poses[0], row);
                (0, Element::Direction(look.turn * ray))
            } else {
                let (body, surface) = surface(&bodies, id);
                let look = row_of(&from.row_poses[body], row);
                let reach = look.depth(surface, &ray);
                (body, Element::Point(look.origin + look.turn * ray * reach))
            };
            match self.find(&to.row_poses[body], element, row) {
                None => ([f32::NAN; 2], false),
                Some(found) => {
                    let flow_px = [
                        (found.u - (i % width) as f64) as f32,
                        (found.v - row as f64) as f32,
                    ];
                    (flow_px, self.shows(&bodies, to, element, &found))
                }
            }
        });
        let (flow_px, shown) = pixels.unzip();
        Flow { flow_px, shown }
    }

    /// Where a picture has a point of body number `body`, or `None` where it is behind the lens or
    /// farther outside the picture than the lens is known.
    pub fn project(
        &self,
        scene: &Scene,
        placed: &[Placed<'_>],
        truth: &Truth,
        body: usize,
        point: Vector3<f64>,
    ) -> Option<ProjectedPoint> {
        let element = Element::Point(point);
        let found = self.find(&truth.row_poses[body], element, self.visibility.height / 2)?;
        let shown = self.shows(&with_panes(scene, placed), truth, element, &found);
        Some(ProjectedPoint {
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
    fn row_poses(
        &self,
        bodies: &[Placed<'_>],
        eye_pose: &dyn Fn(f64) -> Pose,
        time_s: f64,
    ) -> Vec<Vec<RowPose>> {
        let height = self.visibility.height;
        let rows = match self.shutter {
            Shutter::Global => 1,
            Shutter::Rolling { .. } => height,
        };
        let times = (0..rows).map(|row| time_s + self.shutter.row_s(row, height));
        let eyes: Vec<(f64, Pose)> = times.map(|t| (t, eye_pose(t))).collect();
        let of = |body: &Placed<'_>| {
            let look = |(t, eye): &(f64, Pose)| RowPose::new(eye, &body.pose.at(*t));
            eyes.iter().map(look).collect()
        };
        bodies.iter().map(of).collect()
    }

    /// Looks for a thing, first in the row `start`. A rolling shutter takes each row at its own
    /// instant, so the row has to be found that sees the thing at the time it is exposed; between two
    /// rows motion is even.
    fn find(&self, row_poses: &[RowPose], element: Element, start: usize) -> Option<Projection> {
        let seen = |row: usize| {
            let look = &row_poses[row.min(row_poses.len() - 1)];
            let at = look.locate(element);
            let (x, y) = (at.x / at.z, at.y / at.z);
            (at.z > MIN_DEPTH_M && self.lens.is_known(x, y)).then(|| {
                let (u, v) = self.lens.project(x, y);
                Projection { u, v, at, row }
            })
        };
        if row_poses.len() < 2 {
            return seen(0);
        }
        let mut row = start.min(row_poses.len() - 2);
        for _ in 0..4 {
            row = seen(row)?.v.clamp(0.0, (row_poses.len() - 2) as f64) as usize;
        }
        let (a, b) = (seen(row)?, seen(row + 1)?);
        let part = (a.v - row as f64) / (1.0 - (b.v - a.v));
        Some(Projection {
            u: a.u + (b.u - a.u) * part,
            v: a.v + (b.v - a.v) * part,
            at: a.at + (b.at - a.at) * part,
            row,
        })
    }

    /// Whether a picture shows a thing that is found there: the surface that the nearest pixel sees,
    /// continued to the spot, is not before it.
    fn shows(
        &self,
        bodies: &[Placed<'_>],
        truth: &Truth,
        element: Element,
        found: &Projection,
    ) -> bool {
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
        let Element::Point(_) = element else {
            return false;
        };
        let (body, surface) = surface(bodies, id);
        let look = row_of(&truth.row_poses[body], found.row);
        let there = look.depth(surface, &(found.at / found.at.z));
        !(there > 0.0 && there < found.at.z * (1.0 - OCCLUSION_TOLERANCE.0) - OCCLUSION_TOLERANCE.1)
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
fn row_of(row_poses: &[RowPose], row: usize) -> &RowPose {
    &row_poses[row.min(row_poses.len() - 1)]
}

impl RowPose {
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
    fn locate(&self, element: Element) -> Vector3<f64> {
        match element {
            Element::Point(point) => self.turn.tr_mul(&(point - self.origin)),
            Element::Direction(direction) => self.turn.tr_mul(&direction),
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
