//! Lattices of crossings.
//!
//! Contract: a lattice assigns integer coordinates to crossings connected by borders, with y
//! clockwise from x as in the image axes, so that a lattice is never mirrored. It grows from link
//! to link, so that any lens distortion is allowed. Neighbouring steps must have similar lengths,
//! which those of an AprilGrid have not, and a crossing must be between its neighbours.

use std::collections::{BTreeMap, VecDeque};

use super::config::LatticeConfig;
use super::link::Links;
use super::saddle::Saddle;
use fiducials::square::distance;

/// Steps along x and y: directions 0 +x, 1 +y, 2 -x, 3 -y.
const STEPS: [[i32; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];

/// Crossings with lattice coordinates.
#[derive(Clone, Debug, Default)]
pub(super) struct Lattice {
    /// Crossing by (y, x), row-major.
    pub(super) nodes: BTreeMap<(i32, i32), usize>,
    /// Offset of a crossing's ray indices against the directions.
    pub(super) offset: BTreeMap<usize, usize>,
}

/// All lattices of at least `least` crossings, largest first.
pub(super) fn grow(
    saddles: &[Saddle],
    links: &Links,
    least: usize,
    config: &LatticeConfig,
) -> Vec<Lattice> {
    let mut taken = vec![false; saddles.len()];
    let mut lattices = Vec::new();
    for root in 0..saddles.len() {
        if taken[root] || links[root].iter().flatten().count() < 2 {
            continue;
        }
        let lattice = grow_from(saddles, links, root, &mut taken, config);
        let lattice = without_strays(saddles, lattice, config);
        if lattice.nodes.len() >= least {
            lattices.push(lattice);
        }
    }
    lattices.sort_by_key(|l| std::cmp::Reverse(l.nodes.len()));
    lattices
}

fn grow_from(
    saddles: &[Saddle],
    links: &Links,
    root: usize,
    taken: &mut [bool],
    config: &LatticeConfig,
) -> Lattice {
    let mut lattice = Lattice::default();
    lattice.nodes.insert((0, 0), root);
    lattice.offset.insert(root, 0);
    taken[root] = true;
    let mut open = VecDeque::from([(root, [0, 0])]);
    while let Some((node, [x, y])) = open.pop_front() {
        let offset = lattice.offset[&node];
        for ray in 0..4 {
            let Some((other, back)) = links[node][ray] else {
                continue;
            };
            let direction = (ray + offset) % 4;
            let there = [x + STEPS[direction][0], y + STEPS[direction][1]];
            if taken[other] || lattice.nodes.contains_key(&(there[1], there[0])) {
                continue;
            }
            if !alike(saddles, links, node, ray, config.max_step_ratio) {
                continue;
            }
            taken[other] = true;
            lattice.nodes.insert((there[1], there[0]), other);
            lattice.offset.insert(other, (direction + 2 + 4 - back) % 4);
            open.push_back((other, there));
        }
    }
    lattice
}

/// Whether the step along a ray has a similar length as the previous and the next one.
fn alike(saddles: &[Saddle], links: &Links, node: usize, ray: usize, most: f64) -> bool {
    let Some((other, back)) = links[node][ray] else {
        return false;
    };
    let length = distance(saddles[node].at, saddles[other].at);
    let before = links[node][(ray + 2) % 4].map(|(n, _)| distance(saddles[node].at, saddles[n].at));
    let after =
        links[other][(back + 2) % 4].map(|(n, _)| distance(saddles[other].at, saddles[n].at));
    [before, after]
        .into_iter()
        .flatten()
        .all(|l| l < most * length && length < most * l)
}

/// Removes crossings that are not between their neighbours, and crossings that are then isolated.
fn without_strays(saddles: &[Saddle], mut lattice: Lattice, config: &LatticeConfig) -> Lattice {
    let place = |nodes: &BTreeMap<(i32, i32), usize>, y: i32, x: i32| {
        nodes.get(&(y, x)).map(|n| saddles[*n].at)
    };
    let stray: Vec<(i32, i32)> = lattice
        .nodes
        .iter()
        .filter(|((y, x), node)| {
            [[1, 0], [0, 1]].iter().any(|[dx, dy]| {
                let ends = (
                    place(&lattice.nodes, y - dy, x - dx),
                    place(&lattice.nodes, y + dy, x + dx),
                );
                let (Some(a), Some(b)) = ends else {
                    return false;
                };
                let p = saddles[**node].at;
                let bend = [0, 1].map(|k| a[k] + b[k] - 2.0 * p[k]);
                distance(bend, [0.0; 2]) > config.max_bend_ratio * distance(a, b)
            })
        })
        .map(|(at, _)| *at)
        .collect();
    for at in &stray {
        lattice.nodes.remove(at);
    }
    lattice
}

impl Lattice {
    /// Least and largest x and y.
    pub(super) fn extent(&self) -> ([i32; 2], [i32; 2]) {
        let mut low = [i32::MAX; 2];
        let mut high = [i32::MIN; 2];
        for (y, x) in self.nodes.keys() {
            (low, high) = (
                [low[0].min(*x), low[1].min(*y)],
                [high[0].max(*x), high[1].max(*y)],
            );
        }
        (low, high)
    }

    /// Whether the square between a crossing and its neighbour diagonally down (+x, +y) is dark.
    /// `None` without a crossing, or for one without links.
    pub(super) fn is_dark(&self, (y, x): (i32, i32)) -> Option<bool> {
        // Sector k is between rays k and k + 1, even ones are dark; direction 0 is ray `-offset`.
        let node = self.nodes.get(&(y, x))?;
        Some(self.offset.get(node)? % 2 == 0)
    }

    /// Predicted position of a missing crossing from those around it; and the local step length.
    pub(super) fn guess(
        &self,
        at: impl Fn(usize) -> [f64; 2],
        (y, x): (i32, i32),
    ) -> Option<([f64; 2], f64)> {
        let place = |dy: i32, dx: i32| self.nodes.get(&(y + dy, x + dx)).map(|n| at(*n));
        let mut guesses: Vec<([f64; 2], f64)> = Vec::new();
        for [dx, dy] in [[1, 0], [0, 1]] {
            if let (Some(a), Some(b)) = (place(-dy, -dx), place(dy, dx)) {
                return Some(([0, 1].map(|k| 0.5 * (a[k] + b[k])), 0.5 * distance(a, b)));
            }
        }
        for [dx, dy] in STEPS {
            if let (Some(a), Some(b)) = (place(dy, dx), place(2 * dy, 2 * dx)) {
                guesses.push(([0, 1].map(|k| 2.0 * a[k] - b[k]), distance(a, b)));
            }
        }
        let count = guesses.len() as f64;
        let sum = guesses.iter().fold([0.0; 3], |[x, y, l], (at, length)| {
            [x + at[0], y + at[1], l + length]
        });
        let [x, y, length] = sum.map(|v| v / count);
        (count > 0.0).then_some(([x, y], length))
    }
}
