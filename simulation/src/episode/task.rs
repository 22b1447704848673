//! Tasks: what an episode is for.
//!
//! - [`Task::PointGoal`]: reach a position. Success is a horizontal distance below the radius;
//!   SPL is `S · l / max(l, p)` with the geodesic distance `l` from the start and the path length
//!   `p`; SoftSPL has the share of the distance that was covered instead of `S`
//!   (Anderson et al. 2018; Habitat-Lab).
//! - [`Task::FollowPath`]: walk the recorded path to its end.
//! - [`Task::Velocity`]: hold a speed and a yaw rate that change from time to time.

pub(crate) mod goals;

use estimator_config::config;
use serde::{Deserialize, Serialize};

use crate::SimulationError;
use crate::error::check_range;
use crate::randomness::{RandomStream, Stream};

/// What an episode is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Task {
    /// Reach a position.
    PointGoal,
    /// Follow the recorded path to its end.
    FollowPath,
    /// Hold a velocity.
    Velocity,
}

config! {
    /// The task and its constants.
    pub struct TaskConfig {
        /// The task.
        pub task: Task = Task::PointGoal,
        /// Horizontal distance from a goal or the end of the path that is success, m. Source:
        /// Habitat's 0.2 m; twice as far is easier to learn.
        pub success_radius_m: f64 = 0.4,
        /// Geodesic distance of goals from starts, m.
        pub goal_distance_m: [f64; 2] = [1.0, 5.0],
        /// Geodesic over Euclidean distance of goals, at least. Source of a value above 1:
        /// Habitat's episodes, 1.1.
        pub min_detour: f64 = 1.0,
        /// Height difference of start and goal, at most, m. Source: Habitat's episodes.
        pub max_goal_height_m: f64 = 0.5,
        /// Goals among which those of episodes are drawn; each has a distance field. More are more
        /// varied and need memory and time at the first reset.
        pub goals: usize = 32,
        /// Seed of these goals. Another one gives unseen goals on the same scene.
        pub goal_seed: u64 = 0,
        /// Length along the path to the point that is observed as goal, m.
        pub lookahead_m: f64 = 1.0,
        /// Commanded forward speed, m/s.
        pub command_m_s: [f64; 2] = [-0.5, 1.5],
        /// Commanded yaw rate, rad/s.
        pub command_rad_s: [f64; 2] = [-1.0, 1.0],
        /// Time between commands, s.
        pub command_interval_s: f64 = 4.0,
    }
}

/// Distance up to which goals are observed, m; farther ones appear at it.
pub(crate) const MAX_GOAL_M: f64 = 50.0;

impl TaskConfig {
    pub(crate) fn check(&self) -> Result<(), SimulationError> {
        let positive = [f64::MIN_POSITIVE, 1e9];
        for (name, value, range, expected) in [
            (
                "task.success_radius_m",
                self.success_radius_m,
                positive,
                "above 0",
            ),
            ("task.min_detour", self.min_detour, [1.0, 100.0], "1 to 100"),
            (
                "task.max_goal_height_m",
                self.max_goal_height_m,
                [0.0, 1e9],
                "at least 0",
            ),
            (
                "task.goals",
                self.goals as f64,
                [1.0, 100_000.0],
                "1 to 100000",
            ),
            ("task.lookahead_m", self.lookahead_m, positive, "above 0"),
            (
                "task.command_interval_s",
                self.command_interval_s,
                positive,
                "above 0",
            ),
        ] {
            check_range(name, value, range, expected)?;
        }
        for (name, [low, high], limits) in [
            (
                "task.goal_distance_m",
                self.goal_distance_m,
                [0.0, MAX_GOAL_M],
            ),
            ("task.command_m_s", self.command_m_s, [-100.0, 100.0]),
            ("task.command_rad_s", self.command_rad_s, [-100.0, 100.0]),
        ] {
            if !(limits[0] <= low && low <= high && high <= limits[1]) {
                return Err(SimulationError::Setting {
                    name: name.to_owned(),
                    found: format!("{low} to {high}"),
                    expected: format!("an ascending range within {} to {}", limits[0], limits[1]),
                });
            }
        }
        Ok(())
    }

    /// Commanded forward speed, m/s, and yaw rate, rad/s, at a time of an episode.
    pub(crate) fn command(&self, seed: u64, episode: u64, time_s: f64) -> [f64; 2] {
        let number = (time_s / self.command_interval_s) as u64;
        // The cast saturates for intervals that are tiny beside the time.
        let first = number.wrapping_mul(2);
        let random = RandomStream::new(seed, episode, Stream::Goal);
        [
            random.range(first, self.command_m_s),
            random.range(first.wrapping_add(1), self.command_rad_s),
        ]
    }
}

/// Success weighted by path length. `covered` is 1 or 0 of success for SPL, and the share of the
/// distance that was covered for SoftSPL.
pub(crate) fn weighted_by_path_length(covered: f64, shortest_m: f64, path_length_m: f64) -> f64 {
    let longest = f64::max(shortest_m, path_length_m);
    match longest > 0.0 {
        true => covered * shortest_m / longest,
        false => covered,
    }
}

#[cfg(test)]
mod tests;
