//! Progress of an agent towards its target, as terms of the reward.

use super::episode::Target;
use super::rows::Row;
use super::shared::Shared;
use crate::episode::path::horizontal_m;
use crate::episode::reward::REWARD_TERMS;

/// Terms of the reward of a step (all but the last), and whether it reached the goal.
pub(super) fn pursue(
    shared: &Shared,
    row: &mut Row<'_>,
    is_blocked: bool,
) -> ([f64; REWARD_TERMS.len()], bool) {
    let (config, episode) = (&shared.config, &mut *row.episode);
    let (state, dt_s) = (&*row.state, config.dt_s);
    let terrain = &shared.terrains[*row.sector as usize];
    let radius_m = config.task.success_radius_m;
    let mut terms = [0.0; REWARD_TERMS.len()];
    terms[2] = f64::from(u8::from(is_blocked));
    terms[3] = dt_s;
    let before_m = episode.remaining_m;
    let is_success = match &mut episode.target {
        Target::Goal { index, position_m } => {
            let goal = &shared.goals[*index as usize];
            // In a sector of another recording distances to this goal are not known, as in a cell
            // from which it cannot be reached: the last one remains.
            let distance_m = match goal.frame == terrain.frame {
                true => goal.field.distance_m(state.position_m),
                false => None,
            };
            if let Some(distance_m) = distance_m {
                episode.remaining_m = distance_m;
            }
            let height_m = (position_m[2] - state.position_m[2]).abs();
            let is_level = height_m <= config.task.max_goal_height_m.max(radius_m);
            is_level && horizontal_m(*position_m, state.position_m) < radius_m
        }
        Target::Path { along_m } => {
            let length_m = terrain.path.length_m();
            let max_step_m = config.agent.max_speed_m_s * episode.parameters.speed_scale * dt_s;
            match terrain.path.follow(state.position_m, *along_m, max_step_m) {
                None => false,
                Some(position) => {
                    *along_m = position.along_m;
                    episode.remaining_m = length_m - position.along_m;
                    terms[4] = position.cross_track_m * dt_s;
                    episode.remaining_m < radius_m && position.cross_track_m < radius_m
                }
            }
        }
        Target::Command => {
            // The command during the step.
            let time_s = (episode.steps - 1) as f64 * dt_s;
            let [speed, yaw_rate] = config.task.command(episode.seed, episode.number, time_s);
            let [forward, left, yaw] = state.velocity;
            let error = [forward - speed, left, yaw - yaw_rate];
            let speed_error = error[0] * error[0] + error[1] * error[1];
            terms[5] = dt_s * config.reward.tracking(speed_error);
            terms[6] = dt_s * config.reward.tracking(error[2] * error[2]);
            false
        }
    };
    terms[0] = before_m - episode.remaining_m;
    terms[1] = f64::from(u8::from(is_success));
    (terms, is_success)
}
