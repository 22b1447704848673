//! What a step gives for each environment.

use super::columns::columns;
use crate::episode::{EndReason, REWARD_TERMS};

columns! {
    /// Results of the last step or reset, one value per environment. Environments that ended
    /// before a step do not take part in it: reward 0, no flag, everything else as it was.
    ///
    /// All numbers are finite. A deviation of -1 means that the scene has no recorded cameras, a
    /// support of 0 dB may mean that the world predicts none.
    #[derive(Clone, Debug, PartialEq)]
    pub struct StepResult, ResultRows {
        /// Sum of the terms times their weights.
        rewards: f64 = 0.0,
        /// Terms of the reward, as [`REWARD_TERMS`] names them.
        reward_terms: [f64; REWARD_TERMS.len()] = [0.0; REWARD_TERMS.len()],
        /// Whether the task ended in this step.
        terminated: bool = false,
        /// Whether the simulation ended in this step and the task did not.
        truncated: bool = false,
        /// Codes of [`EndReason`] of this step.
        end_reasons: i8 = EndReason::None as i8,
        /// What stopped the motion of this step: 0 for nothing, otherwise the codes of
        /// [`block_code`](crate::block_code).
        blocked: i8 = 0,
        /// Distance from the nearest recorded camera, m.
        deviation_m: f32 = -1.0,
        /// Angle from its optical axis, rad.
        deviation_rad: f32 = -1.0,
        /// Predicted PSNR of the camera's view, dB.
        support_db: f32 = 0.0,
        /// Steps of the episode that were stopped.
        collisions: u32 = 0,
        /// Components of actions of the episode that were beyond -1 to 1 and clipped.
        clipped: u32 = 0,
        /// Steps of the episode.
        steps: u32 = 0,
        /// Path length of the episode, m.
        path_length_m: f32 = 0.0,
        /// Distance to the goal along the ground, or to the end of the path, m; 0 for velocities.
        remaining_m: f32 = 0.0,
        /// Success weighted by path length; 0 before success.
        spl: f32 = 0.0,
        /// Share of the distance that was covered, weighted by path length.
        soft_spl: f32 = 0.0,
        /// Time since the frame that is shown was captured, s; 0 where each step has the frame of
        /// its end.
        frame_age_s: f32 = 0.0,
    }
}
