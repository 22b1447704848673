//! What a map claimed, to be checked later.

use super::fit::Line;

/// Line by which times were given at device time `x`, to be checked against later knowledge.
#[derive(Clone, Copy, Debug)]
pub(super) struct Claim {
    pub(super) x: f64,
    pub(super) line: Line,
    pub(super) sigma: f64,
    pub(super) arrival: i64,
}
