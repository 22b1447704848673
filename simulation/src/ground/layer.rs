//! A level, packed for look-ups.

use scene_bundle::outputs::grid::Grid;
use scene_bundle::outputs::maps::{EDGE, FILLED, FREE, KNOWN, MapLevel, OCCUPIED, SAMPLED};

use super::block::BlockReason;
use super::holes::{self, Kind};
use super::{Cover, Surface};
use crate::agent::config::AgentConfig;

/// Steepest surface over which heights are blended: cells that differ by more are different
/// surfaces, tangent.
const MAX_BLEND_SLOPE: f32 = 1.0;
/// Height difference of neighboring cells that is blended whatever the slope, m: noise.
const BLEND_NOISE_M: f32 = 0.01;
/// Marks a cell without a component.
pub(super) const NO_COMPONENT: u32 = u32::MAX;

/// What the motion of an agent needs of a cell.
#[derive(Clone, Copy, Debug)]
struct Cell {
    /// Slopes of the plane through the cell along x and y.
    slope: [f32; 2],
    component: u32,
    state: State,
    /// Why the agent's center cannot be here.
    block: Option<BlockReason>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Unknown,
    Free,
    Occupied,
    /// Not seen, within a bridge over a small hole.
    Bridged,
}

/// A level.
#[derive(Clone, Debug)]
pub(crate) struct Layer {
    grid: Grid,
    corner_m: [f64; 2],
    per_m: f64,
    /// Heights, m; NaN where there is none. By themselves: a look-up reads five numbers.
    heights_m: Vec<f32>,
    /// Distances to edges, obstacles and unknown cells, m; 0 in those. By themselves: rays read
    /// nothing else.
    distances_m: Vec<f32>,
    /// Whether heights are blended between the cell and those right, above and diagonal of it.
    is_blended: Vec<bool>,
    cells: Vec<Cell>,
    sigma_m: Vec<f32>,
    is_filled: Vec<bool>,
    /// Number of bridged holes.
    bridges: usize,
}

impl Layer {
    pub(super) fn new(level: &MapLevel, agent: &AgentConfig) -> Self {
        let grid = level.grid;
        let cell = |index: usize| {
            let state = match level.occupancy[index] {
                OCCUPIED => State::Occupied,
                FREE if level.has_height(index) => State::Free,
                _ => State::Unknown,
            };
            let [x, y, z] = level.normal[index];
            let slope = match z > 0.0 && x.is_finite() && y.is_finite() {
                true => [-x / z, -y / z],
                false => [0.0; 2],
            };
            Cell {
                slope,
                component: NO_COMPONENT,
                state,
                block: None,
            }
        };
        let height_m = |index: usize| match level.has_height(index) {
            true => level.elevation[index],
            false => f32::NAN,
        };
        let mut layer = Self {
            grid,
            corner_m: grid.corner_m(),
            per_m: 1.0 / grid.cell_m,
            heights_m: (0..grid.cells()).map(height_m).collect(),
            // The larger of a number and NaN is the number.
            distances_m: level.distance.iter().map(|m| m.max(0.0)).collect(),
            is_blended: Vec::new(),
            cells: (0..grid.cells()).map(cell).collect(),
            sigma_m: level.sigma.clone(),
            is_filled: level
                .flags
                .iter()
                .map(|flags| flags & FILLED != 0 && flags & (KNOWN | SAMPLED) == 0)
                .collect(),
            bridges: 0,
        };
        layer.bridge_holes(agent);
        layer.is_blended = (0..grid.cells())
            .map(|first| layer.is_one_surface(level, first))
            .collect();
        layer.set_blocks(level, agent);
        layer
    }

    /// Puts planes over small holes.
    fn bridge_holes(&mut self, agent: &AgentConfig) {
        let kind = |index: usize| match self.cells[index].state {
            State::Free => Kind::Free,
            State::Unknown if self.heights_m[index].is_nan() => Kind::Unknown,
            _ => Kind::Other,
        };
        let height_m = |index: usize| f64::from(self.heights_m[index]);
        let bridges = holes::find(&self.grid, agent, kind, height_m);
        self.bridges = bridges.len();
        for bridge in bridges {
            for index in bridge.cells.iter().copied() {
                self.heights_m[index] = bridge.height_m(self.grid.center_m(index)) as f32;
                self.sigma_m[index] = bridge.sigma_m as f32;
                self.is_filled[index] = true;
                self.cells[index].state = State::Bridged;
                self.cells[index].slope = bridge.slope.map(|slope| slope as f32);
            }
        }
    }

    /// Whether a cell and those right, above and diagonal of it are one surface.
    fn is_one_surface(&self, level: &MapLevel, first: usize) -> bool {
        let columns = self.grid.columns;
        let (column, row) = (first % columns, first / columns);
        if column + 1 >= columns || row + 1 >= self.grid.rows {
            return false;
        }
        let corners = [first, first + 1, first + columns, first + columns + 1];
        let heights = corners.map(|corner| self.heights_m[corner]);
        let low = heights.iter().copied().fold(f32::INFINITY, f32::min);
        let high = heights.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        // The diagonal of a cell.
        let limit = MAX_BLEND_SLOPE * 1.5 * self.grid.cell_m as f32 + BLEND_NOISE_M;
        heights.iter().all(|height| !height.is_nan())
            && high - low <= limit
            && corners
                .iter()
                .all(|corner| level.flags[*corner] & EDGE == 0)
    }

    /// Marks where the center of the agent cannot be.
    fn set_blocks(&mut self, level: &MapLevel, agent: &AgentConfig) {
        let (wide, narrow) = (agent.radius_m, agent.unknown_margin_m);
        let steepest = libm::tan(agent.max_slope_rad);
        let mut blocks: Vec<Option<BlockReason>> = vec![None; self.cells.len()];
        // Of several reasons one that is known comes first.
        for (number, cell) in self.cells.iter().enumerate() {
            let low_ceiling = f64::from(level.clearance[number]) < agent.height_m;
            let slope = cell.slope.map(f64::from);
            let is_steep = slope[0] * slope[0] + slope[1] * slope[1] > steepest * steepest;
            match cell.state {
                State::Occupied => {
                    self.stamp(number, wide, BlockReason::Obstacle, f32::MAX, &mut blocks);
                }
                State::Unknown => {
                    self.stamp(number, narrow, BlockReason::Unknown, f32::MAX, &mut blocks);
                }
                State::Free if low_ceiling => {
                    self.stamp(number, wide, BlockReason::Ceiling, f32::MAX, &mut blocks);
                }
                State::Free if is_steep && level.flags[number] & EDGE == 0 => {
                    self.stamp(number, 0.0, BlockReason::Step, f32::MAX, &mut blocks);
                }
                State::Free | State::Bridged => {}
            }
            if let Some(below_m) = self.wall(number, agent) {
                self.stamp(number, wide, BlockReason::Step, below_m, &mut blocks);
            }
        }
        for (cell, block) in self.cells.iter_mut().zip(blocks) {
            cell.block = block;
        }
    }

    /// The height at and below which a cell is a wall for agents: where another within two cells
    /// along an axis is lower by more than a step. Two, since a riser may pass through a cell.
    fn wall(&self, number: usize, agent: &AgentConfig) -> Option<f32> {
        let below_m = self.heights_m[number] - agent.max_step_m as f32;
        let (columns, rows) = (self.grid.columns, self.grid.rows);
        let (column, row) = (number % columns, number / columns);
        let is_lower = |other: usize| self.heights_m[other] < below_m;
        let is_wall = (1..=2).any(|k| {
            (column >= k && is_lower(number - k))
                || (column + k < columns && is_lower(number + k))
                || (row >= k && is_lower(number - k * columns))
                || (row + k < rows && is_lower(number + k * columns))
        });
        is_wall.then_some(below_m)
    }

    /// Marks the cells within a reach of one that are lower than a height.
    fn stamp(
        &self,
        number: usize,
        reach_m: f64,
        reason: BlockReason,
        below_m: f32,
        blocks: &mut [Option<BlockReason>],
    ) {
        let (columns, rows) = (self.grid.columns as i64, self.grid.rows as i64);
        let (column, row) = (number as i64 % columns, number as i64 / columns);
        // Centers of cells between which the distance is less than the reach and half of a cell.
        let reach = reach_m * self.per_m + 0.5;
        let span = reach as i64;
        for y in (row - span).max(0)..=(row + span).min(rows - 1) {
            for x in (column - span).max(0)..=(column + span).min(columns - 1) {
                let (dx, dy) = ((x - column) as f64, (y - row) as f64);
                if dx * dx + dy * dy >= reach * reach && (dx, dy) != (0.0, 0.0) {
                    continue;
                }
                let other = (y * columns + x) as usize;
                if self.heights_m[other] >= below_m {
                    continue;
                }
                let block = &mut blocks[other];
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

    pub(crate) fn clearance_m(&self, at_m: [f64; 2]) -> f64 {
        let index = self.index(at_m);
        index.map_or(0.0, |index| f64::from(self.distances_m[index]))
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

    /// Cell and its height at x, y; `None` where there is none.
    pub(super) fn height(&self, at_m: [f64; 2]) -> Option<(usize, f32)> {
        let index = self.index(at_m)?;
        let height_m = self.heights_m[index];
        (!height_m.is_nan()).then_some((index, height_m))
    }

    /// The surface at x, y within a cell that has a height: bilinear between the four cells around
    /// where they are one surface, otherwise the plane of the cell.
    pub(super) fn surface(&self, level: usize, at_m: [f64; 2], index: usize) -> Surface {
        let [x, y] = [0, 1].map(|k| (at_m[k] - self.corner_m[k]) * self.per_m - 0.5);
        let (height_m, slope) = self.blend(x, y).unwrap_or_else(|| {
            let column = (index % self.grid.columns) as f64;
            let row = (index / self.grid.columns) as f64;
            let offset = [x - column, y - row].map(|cells| cells * self.grid.cell_m);
            let slope = self.cells[index].slope.map(f64::from);
            let along = slope[0] * offset[0] + slope[1] * offset[1];
            (f64::from(self.heights_m[index]) + along, slope)
        });
        let up = 1.0 / (slope[0] * slope[0] + slope[1] * slope[1] + 1.0).sqrt();
        Surface {
            level,
            height_m,
            sigma_m: f64::from(self.sigma_m[index]),
            normal: [-slope[0] * up, -slope[1] * up, up],
            is_filled: self.is_filled[index],
        }
    }

    /// Height and slopes between the four cells around, in cells from the first center.
    fn blend(&self, x: f64, y: f64) -> Option<(f64, [f64; 2])> {
        if x < 0.0 || y < 0.0 {
            return None;
        }
        let (column, row) = (x as usize, y as usize);
        let first = row * self.grid.columns + column;
        if !self.is_blended[first] {
            return None;
        }
        let lower = &self.heights_m[first..first + 2];
        let upper = &self.heights_m[first + self.grid.columns..][..2];
        let [a, b, c, d] = [lower[0], lower[1], upper[0], upper[1]].map(f64::from);
        let (u, v) = (x - column as f64, y - row as f64);
        let (left, right) = (a + (c - a) * v, b + (d - b) * v);
        let along_x = right - left;
        let along_y = (c - a) + ((d - b) - (c - a)) * u;
        let slope = [along_x * self.per_m, along_y * self.per_m];
        Some((left + along_x * u, slope))
    }

    /// Its cells.
    pub(crate) fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Height of a cell, m; NaN where none is known.
    pub(crate) fn height_of_cell_m(&self, index: usize) -> f32 {
        self.heights_m[index]
    }

    /// Height of a cell where the agent's center can be, m.
    pub(crate) fn walkable_m(&self, index: usize) -> Option<f32> {
        let cell = &self.cells[index];
        let is_ground = matches!(cell.state, State::Free | State::Bridged);
        (is_ground && cell.block.is_none()).then_some(self.heights_m[index])
    }

    /// Number of bridged holes, and of cells in them.
    pub(super) fn bridges(&self) -> (usize, usize) {
        let cells = self.cells.iter();
        let cells = cells.filter(|cell| cell.state == State::Bridged);
        (self.bridges, cells.count())
    }

    pub(super) fn set_component(&mut self, index: usize, component: u32) {
        self.cells[index].component = component;
    }

    pub(super) fn has_component(&self, index: usize) -> bool {
        self.cells[index].component != NO_COMPONENT
    }
}
