//! Codes of what stops a motion.

use crate::agent::BlockReason;

pub(crate) const OUTSIDE_MAP: i8 = 1;
pub(crate) const UNKNOWN: i8 = 2;

/// Code of a reason in [`StepResult::blocked`](crate::StepResult); 0 is none.
pub fn block_code(reason: BlockReason) -> i8 {
    match reason {
        BlockReason::OutsideMap => OUTSIDE_MAP,
        BlockReason::Unknown => UNKNOWN,
        BlockReason::Obstacle => 3,
        BlockReason::Step => 4,
        BlockReason::Drop => 5,
        BlockReason::Ceiling => 6,
    }
}

/// Whether a code is that of a collision: something known is in the path.
pub(crate) fn is_collision(code: i8) -> bool {
    code > UNKNOWN
}
