//! Parts of rooms: walls with openings, floors, ceilings, doors, lamps.
//!
//! Contract: seen from inside. Faces are thick: each has a back, so that no light leaks in where
//! two meet. Walls reach as far as they are thick into floor, ceiling and each other, so that no
//! seam opens between grids that do not match.

use nalgebra::Vector3;

use super::build::Builder;
use super::light::Lamp;
use super::mesh::Stuff;
use cad_transforms::so3;

/// Thickness of walls, m.
pub(super) const THICK: f64 = 0.2;
/// How far floors reach under walls, m.
const SUNK: f64 = 0.03;

/// A wall; `from` is its left end and `to` its right one for a viewer in the room.
#[derive(Clone, Copy, Debug)]
pub(super) struct Wall {
    pub(super) from: [f64; 2],
    pub(super) to: [f64; 2],
    pub(super) height: f64,
}

/// A hole in a wall, m from its left end and from the floor. One that reaches the floor begins
/// below it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Opening {
    pub(super) along: [f64; 2],
    pub(super) up: [f64; 2],
}

/// Materials of a door.
#[derive(Clone, Copy, Debug)]
pub(super) struct DoorStuff {
    pub(super) leaf: u16,
    pub(super) frame: u16,
    pub(super) handle: u16,
}

/// Sorted marks with additional ones between them, at most `cell_m` apart.
fn lines(mut marks: Vec<f64>, cell_m: f64) -> Vec<f64> {
    marks.sort_by(f64::total_cmp);
    marks.dedup();
    let mut all = vec![marks[0]];
    for pair in marks.windows(2) {
        let count = ((pair[1] - pair[0]) / cell_m).ceil().max(1.0) as usize;
        let part = |k: usize| pair[0] + (pair[1] - pair[0]) * k as f64 / count as f64;
        all.extend((1..count).map(part));
        all.push(pair[1]);
    }
    all
}

impl Wall {
    /// Direction to the right.
    fn right(&self) -> Vector3<f64> {
        let [dx, dy] = [0, 1].map(|i| self.to[i] - self.from[i]);
        Vector3::new(dx, dy, 0.0).normalize()
    }

    /// Length, m.
    pub(super) fn length(&self) -> f64 {
        let [dx, dy] = [0, 1].map(|i| self.to[i] - self.from[i]);
        (dx * dx + dy * dy).sqrt()
    }

    /// Point at distances along the wall, above the floor, and out of the wall's face into the
    /// room, m.
    pub(super) fn at(&self, along: f64, up: f64, out: f64) -> Vector3<f64> {
        let right = self.right();
        Vector3::new(self.from[0], self.from[1], up)
            + right * along
            + right.cross(&Vector3::z()) * out
    }

    /// Builds the wall.
    pub(super) fn build(&self, b: &mut Builder, openings: &[Opening], cell_m: f64, stuff: Stuff) {
        let length = self.length();
        let mut across = vec![-THICK, 0.0, length, length + THICK];
        let mut upwards = vec![-THICK, 0.0, self.height, self.height + THICK];
        for hole in openings {
            across.extend(hole.along);
            upwards.extend(hole.up.map(|z| z.clamp(-THICK, self.height + THICK)));
        }
        let (across, upwards) = (lines(across, cell_m), lines(upwards, cell_m));
        let (columns, rows) = (across.len() - 1, upwards.len() - 1);
        // Outside the wall counts as solid: its rims are never visible.
        let is_open = |i: usize, j: usize| {
            i < columns && j < rows && {
                let (x, z) = (
                    0.5 * (across[i] + across[i + 1]),
                    0.5 * (upwards[j] + upwards[j + 1]),
                );
                let holds = |range: [f64; 2], v: f64| range[0] < v && v < range[1];
                openings.iter().any(|o| holds(o.along, x) && holds(o.up, z))
            }
        };
        let front = |i: usize, j: usize| self.at(across[i], upwards[j], 0.0);
        let back = |i: usize, j: usize| self.at(across[i], upwards[j], -THICK);
        let cells = (0..rows).flat_map(|j| (0..columns).map(move |i| (i, j)));
        for (i, j) in cells.filter(|&(i, j)| !is_open(i, j)) {
            let uv = [across[i], upwards[j]];
            let mut quad = |corners| b.mesh.quad(corners, uv, stuff);
            let (right, top) = (i + 1, j + 1);
            quad([
                front(i, j),
                front(right, j),
                front(right, top),
                front(i, top),
            ]);
            quad([back(right, j), back(i, j), back(i, top), back(right, top)]);
            // Visible part of the wall's thickness.
            if is_open(right, j) {
                quad([
                    front(right, j),
                    back(right, j),
                    back(right, top),
                    front(right, top),
                ]);
            }
            if is_open(i.wrapping_sub(1), j) {
                quad([back(i, j), front(i, j), front(i, top), back(i, top)]);
            }
            if is_open(i, top) {
                quad([
                    front(i, top),
                    front(right, top),
                    back(right, top),
                    back(i, top),
                ]);
            }
            if is_open(i, j.wrapping_sub(1)) {
                quad([back(i, j), back(right, j), front(right, j), front(i, j)]);
            }
        }
    }

    /// A box in the wall's axes; ranges along, up and out of the wall.
    pub(super) fn block(
        &self,
        b: &mut Builder,
        along: [f64; 2],
        up: [f64; 2],
        out: [f64; 2],
        stuff: Stuff,
    ) {
        let middle = |range: [f64; 2]| 0.5 * (range[0] + range[1]);
        let size = |range: [f64; 2]| range[1] - range[0];
        let right = self.right();
        let turn = so3::exp(Vector3::z() * libm::atan2(right.y, right.x));
        b.mesh.cuboid(
            self.at(middle(along), middle(up), middle(out)),
            Vector3::new(size(along), size(out), size(up)),
            turn,
            0.5,
            stuff,
        );
    }

    /// A skirting board, left out where openings reach the floor.
    pub(super) fn skirting(
        &self,
        b: &mut Builder,
        openings: &[Opening],
        margin_m: f64,
        stuff: Stuff,
    ) {
        let mut from = 0.0;
        let doors = openings.iter().filter(|o| o.up[0] <= 0.0);
        let mut gaps: Vec<[f64; 2]> = doors.map(|o| o.along).collect();
        gaps.sort_by(|a, b| a[0].total_cmp(&b[0]));
        gaps.push([self.length() + margin_m, 0.0]);
        for gap in gaps {
            let to = gap[0] - margin_m;
            if to > from + 0.02 {
                self.block(b, [from, to], [0.0, 0.09], [0.0, 0.014], stuff);
            }
            from = gap[1] + margin_m;
        }
    }

    /// A closed door in an opening that reaches the floor.
    pub(super) fn door(&self, b: &mut Builder, hole: &Opening, stuff: DoorStuff) {
        let [left, right] = hole.along;
        let top = hole.up[1];
        let leaf = b.of_thing(stuff.leaf);
        self.block(
            b,
            [left - 0.01, right + 0.01],
            [0.004, top + 0.01],
            [-0.11, -0.07],
            leaf,
        );
        let frame = Stuff {
            material: stuff.frame,
            ..leaf
        };
        let proud = [0.0, 0.018];
        self.block(b, [left - 0.06, left], [0.0, top], proud, frame);
        self.block(b, [right, right + 0.06], [0.0, top], proud, frame);
        self.block(
            b,
            [left - 0.06, right + 0.06],
            [top, top + 0.06],
            proud,
            frame,
        );
        self.block(b, [left, right], [-0.05, 0.004], [-THICK, 0.0], frame);
        let handle = Stuff {
            material: stuff.handle,
            ..leaf
        };
        let at = |along: f64, out: f64| self.at(along, 1.02, out);
        let knob = right - 0.09;
        b.mesh.tube(
            [at(knob, -0.07), at(knob, -0.02)],
            [0.01; 2],
            8,
            1.0,
            handle,
        );
        b.mesh.tube(
            [at(knob, -0.02), at(knob - 0.12, -0.02)],
            [0.011; 2],
            8,
            1.0,
            handle,
        );
    }
}

/// A floor or, seen from below, a ceiling.
#[derive(Clone, Copy, Debug)]
pub(super) struct Slab {
    pub(super) from: [f64; 2],
    pub(super) to: [f64; 2],
    pub(super) height: f64,
    pub(super) is_ceiling: bool,
}

impl Slab {
    /// Builds the slab, slightly enlarged. `cuts` are lines in x and in y along which cells end,
    /// where walls stand.
    pub(super) fn build(&self, b: &mut Builder, cuts: [&[f64]; 2], cell_m: f64, stuff: Stuff) {
        let axis = |k: usize| {
            let mut marks = cuts[k].to_vec();
            marks.extend([
                self.from[k] - SUNK,
                self.from[k],
                self.to[k],
                self.to[k] + SUNK,
            ]);
            lines(marks, cell_m)
        };
        let (xs, ys) = (axis(0), axis(1));
        let z = self.height;
        let face = |[x0, x1]: [f64; 2], [y0, y1]: [f64; 2], z: f64, is_down: bool| {
            let corners = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)];
            let [a, b, c, d] = corners.map(|(x, y)| Vector3::new(x, y, z));
            if is_down { [b, a, d, c] } else { [a, b, c, d] }
        };
        for y in ys.windows(2) {
            for x in xs.windows(2) {
                let quad = face([x[0], x[1]], [y[0], y[1]], z, self.is_ceiling);
                b.mesh.quad(quad, [x[0], y[0]], stuff);
            }
        }
        // The far side, which only blocks light.
        let far = if self.is_ceiling {
            z + THICK
        } else {
            z - THICK
        };
        let wide = |from: f64, to: f64| [from - THICK, to + THICK];
        let quad = face(
            wide(self.from[0], self.to[0]),
            wide(self.from[1], self.to[1]),
            far,
            !self.is_ceiling,
        );
        b.mesh.quad(quad, [0.0; 2], stuff);
    }
}

/// A long lamp under a ceiling, `size` in x and y.
pub(super) fn ceiling_lamp(
    b: &mut Builder,
    ceiling: Vector3<f64>,
    size: [f64; 2],
    strength: f64,
    glowing: u16,
) -> Lamp {
    let body = b.of_thing(glowing);
    let base = ceiling - Vector3::z() * 0.05;
    b.standing_box(base, Vector3::new(size[0], size[1], 0.05), 0.0, 0.5, body);
    Lamp {
        position: base - Vector3::z() * 0.06,
        strength,
    }
}
