//! What stops an agent.

/// Why an agent stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlockReason {
    /// Outside of the map.
    OutsideMap,
    /// Ground that no view saw.
    Unknown,
    /// An obstacle.
    Obstacle,
    /// A step up, or a slope, above the limit.
    Step,
    /// A step down above the limit.
    Drop,
    /// A ceiling below the height of the agent.
    Ceiling,
}

/// What an agent stopped at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    /// Why.
    pub reason: BlockReason,
    /// Where its center could not go, x and y, m.
    pub at_m: [f64; 2],
}
