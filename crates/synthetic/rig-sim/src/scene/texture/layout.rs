//! Layouts of textures: directions of leaves; slabs, bricks, planks.
//!
//! Contract: everything tiles. Joints are in the second channel only, so the coarse texture layer,
//! which uses the first channel only, has no oversized joints.

use super::SIZE;
use crate::random;

/// Layout of a texture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Layout {
    /// Leaves along u.
    Along,
    /// Leaves in all directions.
    Tossed,
    /// Pieces side by side, each cut from another position of a texture whose leaves are along u.
    Courses(Courses),
}

/// Rows of pieces with joints between them. The second colour is that of the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Courses {
    /// Pieces along u in a tile.
    pub across: u16,
    /// Rows in a tile; an even number if they are staggered by halves.
    pub rows: u16,
    /// Offset between rows.
    pub stagger: Stagger,
    /// Width of joints, texels.
    pub joint: f32,
    /// Maximum fraction of the second color in a piece.
    pub uneven: f32,
}

/// Offset between rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stagger {
    /// None.
    None,
    /// Every second one by half a piece.
    Half,
    /// Each by any length.
    Any,
}

/// Sizes of the bends of outlines, texels, and their amplitude relative to that.
const BENDS: [usize; 3] = [8, 32, 128];
const BEND: f32 = 0.13;
/// Fraction of the bends that applies to joints.
const CROOKED: f32 = 0.08;

/// An offset for every texel: smooth value noise of several sizes.
struct Bends {
    shift: Vec<[f32; 2]>,
}

impl Bends {
    fn new(seed: u64) -> Self {
        let mut shift = vec![[0.0_f32; 2]; SIZE * SIZE];
        for (octave, cell) in BENDS.into_iter().enumerate() {
            let wide = SIZE / cell;
            let node = |index: usize, axis: u64| {
                let stream = random::TEXTURE + 24 + 2 * octave as u64 + axis;
                BEND * cell as f32 * random::bell(seed, stream, index as u64) as f32
            };
            let nodes: Vec<[f32; 2]> = (0..wide * wide).map(|i| [node(i, 0), node(i, 1)]).collect();
            let ease: Vec<f32> = (0..cell)
                .map(|i| {
                    let t = i as f32 / cell as f32;
                    t * t * (3.0 - 2.0 * t)
                })
                .collect();
            for (y, row) in shift.chunks_exact_mut(SIZE).enumerate() {
                let (above, below) = (y / cell * wide, (y / cell + 1) % wide * wide);
                let t = ease[y % cell];
                let at = |i: usize, axis: usize| {
                    let i = i % wide;
                    nodes[above + i][axis] * (1.0 - t) + nodes[below + i][axis] * t
                };
                for (i, part) in row.chunks_exact_mut(cell).enumerate() {
                    let (left, right) = ([at(i, 0), at(i, 1)], [at(i + 1, 0), at(i + 1, 1)]);
                    for (to, s) in part.iter_mut().zip(&ease) {
                        to[0] += left[0] * (1.0 - s) + right[0] * s;
                        to[1] += left[1] * (1.0 - s) + right[1] * s;
                    }
                }
            }
        }
        Self { shift }
    }
}

/// Index of a texel, which may lie beyond the tile.
fn index(x: i32, y: i32) -> usize {
    let mask = SIZE as i32 - 1;
    ((y & mask) as usize) * SIZE + (x & mask) as usize
}

/// Bends outlines, so that no leaf is a disc, and cuts pieces where there are any.
pub(super) fn lay(luma: &mut Vec<f32>, mix: &mut Vec<f32>, layout: &Layout, seed: u64) {
    let bends = Bends::new(seed);
    let mut bent = (
        Vec::with_capacity(luma.len()),
        Vec::with_capacity(mix.len()),
    );
    let beyond = SIZE as f32;
    for (i, [dx, dy]) in bends.shift.iter().enumerate() {
        // A tile on, where no index is negative.
        let (x, y) = (
            beyond + (i % SIZE) as f32 + 0.5,
            beyond + (i / SIZE) as f32 + 0.5,
        );
        let (source, joint) = match layout {
            Layout::Courses(courses) => {
                let (place, piece, joint) = courses.at(x + CROOKED * dx, y + CROOKED * dy, seed);
                let from = index((x + dx) as i32 + place[0], (y + dy) as i32 + place[1]);
                (from, Some(joint.max(piece * courses.uneven)))
            }
            _ => (index((x + dx) as i32, (y + dy) as i32), None),
        };
        bent.0.push(luma[source]);
        bent.1.push(joint.unwrap_or(mix[source]));
    }
    (*luma, *mix) = bent;
}

impl Courses {
    /// At a texel: position in the tile from which the piece is cut, a random number from 0 to 1
    /// per piece, and 1 within a joint.
    fn at(&self, x: f32, y: f32, seed: u64) -> ([i32; 2], f32, f32) {
        let (wide, high) = (
            SIZE as f32 / f32::from(self.across),
            SIZE as f32 / f32::from(self.rows),
        );
        let whole = |v: f32| v.floor() as i32;
        let row = whole(y / high).rem_euclid(i32::from(self.rows));
        let draw =
            |k: u64, n: i32| random::uniform(seed, random::TEXTURE + 32 + k, n as u64) as f32;
        let moved = match self.stagger {
            Stagger::None => 0.0,
            Stagger::Half => 0.5 * (row % 2) as f32,
            Stagger::Any => draw(0, row),
        };
        let along = x / wide + moved;
        let column = whole(along).rem_euclid(i32::from(self.across));
        let piece = row * i32::from(self.across) + column;
        let place = [1, 2].map(|k| (draw(k, piece) * SIZE as f32) as i32);
        // Distance from the nearest edge, texels; joints fade out over one.
        let edge =
            |share: f32, length: f32| (share - share.floor()).min(share.ceil() - share) * length;
        let near = edge(along, wide).min(edge(y / high, high));
        let joint = (0.5 * self.joint + 0.5 - near).clamp(0.0, 1.0);
        (place, draw(3, piece), joint)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const BRICKS: Courses = Courses {
        across: 4,
        rows: 14,
        stagger: Stagger::Half,
        joint: 8.0,
        uneven: 0.4,
    };

    /// Share of a wall that is mortar: 8 of 73 texels high, and of the rest 8 of 256 along.
    #[test]
    fn joints_have_their_area() {
        let size = SIZE as f32;
        let texels = (0..SIZE * SIZE).map(|i| ((i % SIZE) as f32 + 0.5, (i / SIZE) as f32 + 0.5));
        let mortar: f32 = texels.map(|(x, y)| BRICKS.at(x, y, 1).2).sum();
        let (lying, standing) = (8.0 * 14.0 / size, 8.0 * 4.0 / size);
        let expected = lying + (1.0 - lying) * standing;
        assert!(
            (mortar / size / size / expected - 1.0).abs() < 0.02,
            "{mortar}"
        );
    }

    #[test]
    fn tiles_are_continuous_at_their_edges() {
        for y in [3.5, 100.5, 800.5] {
            for x in [0.5, 517.5] {
                let size = SIZE as f32;
                let (place, piece, joint) = BRICKS.at(x, y, 1);
                for (x, y) in [(x + size, y), (x, y - size)] {
                    let again = BRICKS.at(x, y, 1);
                    assert_eq!((again.0, again.1), (place, piece));
                    assert!((again.2 - joint).abs() < 1e-3, "{x} {y}");
                }
            }
        }
    }
}
