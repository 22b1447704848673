//! Checks of the inputs by feet: clocks of cameras, poses of the rig, and feet that slide.
//!
//! Contract: nothing here changes an observation. A check returns what it finds; reports
//! and corrections are those of the stage `feet`.

pub mod camera_clock;
pub mod jump;
pub mod slide;
pub mod trajectory_step;
