//! A guide that walks an agent to one goal after the other.
//!
//! Contract: goals are centers of walkable cells in the part of the ground where the agent is, at a
//! distance along the ground within a range, drawn from a seed. The agent follows the shortest path
//! for an agent that is a little wider, so that it does not touch what it walks around; before a
//! turn it slows down.

use counter_random::uniform;
use scene_bundle::outputs::maps::MapLevel;

use crate::agent::{AgentConfig, AgentState};
use crate::error::SimulationError;
use crate::geodesic::DistanceField;
use crate::ground::Ground;

/// Angle beyond which the agent turns on the spot, rad.
const TURN_RAD: f64 = 1.0;
/// Rate of turn by angle to the path, 1/s.
const TURN_GAIN: f64 = 3.0;
/// Distance in front of a goal at which the agent begins to slow down, m.
const BRAKE_M: f64 = 0.6;
/// Distance that paths keep from what blocks the agent, m.
const MARGIN_M: f64 = 0.1;
/// Farthest that an agent within [`MARGIN_M`] of what blocks it goes back to a path, m.
const RETURN_M: f64 = 0.6;
/// Draws of a goal.
const MAX_DRAWS: u64 = 400;

/// Walks to goals.
#[derive(Clone, Debug)]
pub struct Guide {
    /// A wider agent, and the ground for it.
    agent: AgentConfig,
    ground: Ground,
    seed: u64,
    /// Least and greatest distance of a goal, m.
    range_m: [f64; 2],
    draws: u64,
    goal: Option<DistanceField>,
    /// Goals that were reached.
    reached: u32,
}

impl Guide {
    /// A guide on the levels of a scene, without a goal yet.
    ///
    /// # Errors
    /// As [`Ground::new`].
    pub fn new(
        levels: Vec<MapLevel>,
        agent: &AgentConfig,
        seed: u64,
        range_m: [f64; 2],
    ) -> Result<Self, SimulationError> {
        let mut agent = *agent;
        agent.radius_m += MARGIN_M;
        agent.unknown_margin_m += MARGIN_M;
        Ok(Self {
            ground: Ground::new(levels, &agent)?,
            agent,
            seed,
            range_m,
            draws: 0,
            goal: None,
            reached: 0,
        })
    }

    /// The goal that it walks to, m.
    pub fn goal_m(&self) -> Option<[f64; 3]> {
        self.goal.as_ref().map(DistanceField::goal_m)
    }

    /// Number of goals that were reached.
    pub fn goals_reached(&self) -> u32 {
        self.reached
    }

    /// Action of the drive `differential` that follows the path to the goal. A new goal is drawn
    /// where there is none and within `radius_m` of the old one; without any the agent stands.
    pub fn action(&mut self, state: &AgentState, radius_m: f64) -> [f64; 2] {
        let Some(from_m) = self.on_path(state.position_m) else {
            return [0.0; 2];
        };
        let left = |goal: &DistanceField| goal.distance_m(from_m);
        match self.goal.as_ref().map(left) {
            Some(Some(left_m)) if left_m > radius_m => {}
            Some(Some(_)) => {
                self.reached += 1;
                self.draw(from_m);
            }
            _ => self.draw(from_m),
        }
        let Some(goal) = &self.goal else {
            return [0.0; 2];
        };
        let Some(left_m) = left(goal) else {
            return [0.0; 2];
        };
        let back = [0, 1].map(|k| from_m[k] - state.position_m[k]);
        let direction = match back == [0.0; 2] {
            true => goal.direction(from_m).unwrap_or([0.0; 2]),
            false => back,
        };
        let wanted = libm::atan2(direction[1], direction[0]) - state.yaw_rad;
        let turn = 2.0 * std::f64::consts::PI;
        let off = wanted - turn * libm::round(wanted / turn);
        let rate = (TURN_GAIN * off / self.agent.max_yaw_rate_rad_s).clamp(-1.0, 1.0);
        let ahead = (1.0 - off.abs() / TURN_RAD).max(0.0);
        [ahead * (left_m / BRAKE_M).clamp(0.2, 1.0), rate]
    }

    /// The position itself, or the nearest one from which a path can begin.
    fn on_path(&self, position_m: [f64; 3]) -> Option<[f64; 3]> {
        let [x, y, z] = position_m;
        let near = |at: [f64; 2]| {
            let surface = self.ground.surface(at, z)?;
            self.ground.component(at, surface.level)?;
            Some([at[0], at[1], surface.height_m])
        };
        if let Some(here) = near([x, y]) {
            return Some([x, y, here[2]]);
        }
        let cell_m = self.ground.cell_m();
        let reach = (RETURN_M / cell_m) as i32;
        let mut offsets: Vec<[f64; 2]> = (-reach..=reach)
            .flat_map(|a| (-reach..=reach).map(move |b| [a, b].map(f64::from)))
            .map(|[a, b]| [a * cell_m, b * cell_m])
            .collect();
        offsets.sort_by(|a, b| {
            let length = |v: &[f64; 2]| v[0] * v[0] + v[1] * v[1];
            length(a).total_cmp(&length(b))
        });
        offsets.iter().find_map(|[a, b]| near([x + a, y + b]))
    }

    /// Forgets the goal.
    pub fn forget(&mut self) {
        self.goal = None;
    }

    fn draw(&mut self, from_m: [f64; 3]) {
        self.goal = None;
        let from = DistanceField::new(&self.ground, &self.agent, from_m);
        let levels = self.ground.levels();
        // Of those in range the first drawn; otherwise the farthest one.
        let mut farthest: Option<(f64, [f64; 3])> = None;
        for _ in 0..MAX_DRAWS {
            let number = self.draws;
            self.draws += 1;
            let pick = |stream: u64, count: usize| {
                ((uniform(self.seed, stream, number) * count as f64) as usize).min(count - 1)
            };
            let level = pick(0, levels.len());
            let cell = pick(1, levels[level].grid.cells());
            let at = levels[level].grid.center_m(cell);
            let Some(height_m) = self.ground.layers()[level].walkable_m(cell) else {
                continue;
            };
            let goal_m = [at[0], at[1], f64::from(height_m)];
            let Some(along_m) = from.distance_m(goal_m) else {
                continue;
            };
            if along_m <= self.range_m[1] && farthest.is_none_or(|(most, _)| along_m > most) {
                farthest = Some((along_m, goal_m));
            }
            if (self.range_m[0]..=self.range_m[1]).contains(&along_m) {
                break;
            }
        }
        self.goal =
            farthest.map(|(_, goal_m)| DistanceField::new(&self.ground, &self.agent, goal_m));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::agent::{Drive, advance};
    use crate::testing::SyntheticScene;

    #[test]
    fn goals_are_reached_one_after_the_other_without_a_collision() {
        let scene = SyntheticScene::room().expect("a scene");
        let levels = scene.scene.sectors[0].levels.as_ref().expect("levels");
        let config = AgentConfig::default();
        let ground = Ground::new(levels.to_vec(), &config).expect("ground");
        let start = scene.scene.sectors[0].references[0].translation_m();
        let state = AgentState::on_ground(&ground, &config, start, 0.0);
        let mut state = state.expect("ground below the first camera");
        let mut guide = Guide::new(levels.to_vec(), &config, 3, [1.5, 8.0]).expect("levels");
        let mut blocked = 0;
        for _ in 0..600 {
            let action = guide.action(&state, 0.2);
            let motion = advance(&ground, &config, Drive::Differential, &state, &action, 0.1);
            blocked += u32::from(motion.blocked.is_some());
            state = motion.state;
        }
        assert!(guide.goals_reached() >= 4, "{}", guide.goals_reached());
        assert!(blocked <= 3, "{blocked}");
    }
}
