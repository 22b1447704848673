//! A level, packed for look-ups.

use scene_bundle::outputs::grid::Grid;
use scene_bundle::outputs::maps::{EDGE, FILLED, FREE, KNOWN, MapLevel, OCCUPIED, SAMPLED};

use super::{Cover, Surface};
use crate::agent::{AgentConfig, BlockReason};

/// Steepest surface over which heights are blended: cells that differ by more are different
/// surfaces, tangent.
const MAX_BLEND_SLOPE: f32 = 1.0;
/// Height difference of neighboring cells that is blended whatever the slope, m: noise.
const BLEND_NOISE_M: f32 = 0.01;
/// Marks a cell without a component.
pub(super) const NO_COMPONENT: u32 = u32::MAX;

/// What a look-up needs of a cell, in one cache line's quarter.
#[derive(Clone, Copy, Debug)]
struct Cell {
    height_m: f32,
    /// Slopes of the plane through the cell along x and y.
    slope: [f32; 2],
    /// Signed distance to edges, obstacles and unknown cells, m.
    distance_m: f32,
    component: u32,
    state: State,
    /// Why the agent's center cannot be here.
    block: Option<BlockReason>,
    has_edge: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Unknown,
    Free,
    Occupied,
}

/// A level.
#[derive(Clone, Debug)]
pub(crate) struct Layer {
    grid: Grid,
    corner_m: [f64; 2],
    per_m: f64,
    cells: Vec<Cell>,
    sigma_m: Vec<f32>,
    is_filled: Vec<bool>,
}

impl Layer {
    pub(super) fn new(level: &MapLevel, agent: &AgentConfig) -> Self {
        let grid = level.grid;
        let cell = |index: usize| {
            let has_height = level.has_height(index);
            let state = match level.occupancy[index] {
                OCCUPIED => State::Occupied,
                FREE if has_height => State::Free,
                _ => State::Unknown,
            };
            let [x, y, z] = level.normal[index];
            let slope = match z > 0.0 && x.is_finite() && y.is_finite() {
                true => [-x / z, -y / z],
                false => [0.0; 2],
            };
            let distance_m = level.distance[index];
            Cell {
                height_m: if has_height {
                    level.elevation[index]
                } else {
                    f32::NAN
                },
                slope,
                distance_m: if distance_m.is_nan() {
                    0.0
                } else {
                    distance_m.max(0.0)
                },
                component: NO_COMPONENT,
                state,
                block: None,
                has_edge: level.flags[index] & EDGE != 0,
            }
        };
        let mut layer = Self {
            grid,
            corner_m: grid.corner_m(),
            per_m: 1.0 / grid.cell_m,
            cells: (0..grid.cells()).map(cell).collect(),
            sigma_m: level.sigma.clone(),
            is_filled: level
                .flags
                .iter()
                .map(|flags| flags & FILLED != 0 && flags & (KNOWN | SAMPLED) == 0)
                .collect(),
        };
        layer.set_blocks(level, agent);
        layer
    }

    /// Marks where the center of the agent cannot be.
    fn set_blocks(&mut self, level: &MapLevel, agent: &AgentConfig) {
        let radius = |metres: f64| metres * self.per_m;
        let (wide, narrow) = (radius(agent.radius_m), radius(agent.unknown_margin_m));
        let mut blocks: Vec<Option<BlockReason>> = vec![None; self.cells.len()];
        // What is known to be in the way is the reason where several are.
        for (number, cell) in self.cells.iter().enumerate() {
            let low_ceiling = f64::from(level.clearance[number]) < agent.height_m;
            let reason = match cell.state {
                State::Occupied => BlockReason::Obstacle,
                State::Free if low_ceiling => BlockReason::Ceiling,
                State::Free => continue,
                State::Unknown => BlockReason::Unknown,
            };
            let reach = if reason == BlockReason::Unknown {
                narrow
            } else {
                wide
            };
            self.stamp(number, reach, reason, &mut blocks);
        }
        for (cell, block) in self.cells.iter_mut().zip(blocks) {
            cell.block = block;
        }
    }

    /// Marks the cells around one.
    fn stamp(
        &self,
        number: usize,
        reach: f64,
        reason: BlockReason,
        blocks: &mut [Option<BlockReason>],
    ) {
        let (columns, rows) = (self.grid.columns as i64, self.grid.rows as i64);
        let (column, row) = (number as i64 % columns, number as i64 / columns);
        // Centers of cells between which the distance is less than the reach and half of a cell.
        let limit = (reach + 0.5) * (reach + 0.5);
        let span = (reach + 0.5) as i64;
        for y in (row - span).max(0)..=(row + span).min(rows - 1) {
            for x in (column - span).max(0)..=(column + span).min(columns - 1) {
                let (dx, dy) = ((x - column) as f64, (y - row) as f64);
                if dx * dx + dy * dy >= limit && (dx, dy) != (0.0, 0.0) {
                    continue;
                }
                let block = &mut blocks[(y * columns + x) as usize];
                if block.is_none_or(|before| before == BlockReason::Unknown) {
                    *block = Some(reason);
                }
            }
        }
    }

    /// Index of the cell at x, y.
    fn index(&self, at_m: [f64; 2]) -> Option<usize> {
        let [x, y] = [0, 1].map(|k| (at_m[k] - self.corner_m[k]) * self.per_m);
        let inside =
            x >= 0.0 && y >= 0.0 && x < self.grid.columns as f64 && y < self.grid.rows as f64;
        inside.then(|| y as usize * self.grid.columns + x as usize)
    }

    pub(super) fn is_inside(&self, at_m: [f64; 2]) -> bool {
        self.index(at_m).is_some()
    }

    pub(super) fn cover(&self, at_m: [f64; 2]) -> Cover {
        match self.index(at_m).map(|index| self.cells[index].state) {
            Some(State::Free) => Cover::Free,
            Some(State::Occupied) => Cover::Occupied,
            _ => Cover::Unknown,
        }
    }

    pub(super) fn clearance_m(&self, at_m: [f64; 2]) -> f64 {
        let index = self.index(at_m);
        index.map_or(0.0, |index| f64::from(self.cells[index].distance_m))
    }

    pub(super) fn component(&self, at_m: [f64; 2]) -> Option<u32> {
        let component = self.cells[self.index(at_m)?].component;
        (component != NO_COMPONENT).then_some(component)
    }

    pub(super) fn block(&self, at_m: [f64; 2]) -> Option<BlockReason> {
        match self.index(at_m) {
            Some(index) => self.cells[index].block,
            None => Some(BlockReason::OutsideMap),
        }
    }

    /// The surface at x, y: bilinear between the four cells around where they are one surface,
    /// otherwise the plane of the cell.
    pub(super) fn surface(&self, level: usize, at_m: [f64; 2]) -> Option<Surface> {
        let index = self.index(at_m)?;
        let own = &self.cells[index];
        if own.height_m.is_nan() {
            return None;
        }
        let [x, y] = [0, 1].map(|k| (at_m[k] - self.corner_m[k]) * self.per_m - 0.5);
        let blended = (!own.has_edge).then(|| self.blend(x, y)).flatten();
        let (height_m, slope) = blended.unwrap_or_else(|| {
            let column = (index % self.grid.columns) as f64;
            let row = (index / self.grid.columns) as f64;
            let offset = [x - column, y - row].map(|cells| cells * self.grid.cell_m);
            let slope = own.slope.map(f64::from);
            let along = slope[0] * offset[0] + slope[1] * offset[1];
            (f64::from(own.height_m) + along, slope)
        });
        let length = (slope[0] * slope[0] + slope[1] * slope[1] + 1.0).sqrt();
        Some(Surface {
            level,
            height_m,
            sigma_m: f64::from(self.sigma_m[index]),
            normal: [-slope[0] / length, -slope[1] / length, 1.0 / length],
            is_filled: self.is_filled[index],
        })
    }

    /// Height and slopes between the four cells around, in cells from the first center.
    fn blend(&self, x: f64, y: f64) -> Option<(f64, [f64; 2])> {
        let (column, row) = (libm::floor(x), libm::floor(y));
        let columns = self.grid.columns as f64;
        if column < 0.0
            || row < 0.0
            || column + 1.0 >= columns
            || row + 1.0 >= self.grid.rows as f64
        {
            return None;
        }
        let first = row as usize * self.grid.columns + column as usize;
        let corners = [
            first,
            first + 1,
            first + self.grid.columns,
            first + self.grid.columns + 1,
        ];
        let cells = corners.map(|corner| &self.cells[corner]);
        let heights = cells.map(|cell| cell.height_m);
        let low = heights.iter().copied().fold(f32::INFINITY, f32::min);
        let high = heights.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        // The diagonal of a cell.
        let limit = MAX_BLEND_SLOPE * 1.5 * self.grid.cell_m as f32 + BLEND_NOISE_M;
        let is_one = heights.iter().all(|height| !height.is_nan())
            && high - low <= limit
            && cells.iter().all(|cell| !cell.has_edge);
        if !is_one {
            return None;
        }
        let [a, b, c, d] = heights.map(f64::from);
        let (u, v) = (x - column, y - row);
        let height = a * (1.0 - u) * (1.0 - v) + b * u * (1.0 - v) + c * (1.0 - u) * v + d * u * v;
        let along_x = ((b - a) * (1.0 - v) + (d - c) * v) * self.per_m;
        let along_y = ((c - a) * (1.0 - u) + (d - b) * u) * self.per_m;
        Some((height, [along_x, along_y]))
    }

    /// Its cells.
    pub(crate) fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Height of a cell where the agent's center can be, m.
    pub(crate) fn walkable_m(&self, index: usize) -> Option<f32> {
        let cell = &self.cells[index];
        (cell.state == State::Free && cell.block.is_none()).then_some(cell.height_m)
    }

    pub(super) fn set_component(&mut self, index: usize, component: u32) {
        self.cells[index].component = component;
    }

    pub(super) fn has_component(&self, index: usize) -> bool {
        self.cells[index].component != NO_COMPONENT
    }
}
