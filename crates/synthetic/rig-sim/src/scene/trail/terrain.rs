//! The forest floor: its height, and the mesh of it.
//!
//! Fine cells along the trail, coarse ones elsewhere, wide ones far away. A coarse cell beside fine
//! ones takes over their corners, so there are no cracks.

use nalgebra::Vector3;

use super::super::build::Builder;
use super::super::mesh::{Corner, Mesh, Stuff, Triangle};
use crate::walker::path::Path;

/// Edge of a coarse cell, m.
const COARSE_M: f64 = 0.6;
/// Fine cells along its edge.
const PARTS: usize = 5;
/// Cells whose middle is nearer to the trail than this are fine, m.
const FINE_M: f64 = 1.15;
/// Half the sides of the part with coarse cells, m.
const HALF: [f64; 2] = [18.0, 13.2];
/// Extent of the ground, m.
const FAR_M: f64 = 75.0;

/// A bump or hill: `amplitude · sin(x·direction + phase)`.
#[derive(Clone, Copy, Debug)]
struct Wave {
    direction: [f64; 2],
    phase: f64,
    amplitude: f64,
}

/// The shape of the ground.
#[derive(Debug)]
pub(super) struct Terrain {
    hills: Vec<Wave>,
    bumps: Vec<Wave>,
    patches: Vec<Wave>,
    frayed: Vec<Wave>,
    /// Points of the trail, 0.2 m apart.
    trail: Vec<[f64; 2]>,
}

/// `count` waves with lengths in `lengths` m and amplitudes proportional to their length.
fn waves(b: &mut Builder, count: usize, lengths: [f64; 2], share: f64) -> Vec<Wave> {
    (0..count)
        .map(|_| {
            let length = b.draw(lengths[0], lengths[1]);
            let angle = b.draw(0.0, 2.0 * std::f64::consts::PI);
            let number = 2.0 * std::f64::consts::PI / length;
            Wave {
                direction: [number * libm::cos(angle), number * libm::sin(angle)],
                phase: b.draw(0.0, 2.0 * std::f64::consts::PI),
                amplitude: share * length,
            }
        })
        .collect()
}

fn sum(waves: &[Wave], x: f64, y: f64) -> f64 {
    waves.iter().fold(0.0, |sum, w| {
        sum + w.amplitude * libm::sin(w.direction[0] * x + w.direction[1] * y + w.phase)
    })
}

/// Smooth step from 0 to 1.
fn smooth(t: f64) -> f64 {
    let t = t.clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

impl Terrain {
    /// Terrain of a trail with these control points.
    pub(super) fn new(b: &mut Builder, points: &[[f64; 2]]) -> Self {
        let path = Path::closed(points);
        let count = (path.length_m() / 0.2) as usize;
        let mut bumps = waves(b, 6, [1.2, 3.0], 0.013);
        bumps.extend(waves(b, 7, [0.4, 0.8], 0.011));
        Self {
            hills: waves(b, 3, [18.0, 28.0], 0.015),
            bumps,
            patches: waves(b, 5, [0.5, 3.5], 0.2),
            frayed: waves(b, 5, [0.17, 0.45], 0.2),
            trail: (0..count).map(|i| path.at(0.2 * i as f64).0).collect(),
        }
    }

    /// Distance from the middle of the trail, to 3 cm, m.
    pub(super) fn off_trail(&self, x: f64, y: f64) -> f64 {
        let square = |p: &[f64; 2]| (p[0] - x) * (p[0] - x) + (p[1] - y) * (p[1] - y);
        self.trail
            .iter()
            .map(square)
            .fold(f64::MAX, f64::min)
            .sqrt()
    }

    /// Height of the ground, m.
    pub(super) fn height(&self, x: f64, y: f64) -> f64 {
        // Feet have worn the trail down, and its bumps too.
        let wild = smooth((self.off_trail(x, y) - 0.25) / 1.2);
        // A hillside, and higher ground all around that hides the edge of the ground.
        let reach = (x * x + y * y).sqrt();
        let beyond = smooth((reach - 20.0) / 45.0);
        // Cells far away are too wide for bumps.
        let rough = (0.8 + wild) * (1.0 - smooth((reach - 15.0) / 8.0));
        0.085 * x + 0.05 * y + sum(&self.hills, x, y) + rough * sum(&self.bumps, x, y)
            - 0.08 * (1.0 - wild)
            + 9.0 * beyond
    }

    /// Point on the ground.
    pub(super) fn point(&self, x: f64, y: f64) -> Vector3<f64> {
        Vector3::new(x, y, self.height(x, y))
    }

    /// A slowly varying number, mostly within ±1, for vegetation and ground cover.
    pub(super) fn patch(&self, x: f64, y: f64) -> f64 {
        sum(&self.patches, x, y)
    }

    /// As [`Terrain::patch`], varying from one cell to the next.
    pub(super) fn fray(&self, x: f64, y: f64) -> f64 {
        10.0 * sum(&self.frayed, x, y)
    }

    /// Adds the mesh. `stuff` gives the surface at a point and its distance from the trail.
    pub(super) fn lay(&self, mesh: &mut Mesh, stuff: impl Fn(f64, f64, f64) -> Stuff) {
        let lines = HALF.map(lines);
        let [columns, rows] = [lines[0].len() - 1, lines[1].len() - 1];
        let middle = |axis: usize, i: usize| 0.5 * (lines[axis][i] + lines[axis][i + 1]);
        let fine: Vec<bool> = (0..columns * rows)
            .map(|k| {
                let off = self.off_trail(middle(0, k % columns), middle(1, k / columns));
                off < FINE_M
            })
            .collect();
        let is_fine = |i: usize, j: usize| i < columns && j < rows && fine[j * columns + i];
        // Part `k` of a cell's edge, the same bits from either side of a line.
        let line = |axis: usize, i: usize, k: usize| {
            let (from, to) = (lines[axis][i], lines[axis][i + 1]);
            match k {
                0 => from,
                PARTS => to,
                _ => from + (to - from) * k as f64 / PARTS as f64,
            }
        };
        let corner = |x: f64, y: f64| Corner {
            position: self.point(x, y),
            uv: [x, y],
        };
        let mut push = |corners: [Corner; 3]| {
            let center = corners.iter().map(|c| c.position).sum::<Vector3<f64>>() / 3.0;
            let Stuff { material, instance } =
                stuff(center.x, center.y, self.off_trail(center.x, center.y));
            mesh.triangles.push(Triangle {
                corners,
                material,
                instance,
            });
        };
        for j in 0..rows {
            for i in 0..columns {
                let at = |k: usize, l: usize| corner(line(0, i, k), line(1, j, l));
                if is_fine(i, j) {
                    let points: Vec<Corner> = (0..(PARTS + 1) * (PARTS + 1))
                        .map(|n| at(n % (PARTS + 1), n / (PARTS + 1)))
                        .collect();
                    for n in (0..PARTS * (PARTS + 1)).filter(|n| n % (PARTS + 1) < PARTS) {
                        let quad = [n, n + 1, n + PARTS + 2, n + PARTS + 1].map(|k| points[k]);
                        push([quad[0], quad[1], quad[2]]);
                        push([quad[0], quad[2], quad[3]]);
                    }
                    continue;
                }
                // Counter-clockwise round the cell; fine neighbours have corners between.
                let steps = |fine: bool| if fine { 1 } else { PARTS };
                let mut outline = Vec::new();
                let below = steps(j > 0 && is_fine(i, j - 1));
                outline.extend((0..PARTS).step_by(below).map(|k| at(k, 0)));
                let right = steps(is_fine(i + 1, j));
                outline.extend((0..PARTS).step_by(right).map(|k| at(PARTS, k)));
                let above = steps(is_fine(i, j + 1));
                outline.extend((0..PARTS).step_by(above).map(|k| at(PARTS - k, PARTS)));
                let left = steps(i > 0 && is_fine(i - 1, j));
                outline.extend((0..PARTS).step_by(left).map(|k| at(0, PARTS - k)));
                let center = corner(middle(0, i), middle(1, j));
                for k in 0..outline.len() {
                    push([center, outline[k], outline[(k + 1) % outline.len()]]);
                }
            }
        }
    }
}

/// Lines of the coarse grid, ever wider apart beyond `half` m.
fn lines(half: f64) -> Vec<f64> {
    let cells = (half / COARSE_M) as i32;
    let mut right: Vec<f64> = (0..=cells).map(|i| COARSE_M * f64::from(i)).collect();
    let mut step = COARSE_M;
    while right[right.len() - 1] < FAR_M {
        step *= 1.3;
        right.push(right[right.len() - 1] + step);
    }
    let left = right[1..].iter().rev().map(|x| -x);
    left.chain(right.iter().copied()).collect()
}
