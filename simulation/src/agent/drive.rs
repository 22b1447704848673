//! What the components of an action mean.

use serde::{Deserialize, Serialize};

/// How actions move an agent. Each component of an action is -1 to 1, as part of the limit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Drive {
    /// Speed forward, rate of turn to the left.
    #[default]
    Differential,
    /// Speed of the left and of the right wheel.
    Wheels,
    /// Speed forward and to the left, rate of turn to the left.
    Holonomic,
    /// A free camera without ground: speed forward, to the left and up, rates of roll, pitch and
    /// yaw.
    Free,
}

impl Drive {
    /// Number of components of an action.
    pub fn action_size(self) -> usize {
        match self {
            Self::Differential | Self::Wheels => 2,
            Self::Holonomic => 3,
            Self::Free => 6,
        }
    }
}
