//! Observations of board corners and scene points in images, without rendering.
//!
//! Contract: exact to f64, or with noise as requested, which follows from seed, camera, frame and
//! corner. A corner is observed in the middle of the exposure of its row, through the true lens
//! model and from the true camera pose. It is reported only if it is visible: inside the image by
//! half a pixel, from the front of the print, and not occluded by another board.

use nalgebra::Vector3;

use super::board::Board;
use crate::camera::Shutter;
use crate::camera::optics::Conditions;
use crate::camera::truth::Pose;
use crate::faults::CameraFaults;
use crate::lens::Lens;
use crate::random;
use crate::rig::SimCamera;
use crate::simulation::{Simulation, seconds};

/// Minimum depth, m; nearer points count as behind the camera.
const MIN_DEPTH_M: f64 = 0.03;
/// Points farther outside the image in the middle of the exposure than this fraction of its size
/// are not moved inside by any row of a rolling shutter.
const MAX_STRAY_RATIO: f64 = 0.1;
/// Minimum sine of the angle between the ray and a board.
const MIN_INCIDENCE_SINE: f64 = 0.05;

/// Occlusion tolerance as a fraction of the ray's length.
const OCCLUSION_TOLERANCE: f64 = 1e-6;
/// Random streams of the noise.
const NOISE: u64 = random::SENSOR + 0x90;

/// A point of the static scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Landmark {
    /// Position in the world, m.
    pub point: Vector3<f64>,
    /// Pixel in the image in which it was selected, px.
    pub pixel: [f64; 2],
}

/// Observation of a corner in an image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CornerObservation {
    /// Index of its board in [`Simulation::boards`].
    pub board: usize,
    /// Id on the board: [`boards::Corner::id`].
    pub id: u32,
    /// Column and row, px, pixel centers at integers.
    pub pixel: [f64; 2],
}

/// Observations by one camera.
pub struct TargetObservations<'a> {
    simulation: &'a Simulation,
    camera: &'a SimCamera,
    faults: CameraFaults,
    lenses: [Lens; 2],
}

impl<'a> TargetObservations<'a> {
    pub(crate) fn new(simulation: &'a Simulation, camera: usize) -> Self {
        let camera = &simulation.cameras()[camera];
        Self {
            simulation,
            camera,
            faults: CameraFaults::default(),
            lenses: camera.models.each_ref().map(Lens::new),
        }
    }

    /// The same for a camera with these faults; a shifted camera has another pose.
    #[must_use]
    pub fn with_faults(mut self, faults: CameraFaults) -> Self {
        self.faults = faults;
        self
    }

    /// Corners visible in frame `number` of an eye (0 left, 1 right), by board and id.
    pub fn frame(&self, eye: usize, number: u64) -> Vec<CornerObservation> {
        self.corners(eye, self.simulation.settings().frame_ns(number))
    }

    /// Corners visible in the image with this timestamp, ns since the beginning.
    pub fn corners(&self, eye: usize, time_ns: i64) -> Vec<CornerObservation> {
        let boards = self.simulation.boards();
        let middle = self.eye_at(eye, time_ns, self.camera.taken_s(time_ns));
        let mut found = Vec::new();
        for (number, board) in boards.iter().enumerate() {
            for corner in board.sheet().corners() {
                let point = board.at(corner.at_m, 0.0);
                if let Some((pixel, from)) = self.observe(eye, time_ns, &middle, &point)
                    && is_shown(boards, number, &point, &from)
                {
                    found.push(CornerObservation {
                        board: number,
                        id: corner.id,
                        pixel,
                    });
                }
            }
        }
        found
    }

    /// As [`TargetObservations::frame`], with noise of `sigma_px` (standard deviation) on both
    /// axes, at most 3.5 times that.
    pub fn observed(&self, eye: usize, number: u64, sigma_px: f64) -> Vec<CornerObservation> {
        let mut corners = self.frame(eye, number);
        let camera = self.simulation.cameras().iter();
        let camera = camera.take_while(|c| c.name != self.camera.name).count();
        let of_eye = random::bits(
            self.simulation.settings().seed,
            NOISE,
            (2 * camera + eye) as u64,
        );
        let seed = random::bits(of_eye, NOISE, number);
        for corner in &mut corners {
            for (axis, value) in (0..).zip(&mut corner.pixel) {
                *value += sigma_px * random::bell(seed, NOISE, 2 * u64::from(corner.id) + axis);
            }
        }
        corners
    }

    /// Up to `count` points of the static scene, evenly spread over an eye's image. With
    /// [`TargetObservations::find`] they give ideal feature matches on a walk. `which` selects
    /// other points.
    pub fn landmarks(&self, eye: usize, time_ns: i64, count: usize, which: u64) -> Vec<Landmark> {
        let model = &self.camera.models[eye];
        let (width, height) = (f64::from(model.width), f64::from(model.height));
        let begin = [0, 1].map(|k| random::uniform(which, NOISE + 1, k));
        let cast = |k: usize| {
            // Roberts' R2 sequence, 2018.
            let part = |begin: f64, step: f64| (begin + step * k as f64).fract();
            let u = part(begin[0], 0.754_877_666_246_693) * (width - 1.0);
            let v = part(begin[1], 0.569_840_290_998_053) * (height - 1.0);
            let row_s = match self.camera.shutter {
                Shutter::Global => 0.0,
                Shutter::Rolling { line_s } => line_s * (v - 0.5 * (height - 1.0)),
            };
            let time_s = self.camera.taken_s(time_ns) + row_s;
            let (origin, rotation) = self.eye_at(eye, time_ns, time_s);
            let (x, y) = self.lenses[eye].unproject(u, v);
            let ray = rotation * Vector3::new(x, y, 1.0);
            let hit = self.simulation.scene().first_hit(&origin, &ray)?;
            Some(Landmark {
                point: origin + ray * hit.distance,
                pixel: [u, v],
            })
        };
        (0..count).filter_map(cast).collect()
    }

    /// Pixel of a world point in an eye's image; `None` if it is outside or occluded by the static
    /// scene. The wearer, passers-by and panes occlude nothing.
    pub fn find(&self, eye: usize, time_ns: i64, point: &Vector3<f64>) -> Option<[f64; 2]> {
        let middle = self.eye_at(eye, time_ns, self.camera.taken_s(time_ns));
        let (pixel, from) = self.observe(eye, time_ns, &middle, point)?;
        let ray = point - from;
        let hit = self.simulation.scene().first_hit(&from, &ray);
        let hidden =
            hit.is_some_and(|hit| hit.distance < 1.0 - OCCLUSION_TOLERANCE - 1e-4 / ray.norm());
        (!hidden).then_some(pixel)
    }

    /// Pose of an eye in the world at a true time, for an image with timestamp `time_ns`.
    fn eye_at(&self, eye: usize, time_ns: i64, time_s: f64) -> Pose {
        let rotation = Conditions::of(&self.faults, seconds(time_ns)).rotation;
        let slip = self.camera.slip(&rotation);
        let rig = self.simulation.walker().rig(time_s);
        self.camera.world_from_eye(eye, &rig, slip.as_ref())
    }

    /// Pixel of a world point in an image, and the optical center then; `middle` is the eye's pose
    /// in the middle of the exposure of the middle row.
    fn observe(
        &self,
        eye: usize,
        time_ns: i64,
        middle: &Pose,
        point: &Vector3<f64>,
    ) -> Option<([f64; 2], Vector3<f64>)> {
        let model = &self.camera.models[eye];
        let (width, height) = (f64::from(model.width), f64::from(model.height));
        let lens = &self.lenses[eye];
        let project = |(origin, rotation): &Pose| {
            let at = rotation.inverse() * (point - origin);
            let (x, y) = (at.x / at.z, at.y / at.z);
            (at.z > MIN_DEPTH_M && lens.is_known(x, y)).then(|| (lens.project(x, y), *origin))
        };
        let mut seen = project(middle)?;
        if let Shutter::Rolling { line_s } = self.camera.shutter {
            let near = |v: f64, size: f64| {
                (-MAX_STRAY_RATIO * size..(1.0 + MAX_STRAY_RATIO) * size).contains(&v)
            };
            if !near(seen.0.0, width) || !near(seen.0.1, height) {
                return None;
            }
            // Fixed point: the row that observes the point is exposed at that time. The image moves
            // by far less than a row per line time, so each iteration gains two digits.
            let taken_s = self.camera.taken_s(time_ns);
            for _ in 0..6 {
                let row = seen.0.1;
                let time_s = taken_s + line_s * (row - 0.5 * (height - 1.0));
                seen = project(&self.eye_at(eye, time_ns, time_s))?;
                if (seen.0.1 - row).abs() < 1e-7 {
                    break;
                }
            }
        }
        let ((u, v), from) = seen;
        let inside = (0.0..=width - 1.0).contains(&u) && (0.0..=height - 1.0).contains(&v);
        inside.then_some(([u, v], from))
    }
}

fn is_shown(boards: &[Board], own: usize, point: &Vector3<f64>, eye: &Vector3<f64>) -> bool {
    let arm = eye - point;
    let normal = boards[own].pose().1 * -Vector3::z();
    normal.dot(&arm) > MIN_INCIDENCE_SINE * arm.norm()
        && !boards
            .iter()
            .enumerate()
            .any(|(k, board)| k != own && board.hides(eye, point))
}
