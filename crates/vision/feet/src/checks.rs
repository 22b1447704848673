//! Checks of the inputs by feet: clocks of cameras, poses of the rig, and feet that slide.
//!
//! Contract: nothing here changes an observation. A check returns what it finds; reports
//! and corrections are those of the stage `feet`.

mod camera_clock;
mod jump;
mod position_jump;
mod slide;
mod unseen_interval;

pub use self::{
    camera_clock::{RestFrame, clock_error, pose_drift},
    jump::{Jump, jumps},
    position_jump::{RigPosition, position_jumps},
    slide::slides,
    unseen_interval::unseen_intervals,
};
