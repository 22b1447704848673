//! The path of an agent's center over the ground, in steps of half a cell.

use scene_bundle::outputs::grid::Grid;

use super::motion::Arc;
use super::state::AgentState;
use crate::ground::{Block, BlockReason, Ground};

#[cfg(test)]
mod tests;

/// Largest turn within a step, rad: a chord of half a cell of 5 cm is 0.8 mm off its arc.
const MAX_STEP_TURN_RAD: f64 = 0.25;

/// How far an agent came.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sweep {
    /// Share of the motion that it could make.
    pub(super) share: f64,
    pub(super) position_m: [f64; 2],
    /// Height of the ground there, m.
    pub(super) height_m: f64,
    pub(super) level: usize,
    /// What blocked it first.
    pub(super) blocked: Option<Block>,
    /// Length of the path, m.
    pub(super) length_m: f64,
}

/// Follows an arc until something blocks it, or slides along that. An agent that stands where it
/// cannot be, as after a reset by its user, may leave but not go deeper: each step has to lead to a
/// free cell.
pub(super) fn sweep(ground: &Ground, slides: bool, state: &AgentState, arc: &Arc) -> Sweep {
    let [x, y, z] = state.position_m;
    let here = ground.surface([x, y], z);
    let mut sweep = Sweep {
        share: 0.0,
        position_m: [x, y],
        height_m: here.map_or(z, |surface| surface.height_m),
        level: here.map_or(state.level, |surface| surface.level),
        blocked: None,
        length_m: 0.0,
    };
    let steps = libm::ceil(arc.length_m / (0.5 * ground.cell_m()));
    // Chords of tight arcs stay within a millimetre of them.
    let turns = match arc.length_m > 0.0 {
        true => libm::ceil(arc.turn_rad.abs() / MAX_STEP_TURN_RAD),
        false => 1.0,
    };
    let steps = steps.max(turns).max(1.0) as u32;
    let step_m = arc.length_m / f64::from(steps);
    let mut before_m = [x, y];
    for step in 1..=steps {
        let share = f64::from(step) / f64::from(steps);
        let arc_m = arc.position_m(share);
        // As long as nothing blocked it the position is that of the arc, without sums.
        let at_m = match sweep.blocked {
            None => arc_m,
            Some(_) => [0, 1].map(|k| sweep.position_m[k] + arc_m[k] - before_m[k]),
        };
        match sweep.go(ground, at_m) {
            Ok(()) => sweep.length_m += step_m,
            Err(reason) => {
                sweep.blocked = sweep.blocked.or(Some(Block { reason, at_m }));
                if !slides {
                    break;
                }
                sweep.slide(ground, at_m);
            }
        }
        sweep.share = share;
        before_m = arc_m;
    }
    sweep
}

impl Sweep {
    /// Goes straight to a point at most half a cell away, over all cells between.
    fn go(&mut self, ground: &Ground, at_m: [f64; 2]) -> Result<(), BlockReason> {
        if at_m == self.position_m {
            return Ok(());
        }
        let mut level = self.level;
        let mut height_m = self.height_m;
        let passed = cell_between(&ground.levels()[level].grid, self.position_m, at_m);
        for at_m in passed.into_iter().chain([at_m]) {
            height_m = free_height_m(ground, at_m, height_m, &mut level)?;
        }
        self.position_m = at_m;
        self.height_m = height_m;
        self.level = level;
        Ok(())
    }

    /// Goes on along the side of the blocking cell: sides of cells are along the axes.
    fn slide(&mut self, ground: &Ground, at_m: [f64; 2]) {
        let offset_m = [0, 1].map(|k| at_m[k] - self.position_m[k]);
        let first = usize::from(offset_m[1].abs() > offset_m[0].abs());
        for axis in [first, 1 - first] {
            let mut along_m = self.position_m;
            along_m[axis] += offset_m[axis];
            if offset_m[axis] != 0.0 && self.go(ground, along_m).is_ok() {
                self.length_m += offset_m[axis].abs();
                return;
            }
        }
    }
}

/// A point in the cell that a line passes between two cells that touch at a corner.
fn cell_between(grid: &Grid, a: [f64; 2], b: [f64; 2]) -> Option<[f64; 2]> {
    let corner_m = grid.corner_m();
    let mut sum = 0.0;
    for k in 0..2 {
        let cell = |at: [f64; 2]| libm::floor((at[k] - corner_m[k]) / grid.cell_m);
        let (from, to) = (cell(a), cell(b));
        if from == to {
            return None;
        }
        let line_m = corner_m[k] + from.max(to) * grid.cell_m;
        sum += (line_m - a[k]) / (b[k] - a[k]);
    }
    Some([0, 1].map(|k| a[k] + 0.5 * sum * (b[k] - a[k])))
}

/// Height of the ground at x, y for an agent that comes from a height, or why it cannot be there.
pub(super) fn free_height_m(
    ground: &Ground,
    at_m: [f64; 2],
    from_m: f64,
    level: &mut usize,
) -> Result<f64, BlockReason> {
    let Some(surface) = ground.surface(at_m, from_m) else {
        return Err(match ground.block(at_m, *level) {
            _ if !ground.is_inside(at_m) => BlockReason::OutsideMap,
            Some(known @ (BlockReason::Obstacle | BlockReason::Ceiling)) => known,
            _ => BlockReason::Unknown,
        });
    };
    let step_m = surface.height_m - from_m;
    match ground.block(at_m, surface.level) {
        // Below a wall, from above.
        Some(BlockReason::Step) if step_m < -ground.max_step_m() => return Err(BlockReason::Drop),
        Some(block) => return Err(block),
        None => {}
    }
    if step_m > ground.max_step_m() {
        return Err(BlockReason::Step);
    }
    if step_m < -ground.max_step_m() {
        return Err(BlockReason::Drop);
    }
    *level = surface.level;
    Ok(surface.height_m)
}
