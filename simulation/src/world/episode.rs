//! What an environment remembers of its episode.

use crate::episode::end::EndReason;
use crate::episode::randomization::EpisodeParameters;

/// What an environment remembers of its episode besides the agent's state.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Episode {
    pub(crate) seed: u64,
    /// Episodes since the seed was given.
    pub(crate) number: u64,
    pub(crate) steps: u64,
    pub(crate) phase: Phase,
    pub(crate) end: EndReason,
    /// A pose that is not finite came from outside.
    pub(crate) is_faulty: bool,
    pub(crate) parameters: EpisodeParameters,
    pub(crate) target: Target,
    /// Distance to the goal or the end of the path at the start, m.
    pub(crate) first_m: f64,
    /// The same now.
    pub(crate) remaining_m: f64,
    pub(crate) path_length_m: f64,
    pub(crate) collisions: u32,
    pub(crate) clipped: u32,
}

/// Where an environment is in its life.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
pub(crate) enum Phase {
    /// Before the first reset.
    New = 0,
    Running = 1,
    /// Until the next reset.
    Ended = 2,
}

/// What the agent is to do.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Target {
    /// Reach the goal of this index, at a position in the frame of the agent's sector.
    Goal { index: u32, position_m: [f64; 3] },
    /// Follow the path, of which it has walked so much.
    Path { along_m: f64 },
    /// Hold the command of the time.
    Command,
}

impl Episode {
    pub(crate) fn new(seed: u64) -> Self {
        Self {
            seed,
            number: 0,
            steps: 0,
            phase: Phase::New,
            end: EndReason::None,
            is_faulty: false,
            parameters: EpisodeParameters::NOMINAL,
            target: Target::Command,
            first_m: 0.0,
            remaining_m: 0.0,
            path_length_m: 0.0,
            collisions: 0,
            clipped: 0,
        }
    }
}
