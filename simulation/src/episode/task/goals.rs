//! Goals with their distance fields, from which those of episodes are drawn.

pub(crate) mod draw;

use super::TaskConfig;
use crate::episode::path::horizontal_m;
use crate::geodesic::DistanceField;
use crate::randomness::RandomStream;

/// A position on the ground that can be reached.
#[derive(Debug)]
pub(crate) struct Goal {
    /// Frame of its recording.
    pub(crate) frame: u32,
    pub(crate) position_m: [f64; 3],
    pub(crate) field: DistanceField,
}

/// A goal among those in range of a start, uniform: its index and its distance along the ground.
pub(crate) fn choose(
    goals: &[Goal],
    task: &TaskConfig,
    frame: u32,
    start_m: [f64; 3],
    random: &RandomStream,
) -> Option<(u32, f64)> {
    let distance_m = |goal: &Goal| {
        if goal.frame != frame {
            return None;
        }
        let direct_m = horizontal_m(goal.position_m, start_m);
        let is_level = (goal.position_m[2] - start_m[2]).abs() <= task.max_goal_height_m;
        let [least_m, most_m] = task.goal_distance_m;
        // The geodesic distance is not less.
        if !is_level || direct_m > most_m || direct_m <= task.success_radius_m {
            return None;
        }
        let along_m = goal.field.distance_m(start_m)?;
        let is_in_range = (least_m..=most_m).contains(&along_m);
        (is_in_range && along_m >= task.min_detour * direct_m).then_some(along_m)
    };
    let in_range = || {
        let all = goals.iter().enumerate();
        all.filter_map(|(index, goal)| Some((index as u32, distance_m(goal)?)))
    };
    let count = in_range().count();
    in_range().nth(random.below(0, count))
}
