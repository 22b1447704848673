//! Places on the ground of a sector, and a prediction at each in some headings.

use crate::ground::Ground;

/// Height above or below a place at which its prediction no longer holds, m.
const MAX_HEIGHT_M: f64 = 1.0;
/// A place on which an agent can stand: of the positions around a point of the grid that nearest to
/// it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Node {
    pub(super) position_m: [f64; 3],
    /// Point of the grid, row by row.
    point: usize,
    layer: usize,
}

/// Places on the ground of a sector.
#[derive(Clone, Debug, Default)]
pub(super) struct Places {
    pub(super) nodes: Vec<Node>,
    cell_m: f64,
    corner_m: [f64; 2],
    size: [usize; 2],
    layers: usize,
}

impl Places {
    /// Where agents can stand, on all levels, as far as positions (m) are of the sector.
    pub(super) fn new(
        ground: &Ground,
        is_of_sector: impl Fn([f64; 3]) -> bool,
        cell_m: f64,
    ) -> Self {
        let levels = ground.levels().iter();
        let boxes = levels.map(|level| (level.grid.corner_m(), level.grid.size_m()));
        let extent = boxes
            .map(|(corner, size)| [corner, [0, 1].map(|k| corner[k] + size[k])])
            .reduce(|a, b| {
                let pick = |side: usize, of: fn(f64, f64) -> f64| {
                    [0, 1].map(|k| of(a[side][k], b[side][k]))
                };
                [pick(0, f64::min), pick(1, f64::max)]
            });
        let Some([corner_m, max_m]) = extent else {
            return Self::default();
        };
        // A point beyond each border.
        let size = [0, 1].map(|k| ((max_m[k] - corner_m[k]) / cell_m).ceil() as usize + 2);
        let mut places = Self {
            nodes: Vec::new(),
            cell_m,
            corner_m,
            size,
            layers: ground.levels().len(),
        };
        for layer in 0..places.layers {
            places.add_level(ground, &is_of_sector, layer);
        }
        places
    }

    fn add_level(
        &mut self,
        ground: &Ground,
        is_of_sector: impl Fn([f64; 3]) -> bool,
        layer: usize,
    ) {
        let level = &ground.levels()[layer];
        let mut nearest: Vec<Option<(f64, [f64; 3])>> = vec![None; self.size[0] * self.size[1]];
        for cell in 0..level.grid.cells() {
            let at_m = level.grid.center_m(cell);
            // Filled holes have no height of their own.
            let surface = ground.component(at_m, layer).and_then(|_| {
                let near_m = f64::from(level.elevation[cell]);
                let near_m = if near_m.is_finite() { near_m } else { 0.0 };
                ground.surface(at_m, near_m)
            });
            let Some(surface) = surface.filter(|surface| surface.level == layer) else {
                continue;
            };
            let position_m = [at_m[0], at_m[1], surface.height_m];
            if !is_of_sector(position_m) {
                continue;
            }
            let steps = [0, 1].map(|k| (at_m[k] - self.corner_m[k]) / self.cell_m);
            let [column, row] = steps.map(f64::round);
            let distance = libm::hypot(steps[0] - column, steps[1] - row);
            let slot = &mut nearest[row as usize * self.size[0] + column as usize];
            if slot.is_none_or(|(least, _)| distance < least) {
                *slot = Some((distance, position_m));
            }
        }
        let places = nearest.into_iter().enumerate();
        self.nodes.extend(places.filter_map(|(point, found)| {
            found.map(|(_, position_m)| Node {
                position_m,
                point,
                layer,
            })
        }));
    }
}

/// A place with its predictions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SupportNode<'a> {
    /// Position of an agent there, m.
    pub position_m: [f64; 3],
    /// Predicted PSNR by heading, dB; the first heading is along x, the others follow
    /// counterclockwise.
    pub psnr_db: &'a [f32],
}

/// Predicted PSNR of what agents see in a sector.
#[derive(Clone, Debug)]
pub struct SupportGrid {
    places: Places,
    headings: usize,
    /// By place and heading, dB.
    psnr_db: Vec<f32>,
    /// Place of each layer and point of the grid, [`NONE`] where nothing can stand.
    index: Vec<u32>,
}

const NONE: u32 = u32::MAX;

impl SupportGrid {
    /// With predictions by place and heading.
    pub(super) fn new(places: Places, headings: usize, psnr_db: Vec<f32>) -> Self {
        let points = places.size[0] * places.size[1];
        let mut index = vec![NONE; points * places.layers];
        for (number, node) in places.nodes.iter().enumerate() {
            if number < psnr_db.len() / headings.max(1) {
                index[node.layer * points + node.point] = number as u32;
            }
        }
        Self {
            places,
            headings,
            psnr_db,
            index,
        }
    }

    /// Places with their predictions.
    pub fn nodes(&self) -> impl Iterator<Item = SupportNode<'_>> {
        let predictions = self.psnr_db.chunks_exact(self.headings.max(1));
        let both = self.places.nodes.iter().zip(predictions);
        both.map(|(node, psnr_db)| SupportNode {
            position_m: node.position_m,
            psnr_db,
        })
    }

    /// Predicted PSNR of what an agent at a position (m) with a yaw (rad) sees, dB: bilinear
    /// between the points of the grid around it that have a place, linear between headings. 0
    /// where none of them has one within 1 m of the position's height.
    pub fn psnr_db(&self, position_m: [f64; 3], yaw_rad: f64) -> f64 {
        let Places {
            cell_m,
            corner_m,
            size,
            ..
        } = &self.places;
        let steps = [0, 1].map(|k| (position_m[k] - corner_m[k]) / cell_m);
        let is_inside = |k: usize| (0.0..(size[k] - 1) as f64).contains(&steps[k]);
        if self.psnr_db.is_empty() || !(is_inside(0) && is_inside(1) && yaw_rad.is_finite()) {
            return 0.0;
        }
        let [column, row] = steps.map(f64::floor);
        let [right, up] = [steps[0] - column, steps[1] - row];
        let first = row as usize * size[0] + column as usize;
        let turns = (yaw_rad / std::f64::consts::TAU).rem_euclid(1.0) * self.headings as f64;
        let before = turns.floor();
        let [heading, next] = [before as usize, before as usize + 1].map(|h| h % self.headings);
        let (mut sum, mut weights) = (0.0, 0.0);
        for layer in self.index.chunks_exact(size[0] * size[1]) {
            for (point, weight) in [
                (first, (1.0 - right) * (1.0 - up)),
                (first + 1, right * (1.0 - up)),
                (first + size[0], (1.0 - right) * up),
                (first + size[0] + 1, right * up),
            ] {
                let number = layer[point];
                if number == NONE {
                    continue;
                }
                let node = &self.places.nodes[number as usize];
                if (node.position_m[2] - position_m[2]).abs() > MAX_HEIGHT_M {
                    continue;
                }
                let at = |heading: usize| {
                    f64::from(self.psnr_db[number as usize * self.headings + heading])
                };
                let share = turns - before;
                sum += weight * ((1.0 - share) * at(heading) + share * at(next));
                weights += weight;
            }
        }
        if weights > 0.0 { sum / weights } else { 0.0 }
    }

    /// Memory, bytes.
    pub fn bytes(&self) -> usize {
        size_of_val(self.places.nodes.as_slice())
            + size_of_val(self.psnr_db.as_slice())
            + size_of_val(self.index.as_slice())
    }
}
