//! An agent: its size and limits, its state, and one step of its motion over the ground.
//!
//! Contract: [`advance`] is a function of its arguments. The agent never passes through an
//! obstacle, a step above its limit, a low ceiling or unknown ground, whatever its speed: it stops
//! in front of it, or slides along it where the configuration says so, and the result says why and
//! where.

mod collision;
mod footing;
mod motion;
mod playback;

#[cfg(test)]
mod tests;

use cad_transforms::{RigidTransform, so3};
use estimator_config::config;
use serde::{Deserialize, Serialize};

pub use footing::Footing;
pub use playback::{Playback, Recorded};

use crate::error::SimulationError;
use crate::ground::Ground;

config! {
    /// Size and limits of an agent on the ground. The values are those of a walking person or a
    /// robot of that width.
    pub struct AgentConfig {
        /// Distance that its center keeps from obstacles, m: half of its width.
        pub radius_m: f64 = 0.25,
        /// Headroom that it needs, m.
        pub height_m: f64 = 1.8,
        /// Distance that its center keeps from unknown ground, m. More is safer at the border of
        /// what was seen; less lets it follow narrow recordings.
        pub unknown_margin_m: f64 = 0.0,
        /// Half of the length of its footprint, along its heading, m. Roll and pitch are of the
        /// ground below the footprint.
        pub half_length_m: f64 = 0.2,
        /// Half of the width of its footprint, m.
        pub half_width_m: f64 = 0.15,
        /// Height of its eyes above the ground, m.
        pub eye_height_m: f64 = 1.4,
        /// Distance of its wheels with the drive `wheels`, m.
        pub track_m: f64 = 0.5,
        /// Largest speed, m/s: that of a walking person.
        pub max_speed_m_s: f64 = 1.5,
        /// Largest rate of turn, rad/s.
        pub max_yaw_rate_rad_s: f64 = 2.0,
        /// Largest change of speed, m/s2.
        pub max_acceleration_m_s2: f64 = 4.0,
        /// Largest change of the rate of turn, rad/s2.
        pub max_yaw_acceleration_rad_s2: f64 = 12.0,
        /// Largest height of a step up or down, m: a stair has up to 0.19.
        pub max_step_m: f64 = 0.20,
        /// Steepest ground that it walks on, rad, but for the edges of steps: 45 degrees. Stairs
        /// with a rise of 0.20 m and a tread of 0.23 m have 41.
        pub max_slope_rad: f64 = 0.785,
        /// Largest hole in what was seen that it may cross, m2, on the plane through the rim; 0 for
        /// none. Shadows of the wearer's own legs on the ground have up to 0.11 m2 in the
        /// reconstructed demo scene.
        pub max_hole_m2: f64 = 0.12,
        /// Whether it slides along what blocks it instead of stopping there.
        pub slides: bool = false,
        /// Largest distance of a point of the footprint from the plane through it, m, where the
        /// agent still counts as on the ground: half of a step.
        pub max_residual_m: f64 = 0.1,
    }
}

impl AgentConfig {
    /// Refuses sizes and limits that are none.
    ///
    /// # Errors
    /// [`SimulationError::Setting`] with the name.
    pub fn check(&self) -> Result<(), SimulationError> {
        let positive = [
            ("radius_m", self.radius_m),
            ("height_m", self.height_m),
            ("half_length_m", self.half_length_m),
            ("half_width_m", self.half_width_m),
            ("track_m", self.track_m),
            ("max_speed_m_s", self.max_speed_m_s),
            ("max_yaw_rate_rad_s", self.max_yaw_rate_rad_s),
            ("max_acceleration_m_s2", self.max_acceleration_m_s2),
            (
                "max_yaw_acceleration_rad_s2",
                self.max_yaw_acceleration_rad_s2,
            ),
        ];
        let least = [
            ("unknown_margin_m", self.unknown_margin_m),
            ("eye_height_m", self.eye_height_m),
            ("max_step_m", self.max_step_m),
            ("max_hole_m2", self.max_hole_m2),
            ("max_residual_m", self.max_residual_m),
        ];
        if !(self.max_slope_rad > 0.0 && self.max_slope_rad < std::f64::consts::FRAC_PI_2) {
            return Err(SimulationError::Setting {
                name: "agent.max_slope_rad".to_owned(),
                found: self.max_slope_rad.to_string(),
                expected: "an angle above 0 and below a right angle".to_owned(),
            });
        }
        let wrong = positive
            .iter()
            .find(|(_, value)| !(value.is_finite() && *value > 0.0));
        let wrong = wrong.map(|found| (found, "a number above 0"));
        let negative = least
            .iter()
            .find(|(_, value)| !(value.is_finite() && *value >= 0.0));
        let wrong = wrong.or(negative.map(|found| (found, "a number of 0 or more")));
        match wrong {
            None => Ok(()),
            Some(((name, value), expected)) => Err(SimulationError::Setting {
                name: format!("agent.{name}"),
                found: value.to_string(),
                expected: expected.to_owned(),
            }),
        }
    }
}

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

/// Where an agent is and how it moves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AgentState {
    /// Point on the ground below its center, m; of a free camera its position.
    pub position_m: [f64; 3],
    /// Heading, counterclockwise from x, rad, -π to π.
    pub yaw_rad: f64,
    /// Rotation about its left axis, rad: positive looks down.
    pub pitch_rad: f64,
    /// Rotation about its forward axis, rad: positive lifts the left side.
    pub roll_rad: f64,
    /// Speed forward and to the left, m/s, and rate of turn, rad/s.
    pub velocity: [f64; 3],
    /// Level of the ground.
    pub level: usize,
    /// Whether the footprint rests on the ground.
    pub is_on_ground: bool,
}

impl AgentState {
    /// An agent at rest on the ground at x, y near the height z; `None` where there is no ground.
    pub fn on_ground(
        ground: &Ground,
        config: &AgentConfig,
        position_m: [f64; 3],
        yaw_rad: f64,
    ) -> Option<Self> {
        let footing = Footing::at(ground, config, position_m, yaw_rad)?;
        let mut state = Self {
            position_m,
            yaw_rad: motion::wrap(yaw_rad),
            ..Self::default()
        };
        footing.place(&mut state);
        Some(state)
    }

    /// Whether all numbers are finite.
    pub fn is_finite(&self) -> bool {
        let angles = [self.yaw_rad, self.pitch_rad, self.roll_rad];
        let numbers = self.position_m.iter().chain(&self.velocity).chain(&angles);
        numbers.copied().all(f64::is_finite)
    }

    /// Pose of the body: x forward, y left, z up, with yaw, pitch and roll in that order.
    pub fn world_from_body(&self) -> RigidTransform {
        let rotation = so3::from_yaw_pitch_roll(self.yaw_rad, self.pitch_rad, self.roll_rad);
        RigidTransform::from_wxyz(
            [rotation.w, rotation.i, rotation.j, rotation.k],
            self.position_m,
        )
        .unwrap_or_else(|_| RigidTransform::identity())
    }
}

/// Why an agent stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BlockReason {
    /// Outside of the map.
    OutsideMap,
    /// Ground that no view saw.
    Unknown,
    /// An obstacle.
    Obstacle,
    /// A step up, or a slope, above the limit.
    Step,
    /// A step down above the limit.
    Drop,
    /// A ceiling below the height of the agent.
    Ceiling,
}

/// What an agent stopped at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Block {
    /// Why.
    pub reason: BlockReason,
    /// Where its center could not go, x and y, m.
    pub at_m: [f64; 2],
}

/// Result of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// The state after it.
    pub state: AgentState,
    /// What stopped it, if anything.
    pub blocked: Option<Block>,
    /// Length of the path, m.
    pub distance_m: f64,
}

/// Moves an agent for `dt_s` seconds. Components of `action` beyond -1 to 1 count as -1 and 1,
/// missing ones as 0.
///
/// ```
/// use simulation::testing::SyntheticScene;
/// use simulation::{AgentConfig, AgentState, Drive, Ground, advance};
///
/// let plane = SyntheticScene::tilted_plane([0.0, 0.0])?;
/// let levels = plane.scene.sectors[0].levels.as_ref().unwrap();
/// let config = AgentConfig::default();
/// let ground = Ground::new(levels.to_vec(), &config)?;
/// let mut state = AgentState::on_ground(&ground, &config, [2.0, 3.0, 0.0], 0.0).unwrap();
/// for _ in 0..10 {
///     state = advance(&ground, &config, Drive::Differential, &state, &[1.0, 0.0], 0.1).state;
/// }
/// assert!(state.position_m[0] > 3.0 && state.is_on_ground);
/// # Ok::<(), simulation::SimulationError>(())
/// ```
pub fn advance(
    ground: &Ground,
    config: &AgentConfig,
    drive: Drive,
    state: &AgentState,
    action: &[f64],
    dt_s: f64,
) -> Motion {
    let mut parts = [0.0; 6];
    for (part, value) in parts.iter_mut().zip(action) {
        *part = value.clamp(-1.0, 1.0);
    }
    if drive == Drive::Free {
        return motion::fly(config, state, &parts, dt_s);
    }
    let velocity = motion::velocity(config, drive, state, &parts, dt_s);
    let arc = motion::Arc::new(state, velocity, dt_s);
    let swept = collision::sweep(ground, config.slides, state, &arc);
    let mut next = *state;
    let [x, y] = swept.position_m;
    next.position_m = [x, y, swept.height_m];
    next.yaw_rad = arc.yaw_rad(swept.share);
    next.velocity = match swept.blocked {
        None => velocity,
        Some(_) if config.slides => {
            // The mean velocity of what it did.
            let [x, y] = [0, 1].map(|k| (next.position_m[k] - state.position_m[k]) / dt_s);
            let (sine, cosine) = (libm::sin(next.yaw_rad), libm::cos(next.yaw_rad));
            [x * cosine + y * sine, y * cosine - x * sine, velocity[2]]
        }
        Some(_) => [0.0; 3],
    };
    next.level = swept.level;
    match Footing::at(ground, config, next.position_m, next.yaw_rad) {
        Some(footing) => footing.place(&mut next),
        None => next.is_on_ground = false,
    }
    Motion {
        state: next,
        blocked: swept.blocked,
        distance_m: swept.length_m,
    }
}
