//! Ground truth of an image: depth, class, instance and optical flow.
//!
//! Contract: there is no blur, no noise and no exposure; each row is at its own instant, the middle
//! of its exposure. `TruthCamera::render` gives the first surface along the ray of each pixel
//! center. Panes count as surfaces. `TruthCamera::flow` gives the position of that point in the
//! image of another time, through lens, shutter and all motion. The surface of a pixel is the
//! rasterizer's, exact to 0.1 px at edges; everything computed on that surface is f64.

use camera_models::CameraModel;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use super::placed::{SceneBody, Still};
use super::raster::{NOTHING, View, Visibility};
use super::{Shutter, shade};
use crate::lens::Lens;
use crate::scene::Scene;
use crate::scene::body::Surface;
use crate::scene::surface::Class;

/// Minimum depth, m; nearer points count as behind the camera.
const MIN_DEPTH_M: f64 = 0.03;
/// Occlusion tolerance, relative and m: larger than the errors of facets and f32.
const OCCLUSION_TOLERANCE: (f64, f64) = (1e-3, 1e-3);

/// Position and rotation that map a frame to the world.
pub type Pose = (Vector3<f64>, UnitQuaternion<f64>);

/// Ground truth of an image at one time, row-major.
#[derive(Clone, Debug)]
pub struct Truth {
    /// Distance along the optical axis, m; infinite for the sky.
    pub depth: Vec<f32>,
    /// Class.
    pub class: Vec<Class>,
    /// Instance; 0 for the sky.
    pub instance: Vec<u16>,
    /// Triangle among those of all bodies, panes last; [`NOTHING`] for the sky.
    triangle: Vec<u32>,
    /// Camera poses per body, panes last: one for all rows, or one for each.
    row_poses: Vec<Vec<RowPose>>,
}

/// Optical flow of each pixel to the image of another time, row-major.
#[derive(Clone, Debug, PartialEq)]
pub struct Flow {
    /// Displacement to the right and down, px. NaN if the point is then behind the lens, or farther
    /// outside the image than the lens model is defined. The sky is infinitely far away.
    pub flow_px: Vec<[f32; 2]>,
    /// Whether the point is visible in the other image: inside it and unoccluded.
    pub shown: Vec<bool>,
}

/// A projected point.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ProjectedPoint {
    /// Pixel coordinate, px.
    pub u: f64,
    /// Pixel coordinate, px.
    pub v: f64,
    /// Whether it is inside the image and unoccluded.
    pub shown: bool,
}

/// Camera pose in a body's frame.
#[derive(Clone, Copy, Debug)]
struct RowPose {
    /// Optical centre, m.
    origin: Vector3<f64>,
    /// Maps vectors of the optical frame to the body's frame.
    rotation: Matrix3<f64>,
}

/// A point or direction that is constant in a body's frame.
#[derive(Clone, Copy)]
enum Element {
    Point(Vector3<f64>),
    /// Infinitely far away.
    Direction(Vector3<f64>),
}

/// Projection of an element.
struct Projection {
    u: f64,
    v: f64,
    /// Position in the optical frame.
    at: Vector3<f64>,
    /// Row at whose instant it was computed.
    row: usize,
}

/// A camera without a sensor, for ground truth.
#[derive(Debug)]
pub(crate) struct TruthCamera {
    lens: Lens,
    shutter: Shutter,
    rays: Vec<[f32; 2]>,
    visibility: Visibility,
}

impl TruthCamera {
    /// A camera with this lens model and shutter.
    pub(crate) fn new(model: &CameraModel, shutter: Shutter) -> Self {
        let lens = Lens::new(model);
        Self {
            rays: lens.rays((0.0, 0.0)),
            visibility: Visibility::new(&lens),
            lens,
            shutter,
        }
    }

    /// Renders the ground truth at a time, s. `eye_pose` is the pose of the optical frame in the
    /// world; the first body is [`Scene::fixed`], at the world origin.
    pub(crate) fn render(
        &mut self,
        scene: &Scene,
        placed: &[SceneBody<'_>],
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
            let row_pose = row_of(&truth.row_poses[body], i / self.visibility.width);
            truth.depth[i] = row_pose.depth(surface, &self.ray(i)) as f32;
            truth.class[i] = shade::class(scene, surface);
            truth.instance[i] = surface.instance;
        }
        truth
    }

    /// Optical flow from the image `from` to the image `to`. Both were rendered by this camera, in
    /// this scene with these bodies.
    pub(crate) fn flow(
        &self,
        scene: &Scene,
        placed: &[SceneBody<'_>],
        from: &Truth,
        to: &Truth,
    ) -> Flow {
        let bodies = with_panes(scene, placed);
        let width = self.visibility.width;
        let pixels = (0..self.rays.len()).map(|i| {
            let id = from.triangle[i];
            let (row, ray) = (i / width, self.ray(i));
            let (body, element) = if id == NOTHING {
                let row_pose = row_of(&from.row_poses[0], row);
                (0, Element::Direction(row_pose.rotation * ray))
            } else {
                let (body, surface) = surface(&bodies, id);
                let row_pose = row_of(&from.row_poses[body], row);
                let reach = row_pose.depth(surface, &ray);
                (
                    body,
                    Element::Point(row_pose.origin + row_pose.rotation * ray * reach),
                )
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

    /// Projects a point of body number `body`; `None` if it is behind the lens or farther outside
    /// the image than the lens model is defined.
    pub(crate) fn project(
        &self,
        scene: &Scene,
        placed: &[SceneBody<'_>],
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

    /// Ray of a pixel center, of length 1 along the optical axis.
    fn ray(&self, pixel: usize) -> Vector3<f64> {
        let [x, y] = self.rays[pixel];
        Vector3::new(f64::from(x), f64::from(y), 1.0)
    }

    /// Camera poses in the frames of bodies: once, or for each row.
    fn row_poses(
        &self,
        bodies: &[SceneBody<'_>],
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
        let of = |body: &SceneBody<'_>| {
            let row_pose = |(t, eye): &(f64, Pose)| RowPose::new(eye, &body.pose.at(*t));
            eyes.iter().map(row_pose).collect()
        };
        bodies.iter().map(of).collect()
    }

    /// Projects an element, starting with the row `start`. With a rolling shutter the row has to be
    /// found that observes the element at the time of its exposure; between two rows motion is
    /// linear.
    fn find(&self, row_poses: &[RowPose], element: Element, start: usize) -> Option<Projection> {
        let seen = |row: usize| {
            let row_pose = &row_poses[row.min(row_poses.len() - 1)];
            let at = row_pose.locate(element);
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

    /// Whether a projected element is visible: the surface of the nearest pixel, extended to the
    /// projection, does not occlude it.
    fn shows(
        &self,
        bodies: &[SceneBody<'_>],
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
        let row_pose = row_of(&truth.row_poses[body], found.row);
        let there = row_pose.depth(surface, &(found.at / found.at.z));
        !(there > 0.0 && there < found.at.z * (1.0 - OCCLUSION_TOLERANCE.0) - OCCLUSION_TOLERANCE.1)
    }
}

/// All bodies, then the panes, which have the pose of the first body.
fn with_panes<'a>(scene: &'a Scene, placed: &[SceneBody<'a>]) -> Vec<SceneBody<'a>> {
    let first = placed.last().map_or(0, SceneBody::next);
    let panes = SceneBody {
        body: &scene.glass,
        first,
        pose: &Still,
    };
    placed.iter().copied().chain([panes]).collect()
}

/// A triangle's body and surface.
fn surface<'a>(bodies: &[SceneBody<'a>], id: u32) -> (usize, &'a Surface) {
    let number = bodies.partition_point(|p| p.first <= id) - 1;
    let body = &bodies[number];
    (number, &body.body.surfaces[(id - body.first) as usize])
}

/// Pose of a row, or the pose of all rows.
fn row_of(row_poses: &[RowPose], row: usize) -> &RowPose {
    &row_poses[row.min(row_poses.len() - 1)]
}

impl RowPose {
    fn new(eye: &Pose, body: &Pose) -> Self {
        let back = body.1.inverse();
        Self {
            origin: back * (eye.0 - body.0),
            rotation: (back * eye.1).to_rotation_matrix().into_inner(),
        }
    }

    fn view(&self) -> View {
        let m = &self.rotation;
        View {
            rotation: [0, 1, 2].map(|i| [0, 1, 2].map(|j| m[(j, i)] as f32)),
            origin: [0, 1, 2].map(|i| self.origin[i] as f32),
        }
    }

    /// Position in the optical frame.
    fn locate(&self, element: Element) -> Vector3<f64> {
        match element {
            Element::Point(point) => self.rotation.tr_mul(&(point - self.origin)),
            Element::Direction(direction) => self.rotation.tr_mul(&direction),
        }
    }

    /// Distance to a surface's plane, in lengths of `ray` (optical frame).
    fn depth(&self, surface: &Surface, ray: &Vector3<f64>) -> f64 {
        let normal = Vector3::from(surface.normal.map(f64::from));
        let away = f64::from(surface.offset) - normal.dot(&self.origin);
        away / normal.dot(&(self.rotation * ray))
    }
}

#[cfg(test)]
mod tests;
