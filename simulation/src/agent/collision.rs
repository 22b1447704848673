//! The way of an agent's center over the ground, in steps of half a cell.

use super::motion::Arc;
use super::{AgentState, Block, BlockReason};
use crate::ground::Ground;

/// How far an agent came.
#[derive(Clone, Copy, Debug)]
pub(super) struct Swept {
    /// Share of the motion that it could make.
    pub(super) share: f64,
    pub(super) position_m: [f64; 2],
    /// Height of the ground there, m.
    pub(super) height_m: f64,
    pub(super) level: usize,
    pub(super) blocked: Option<Block>,
}

/// Follows an arc until something blocks it. An agent that stands where it cannot be, as after a
/// reset by its user, may leave but not go deeper: each step has to lead to a free cell.
pub(super) fn sweep(ground: &Ground, state: &AgentState, arc: &Arc) -> Swept {
    let [x, y, z] = state.position_m;
    let here = ground.surface([x, y], z);
    let mut swept = Swept {
        share: 0.0,
        position_m: [x, y],
        height_m: here.map_or(z, |surface| surface.height_m),
        level: here.map_or(state.level, |surface| surface.level),
        blocked: None,
    };
    let steps = libm::ceil(arc.length_m / (0.5 * ground.cell_m())).max(1.0) as u32;
    for step in 1..=steps {
        let share = f64::from(step) / f64::from(steps);
        let at_m = arc.position_m(share);
        if at_m == swept.position_m {
            swept.share = share;
            continue;
        }
        match reason(ground, at_m, swept.height_m, &mut swept.level) {
            Ok(height_m) => {
                swept.share = share;
                swept.position_m = at_m;
                swept.height_m = height_m;
            }
            Err(reason) => {
                swept.blocked = Some(Block { reason, at_m });
                break;
            }
        }
    }
    swept
}

/// Height of the ground at x, y for an agent that comes from a height, or why it cannot be there.
fn reason(
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
    if let Some(block) = ground.block(at_m, surface.level) {
        return Err(block);
    }
    let step_m = surface.height_m - from_m;
    if step_m > ground.max_step_m() {
        return Err(BlockReason::Step);
    }
    if step_m < -ground.max_step_m() {
        return Err(BlockReason::Drop);
    }
    *level = surface.level;
    Ok(surface.height_m)
}
