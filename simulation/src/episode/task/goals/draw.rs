//! Draws of the goals of a world.

use std::ops::ControlFlow;

use rayon::prelude::*;

use super::Goal;
use crate::SimulationError;
use crate::episode::start::{self, Condition, Exclusions};
use crate::geodesic::DistanceField;
use crate::randomness::{RandomStream, Stream};
use crate::world::shared::Shared;

/// Draws of goals at most, per goal.
const TRIES: usize = 1000;
/// Directions of view at a goal.
const DIRECTIONS: u32 = 8;

/// Draws the goals of a world: as starts in free space, by the seed of the task. They depend
/// neither on the seed of the world nor on its number of environments.
///
/// # Errors
/// [`SimulationError::Start`] if none was found.
pub(crate) fn draw_all(shared: &Shared) -> Result<Vec<Goal>, SimulationError> {
    let task = &shared.config.task;
    let cells = &shared.candidates.cells;
    let mut exclusions = Exclusions::default();
    let mut positions = Vec::new();
    for number in 0..task.goals as u64 {
        let random = RandomStream::new(task.goal_seed, number, Stream::Goal);
        for draw in 0..TRIES as u64 {
            if cells.is_empty() {
                return Err(exclusions.error(0));
            }
            let cell = &cells[random.below(3 * draw, cells.len())];
            let half_m = 0.5 * cell.edge_m;
            let at_m = [0, 1].map(|k| {
                let offset = random.range(3 * draw + 1 + k as u64, [-half_m, half_m]);
                cell.center_m[k] + offset
            });
            // One direction of view that recorded cameras support is enough.
            let found = (0..DIRECTIONS).try_fold(Condition::Goal, |_, k| {
                let yaw_rad = std::f64::consts::TAU * f64::from(k) / f64::from(DIRECTIONS);
                let proposal = (cell.sector, at_m, cell.height_m, yaw_rad);
                // Breaks at the first that holds all conditions.
                match start::check(shared, proposal) {
                    Ok(found) => ControlFlow::Break(found),
                    Err(condition) => ControlFlow::Continue(condition),
                }
            });
            match found {
                ControlFlow::Break(found) => {
                    positions.push((found.sector, found.state.position_m));
                    break;
                }
                ControlFlow::Continue(condition) => exclusions.count(condition),
            }
        }
    }
    if positions.is_empty() {
        return Err(exclusions.error(TRIES * task.goals));
    }
    let goal = |&(sector, position_m): &(u32, [f64; 3])| {
        let terrain = &shared.terrains[sector as usize];
        let field = DistanceField::new(&terrain.ground, &shared.config.agent, position_m);
        Goal {
            frame: terrain.frame,
            position_m,
            field,
        }
    };
    Ok(positions.par_iter().map(goal).collect())
}
