//! When two depths are of different surfaces.

use crate::instructions::larger;

/// A depth deviates from a surface by this many sigmas, or by a step.
const STEP_SIGMAS: f32 = 5.0;

/// Difference of depths that is a step.
#[inline(always)]
pub(crate) fn step(step_ratio: f32, depth: f32, sigma: f32) -> f32 {
    larger(STEP_SIGMAS * sigma, step_ratio * depth)
}
