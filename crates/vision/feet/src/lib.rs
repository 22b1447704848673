//! Feet of a person who wears the rig.
//!
//! [`tag_tracker`] finds the tags on the shoes in the frames of stereo cameras, where the poses of
//! the rig are known. From the poses of a foot in these frames, [`stance`] finds where it is at
//! rest.
//!
//! Frames: the world has z up; the frame of a foot has its origin in the middle of the sole, x to
//! the toe, y to the left, z up from the sole. Nothing here knows sessions, files or images other
//! than gray ones.

pub mod causal;
pub mod checks;
mod config;
mod contact;
mod deviation;
pub mod events;
mod eye_agreement;
mod ground;
pub mod observation;
mod poses;
mod prediction;
mod repeated_image;
pub mod shoe;
pub mod stance;
pub mod swing;
mod swing_clearance;
pub mod swing_habit;
pub mod tag_placement;
pub mod tag_tracker;
#[cfg(test)]
mod test_noise;
pub mod track;

pub use config::{
    ClockConfig, Config, EventConfig, FootConfig, GaitConfig, JumpConfig, PlacementConfig,
    PredictionConfig, RepeatedConfig, SearchConfig, SlideConfig, StanceConfig, SwingConfig,
};
