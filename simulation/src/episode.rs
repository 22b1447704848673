//! Episodes: where they start, what they are for, what they are worth and when they end.

pub(crate) mod end;
pub(crate) mod path;
pub(crate) mod randomization;
pub(crate) mod reward;
pub(crate) mod start;
pub(crate) mod task;

pub use end::{EndConfig, EndReason};
pub use randomization::RandomizationConfig;
pub use reward::{REWARD_TERMS, RewardConfig};
pub use start::{StartConfig, StartMode};
pub use task::{Task, TaskConfig};
