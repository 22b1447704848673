//! A calibration board in the room: print, pose, and deviations from the design.
//!
//! The board frame has its origin in the middle of the sheet, x to the right, y down and z into it
//! for a viewer of the print; m. Bent boards are cylinders about the vertical axis; paper does not
//! stretch, so lengths along the sheet are preserved.

use boards::{Corner, Rectangle, Target};
use nalgebra::{UnitQuaternion, Vector3};

use crate::scene::mesh::{Mesh, Stuff};

/// Maximum cell size, m: bent sheets are drawn as planar cells.
const CELL_M: f64 = 0.02;
/// Thickness of the board under the sheet, m.
const THICK_M: f64 = 0.004;

/// A printed target in the board frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Sheet {
    target: Target,
    /// Middle of the sheet in the target's frame, m.
    middle: [f64; 2],
    /// Width and height of the sheet, m.
    size: [f64; 2],
    /// Black rectangles: left, top, right, bottom, m.
    black: Vec<[f64; 4]>,
    /// Ascending by id, m.
    corners: Vec<Corner>,
}

impl Sheet {
    /// A target with its white margin.
    ///
    /// # Panics
    /// If the target cannot be drawn: [`Target::invalid_reason`].
    pub fn new(target: Target) -> Self {
        let sheet = target.sheet_m();
        let size = sheet.size_m();
        let middle = [0, 1].map(|k| 0.5 * (sheet.min_m[k] + sheet.max_m[k]));
        let from_middle = |p: [f64; 2]| [p[0] - middle[0], p[1] - middle[1]];
        let rectangle = |r: &Rectangle| {
            let ([left, top], [right, bottom]) = (from_middle(r.min_m), from_middle(r.max_m));
            [left, top, right, bottom]
        };
        let corner = |c: &Corner| Corner {
            id: c.id,
            at_m: from_middle(c.at_m),
        };
        Self {
            black: target.black().iter().map(rectangle).collect(),
            corners: target.corners().iter().map(corner).collect(),
            middle,
            size,
            target,
        }
    }

    /// The target.
    pub fn target(&self) -> &Target {
        &self.target
    }

    /// Width and height, m.
    pub fn size_m(&self) -> [f64; 2] {
        self.size
    }

    /// All corners, ascending by id, in the board frame.
    pub fn corners(&self) -> &[Corner] {
        &self.corners
    }
}

/// A calibration board; see the module documentation.
#[derive(Clone, Debug, PartialEq)]
pub struct Board {
    sheet: Sheet,
    /// Pose: position and rotation that map the board frame to the world.
    pose: (Vector3<f64>, UnitQuaternion<f64>),
    /// True size over nominal size.
    scale: f64,
    /// Radius of the cylinder, m; infinite for a flat board, negative if the middle is nearer.
    radius_m: f64,
}

impl Board {
    /// A board; `bow_m` is the distance of its middle behind the line between its edges,
    /// `scale_error` its relative scale error.
    pub fn new(
        sheet: Sheet,
        pose: (Vector3<f64>, UnitQuaternion<f64>),
        bow_m: f64,
        scale_error: f64,
    ) -> Self {
        let scale = 1.0 + scale_error;
        Self {
            radius_m: radius(bow_m, sheet.size[0] * scale),
            sheet,
            pose,
            scale,
        }
    }

    /// The sheet as designed.
    pub fn sheet(&self) -> &Sheet {
        &self.sheet
    }

    /// Pose: position and rotation that map the board frame to the world.
    pub fn pose(&self) -> &(Vector3<f64>, UnitQuaternion<f64>) {
        &self.pose
    }

    /// World position of a point of the sheet, `behind` the print, m.
    pub fn at(&self, [x, y]: [f64; 2], behind: f64) -> Vector3<f64> {
        let (x, y) = (self.scale * x, self.scale * y);
        let flat = match self.radius_m.is_finite() {
            false => Vector3::new(x, y, behind),
            true => {
                let (radius, angle) = (self.radius_m, x / self.radius_m);
                // The middle is fixed; the edges come nearer.
                let near = radius * (1.0 - libm::cos(angle));
                let (sine, cosine) = (libm::sin(angle), libm::cos(angle));
                Vector3::new(radius * sine + behind * sine, y, behind * cosine - near)
            }
        };
        self.pose.0 + self.pose.1 * flat
    }

    /// Pose of the target: position and rotation that map the target frame, whose origin is at its
    /// top left, to the world. For a bent board, that of its middle.
    pub fn world_from_target(&self) -> (Vector3<f64>, UnitQuaternion<f64>) {
        let [x, y] = self.sheet.middle;
        let (position, rotation) = self.pose;
        (position - rotation * Vector3::new(x, y, 0.0), rotation)
    }

    /// Height of its lowest point, m.
    pub(crate) fn lowest_m(&self) -> f64 {
        let [w, h] = self.sheet.size.map(|s| 0.5 * s);
        let corners = [[-w, -h], [w, -h], [w, h], [-w, h]];
        corners
            .map(|corner| self.at(corner, THICK_M).z)
            .into_iter()
            .fold(f64::INFINITY, f64::min)
    }

    /// Whether a point is in front of the print.
    pub fn faces(&self, eye: &Vector3<f64>) -> bool {
        (self.pose.1.inverse() * (eye - self.pose.0)).z < 0.0
    }

    /// Whether the board, approximated as flat, is between two points.
    pub fn hides(&self, from: &Vector3<f64>, to: &Vector3<f64>) -> bool {
        let local = |p: &Vector3<f64>| self.pose.1.inverse() * (p - self.pose.0);
        let (a, b) = (local(from), local(to));
        if (a.z < 0.0) == (b.z < 0.0) {
            return false;
        }
        let cross = a + (b - a) * (a.z / (a.z - b.z));
        let [w, h] = self.sheet.size.map(|s| 0.5 * s * self.scale);
        cross.x.abs() <= w && cross.y.abs() <= h
    }

    /// Adds the board to a mesh in the world: print, back, and pole.
    pub(crate) fn draw(&self, mesh: &mut Mesh, [black, white]: [Stuff; 2], stand: Stuff) {
        let lines = [0, 1].map(|axis| self.lines(axis));
        let [columns, rows] = &lines;
        for y in rows.windows(2) {
            for x in columns.windows(2) {
                let middle = [0.5 * (x[0] + x[1]), 0.5 * (y[0] + y[1])];
                let stuff = match self.is_black(middle) {
                    true => black,
                    false => white,
                };
                // Seen from outside, against z: x to the right, y down.
                let corners = [[x[0], y[1]], [x[1], y[1]], [x[1], y[0]], [x[0], y[0]]];
                mesh.quad(corners.map(|c| self.at(c, 0.0)), [x[0], y[0]], stuff);
            }
        }
        let [w, h] = self.sheet.size.map(|s| 0.5 * s);
        let strips = 16;
        let along = |k: i32| w * (2.0 * f64::from(k) / f64::from(strips) - 1.0);
        for k in 0..strips {
            let (a, b) = (along(k), along(k + 1));
            let back = [[a, -h], [b, -h], [b, h], [a, h]].map(|c| self.at(c, THICK_M));
            mesh.quad(back, [a, -h], stand);
            for (y, is_top) in [(-h, true), (h, false)] {
                let (front, rear) = (
                    [a, b].map(|x| self.at([x, y], 0.0)),
                    [a, b].map(|x| self.at([x, y], THICK_M)),
                );
                let edge = match is_top {
                    true => [front[0], front[1], rear[1], rear[0]],
                    false => [front[1], front[0], rear[0], rear[1]],
                };
                mesh.quad(edge, [a, y], stand);
            }
        }
        for (x, is_left) in [(-w, true), (w, false)] {
            let (front, rear) = (
                [-h, h].map(|y| self.at([x, y], 0.0)),
                [-h, h].map(|y| self.at([x, y], THICK_M)),
            );
            let edge = match is_left {
                true => [front[1], front[0], rear[0], rear[1]],
                false => [front[0], front[1], rear[1], rear[0]],
            };
            mesh.quad(edge, [x, -h], stand);
        }
        // From its lower edge: higher up the pole would be in front of a board that leans back.
        let top = self.at([0.0, 0.9 * h], THICK_M + 0.02);
        let foot = Vector3::new(top.x, top.y, 0.0);
        mesh.tube([foot, top], [0.015; 2], 10, 0.5, stand);
    }

    /// Color changes along x (0) or y (1), with additional lines so that no cell is too large.
    fn lines(&self, axis: usize) -> Vec<f64> {
        let half = 0.5 * self.sheet.size[axis];
        let edges = self.sheet.black.iter();
        let mut marks: Vec<f64> = edges.flat_map(|r| [r[axis], r[axis + 2]]).collect();
        marks.extend([-half, half]);
        marks.sort_by(f64::total_cmp);
        // Merges edges that were computed in two ways.
        marks.dedup_by(|a, b| *a - *b < 1e-6);
        let mut all = vec![marks[0]];
        for pair in marks.windows(2) {
            let count = ((pair[1] - pair[0]) / CELL_M).ceil().max(1.0) as usize;
            let part = |k: usize| pair[0] + (pair[1] - pair[0]) * k as f64 / count as f64;
            all.extend((1..count).map(part));
            all.push(pair[1]);
        }
        all
    }

    fn is_black(&self, [x, y]: [f64; 2]) -> bool {
        let holds = |r: &[f64; 4]| (r[0]..r[2]).contains(&x) && (r[1]..r[3]).contains(&y);
        self.sheet.black.iter().any(holds)
    }
}

/// Radius of the cylinder on which an arc of this length has this sagitta, m.
fn radius(bow_m: f64, length: f64) -> f64 {
    if bow_m == 0.0 {
        return f64::INFINITY;
    }
    // Half the arc's angle: (1 - cos a) / a grows with it, up to a half circle and beyond.
    let goal = bow_m.abs() / (0.5 * length);
    let (mut low, mut high) = (0.0, 0.5 * std::f64::consts::PI);
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        match (1.0 - libm::cos(middle)) / middle < goal {
            true => low = middle,
            false => high = middle,
        }
    }
    let angle = 0.5 * (low + high);
    bow_m.signum() * 0.5 * length / angle
}
