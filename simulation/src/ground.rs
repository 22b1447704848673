//! The ground on which agents walk: heights, obstacles and what is not known.
//!
//! Contract: everything comes from output `maps`. Heights are blended only within one continuous
//! surface, never over the edge of a step. Where no view saw the ground there is no height, and
//! unknown is not free, but for small holes that free ground on one plane encloses, see
//! [`AgentConfig::max_hole_m2`]. What blocks an agent depends on its size: obstacles, walls above
//! its step and ceilings keep its center a radius away.

mod block;
mod components;
mod holes;
mod layer;

#[cfg(test)]
mod tests;

use scene_bundle::outputs::maps::MapLevel;

pub use block::{Block, BlockReason};

use crate::agent::config::AgentConfig;
use crate::error::SimulationError;
pub(crate) use components::neighbors;
pub(crate) use layer::Layer;

/// Heights of two levels that are one surface, m.
const SAME_SURFACE_M: f32 = 0.01;

/// Walkable levels of a scene, for agents of one size.
///
/// ```
/// use simulation::testing::SyntheticScene;
/// use simulation::{AgentConfig, Cover, Ground};
///
/// let stairs = SyntheticScene::stairs()?;
/// let levels = stairs.scene.sectors[0].levels.as_ref().unwrap();
/// let ground = Ground::new(levels.to_vec(), &AgentConfig::default())?;
/// // On the third step of 15 cm.
/// let surface = ground.surface([2.75, 1.5], 0.4).unwrap();
/// assert!((surface.height_m - 0.45).abs() < 1e-6);
/// assert_eq!(ground.cover([-5.0, 0.0], 0), Cover::Unknown);
/// # Ok::<(), simulation::SimulationError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Ground {
    levels: Vec<MapLevel>,
    layers: Vec<Layer>,
    max_step_m: f64,
}

/// The ground at a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surface {
    /// Index of its level.
    pub level: usize,
    /// Height, m.
    pub height_m: f64,
    /// One standard deviation of the height, m.
    pub sigma_m: f64,
    /// Upward normal.
    pub normal: [f64; 3],
    /// Whether the height is that of the plane around a small hole, not an observed one: by the
    /// maps, or by a bridge of this ground.
    pub is_filled: bool,
}

/// What is on the ground at a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cover {
    /// Nothing: it can be walked on.
    Free,
    /// An obstacle.
    Occupied,
    /// It was not seen, or is outside of the map.
    Unknown,
}

impl Ground {
    /// From levels, for agents of this size.
    ///
    /// # Errors
    /// [`SimulationError::Scene`] without levels, and for a level whose layers have another number
    /// of cells than its grid; [`SimulationError::Setting`] for a size that is no size.
    pub fn new(levels: Vec<MapLevel>, agent: &AgentConfig) -> Result<Self, SimulationError> {
        agent.check()?;
        if levels.is_empty() {
            return Err(SimulationError::Scene {
                place: "maps".to_owned(),
                found: "no level".to_owned(),
                expected: "at least one walkable level".to_owned(),
            });
        }
        for (number, level) in levels.iter().enumerate() {
            let cells = level.grid.cells();
            let of_numbers = level.numbers().map(|(_, values)| values.len());
            let others = [level.normal.len(), level.occupancy.len(), level.flags.len()];
            if of_numbers
                .iter()
                .chain(&others)
                .any(|count| *count != cells)
            {
                return Err(SimulationError::Scene {
                    place: format!("maps, level {number}"),
                    found: "a layer with another number of cells".to_owned(),
                    expected: format!("{cells} cells, as its grid has"),
                });
            }
        }
        let mut layers: Vec<Layer> = levels.iter().map(|l| Layer::new(l, agent)).collect();
        components::label(&mut layers, agent);
        Ok(Self {
            levels,
            layers,
            max_step_m: agent.max_step_m,
        })
    }

    /// The levels.
    pub fn levels(&self) -> &[MapLevel] {
        &self.levels
    }

    /// The surface at x, y whose cell is nearest to z in height, all in m; `None` outside of the
    /// maps and where nothing is known. Where levels overlap it is on the one that has an obstacle
    /// there, then on one where the agent can be.
    pub fn surface(&self, at_m: [f64; 2], near_z_m: f64) -> Option<Surface> {
        struct Nearest {
            height_m: f32,
            level: usize,
            cell: usize,
        }
        // At the end of a level its unknown surroundings are known to the level that overlaps it.
        let rank = |level: usize| match self.layers[level].block(at_m) {
            Some(BlockReason::OutsideMap | BlockReason::Unknown) => 0,
            None => 1,
            Some(_) => 2,
        };
        let mut nearest: Option<Nearest> = None;
        for (level, layer) in self.layers.iter().enumerate() {
            let Some((cell, height_m)) = layer.height(at_m) else {
                continue;
            };
            let distance_m = |height_m: f32| (f64::from(height_m) - near_z_m).abs();
            let is_nearer = nearest.as_ref().is_none_or(|other| {
                let is_same = (height_m - other.height_m).abs() <= SAME_SURFACE_M;
                match is_same && rank(level) != rank(other.level) {
                    true => rank(level) > rank(other.level),
                    false => distance_m(height_m) < distance_m(other.height_m),
                }
            });
            if is_nearer {
                nearest = Some(Nearest {
                    height_m,
                    level,
                    cell,
                });
            }
        }
        let Nearest { level, cell, .. } = nearest?;
        Some(self.layers[level].surface(level, at_m, cell))
    }

    /// Holes of a level that agents may cross on a plane through their rims, and cells in them.
    /// [`Surface::is_filled`] is set there and [`Self::cover`] is unknown.
    pub fn bridges(&self, level: usize) -> (usize, usize) {
        self.layers.get(level).map_or((0, 0), Layer::bridges)
    }

    /// What is at x, y on a level; unknown for a level that does not exist.
    pub fn cover(&self, at_m: [f64; 2], level: usize) -> Cover {
        let layer = self.layers.get(level);
        layer.map_or(Cover::Unknown, |layer| layer.cover(at_m))
    }

    /// Horizontal distance from x, y to the nearest edge, obstacle or unknown cell of a level, m;
    /// 0 in those and outside of the map. Cells of bridges are unknown ones.
    pub fn clearance_m(&self, at_m: [f64; 2], level: usize) -> f64 {
        let layer = self.layers.get(level);
        layer.map_or(0.0, |layer| layer.clearance_m(at_m))
    }

    /// The connected part of the ground at x, y of a level in which the agent can walk without
    /// steps above its limit; `None` where its center cannot be. Parts reach over several levels.
    pub fn component(&self, at_m: [f64; 2], level: usize) -> Option<u32> {
        self.layers.get(level)?.component(at_m)
    }

    /// Why the center of the agent cannot be at x, y on the level at the height of its feet; `None`
    /// where it can.
    pub fn block(&self, at_m: [f64; 2], level: usize) -> Option<BlockReason> {
        self.layers
            .get(level)
            .map_or(Some(BlockReason::OutsideMap), |layer| layer.block(at_m))
    }

    /// Whether x, y is within the grid of a level.
    pub(crate) fn is_inside(&self, at_m: [f64; 2]) -> bool {
        self.layers.iter().any(|layer| layer.is_inside(at_m))
    }

    /// Edge of the finest cell, m.
    pub(crate) fn cell_m(&self) -> f64 {
        let cells = self.levels.iter().map(|level| level.grid.cell_m);
        cells.fold(f64::INFINITY, f64::min)
    }

    /// Largest step of the agent, m.
    pub(crate) fn max_step_m(&self) -> f64 {
        self.max_step_m
    }

    /// Packed levels.
    pub(crate) fn layers(&self) -> &[Layer] {
        &self.layers
    }
}
