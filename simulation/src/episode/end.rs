//! Ends of episodes: reasons, and whether they terminate or truncate.
//!
//! Termination is an end of the task: what follows is worth nothing. Truncation is an end of the
//! simulation: learners bootstrap with the value of the final observation. Where both happen in
//! one step, the reason is that of the termination, and the flag of truncation is not set.

use estimator_config::config;

use crate::SimulationError;
use crate::error::check_range;
use crate::reference_poses::{Deviation, DeviationConfig};

/// Why an episode ended. Codes below 10 terminate, others truncate, unless [`EndConfig`] says that
/// one of them terminates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[repr(i8)]
pub enum EndReason {
    /// It goes on.
    None = 0,
    /// The goal was reached.
    Goal = 1,
    /// The agent is tilted too much or not on the ground.
    Fall = 2,
    /// A collision, where it is configured to end episodes.
    Collision = 3,
    /// The time limit.
    TimeLimit = 10,
    /// The camera is too far from recorded ones, or its view is not supported by them.
    Deviation = 11,
    /// The agent reached the end of the map.
    LeftMap = 12,
    /// The agent reached ground that was not seen.
    UnknownGround = 13,
    /// A pose that is not finite came from outside; the last finite one was kept.
    PhysicsFault = 14,
}

impl EndReason {
    /// Every reason that ends an episode, by precedence among those that terminate, then among the
    /// others.
    pub const BY_PRECEDENCE: [Self; 8] = [
        Self::Goal,
        Self::Fall,
        Self::Collision,
        Self::PhysicsFault,
        Self::LeftMap,
        Self::UnknownGround,
        Self::Deviation,
        Self::TimeLimit,
    ];

    /// Every reason, by its code.
    pub const ALL: [Self; 9] = [
        Self::None,
        Self::Goal,
        Self::Fall,
        Self::Collision,
        Self::TimeLimit,
        Self::Deviation,
        Self::LeftMap,
        Self::UnknownGround,
        Self::PhysicsFault,
    ];

    /// Its name in other languages, such as `time_limit`.
    ///
    /// ```
    /// assert_eq!(simulation::EndReason::TimeLimit.name(), "time_limit");
    /// ```
    pub fn name(self) -> &'static str {
        match self {
            Self::None => "none",
            Self::Goal => "goal",
            Self::Fall => "fall",
            Self::Collision => "collision",
            Self::TimeLimit => "time_limit",
            Self::Deviation => "deviation",
            Self::LeftMap => "left_map",
            Self::UnknownGround => "unknown_ground",
            Self::PhysicsFault => "physics_fault",
        }
    }

    /// The reason of a code.
    pub fn from_code(code: i8) -> Option<Self> {
        Self::ALL.into_iter().find(|reason| *reason as i8 == code)
    }
}

config! {
    /// When episodes end.
    pub struct EndConfig {
        /// Duration of an episode, s.
        pub time_limit_s: f64 = 60.0,
        /// Distance from the nearest recorded camera, m. Source: PAWS augments views by at most
        /// 3 m. Larger limits let final images become worthless for bootstrapping.
        pub max_deviation_m: f64 = 3.0,
        /// Angle from its optical axis, rad. π is no limit, which an agent needs that looks back
        /// along its path. Source of a limit for images: PAWS, 30 degrees (0.524).
        pub max_deviation_rad: f64 = std::f64::consts::PI,
        /// Predicted PSNR of the view, at least, dB; 0 is no limit. Needs a scene of which it is
        /// known what the training saw.
        pub min_support_db: f64 = 0.0,
        /// Angle between the body's and the world's vertical, rad. Steeper is a fall.
        pub max_tilt_rad: f64 = 0.7,
        /// Whether an obstacle, a step, a drop or a ceiling in the path of the footprint ends the
        /// episode. Otherwise the agent stops there.
        pub collision_ends: bool = false,
        /// Whether the end of the map ends the episode. Otherwise the agent stops there.
        pub left_map_ends: bool = true,
        /// Whether that is a termination.
        pub left_map_terminates: bool = false,
        /// Whether unknown ground in the path of the footprint ends the episode. Otherwise the
        /// agent stops there.
        pub unknown_ground_ends: bool = true,
        /// Whether that is a termination.
        pub unknown_ground_terminates: bool = false,
    }
}

impl EndConfig {
    pub(crate) fn check(&self) -> Result<(), SimulationError> {
        let positive = [f64::MIN_POSITIVE, 1e9];
        for (name, value, range, expected) in [
            ("end.time_limit_s", self.time_limit_s, positive, "above 0"),
            (
                "end.max_deviation_m",
                self.max_deviation_m,
                positive,
                "above 0",
            ),
            (
                "end.max_deviation_rad",
                self.max_deviation_rad,
                positive,
                "above 0",
            ),
            (
                "end.min_support_db",
                self.min_support_db,
                [0.0, 200.0],
                "0 to 200",
            ),
            ("end.max_tilt_rad", self.max_tilt_rad, positive, "above 0"),
        ] {
            check_range(name, value, range, expected)?;
        }
        Ok(())
    }

    /// Whether a reason ends the task rather than the simulation.
    pub fn terminates(&self, reason: EndReason) -> bool {
        match reason {
            EndReason::Goal | EndReason::Fall | EndReason::Collision => true,
            EndReason::LeftMap => self.left_map_terminates,
            EndReason::UnknownGround => self.unknown_ground_terminates,
            _ => false,
        }
    }

    /// The limits as units of distance and angle: the recorded camera of least sum of squares in
    /// them counts. Without a limit of the angle that is the nearest one, and of those at about
    /// the same position the one that looks in the same direction.
    pub fn units(&self) -> DeviationConfig {
        /// Distance that a rad counts as, m: cameras of a rig are apart by this.
        const NEARBY_M: f64 = 0.05;
        let angle_rad = match self.max_deviation_rad < std::f64::consts::PI {
            true => self.max_deviation_rad,
            false => self.max_deviation_m / NEARBY_M,
        };
        DeviationConfig {
            distance_m: self.max_deviation_m,
            angle_rad,
        }
    }

    /// Whether a camera is too far from recorded ones, if there are any, or what it sees too bad.
    pub(crate) fn is_too_far(&self, deviation: Option<&Deviation>, support_db: f64) -> bool {
        let is_beyond = |deviation: &Deviation| {
            deviation.distance_m > self.max_deviation_m
                || deviation.angle_rad > self.max_deviation_rad
        };
        deviation.is_some_and(is_beyond) || support_db < self.min_support_db
    }

    /// The reason of several that happened in one step: terminations first, then by precedence.
    pub(crate) fn choose(&self, has_happened: impl Fn(EndReason) -> bool) -> EndReason {
        let happened = || {
            EndReason::BY_PRECEDENCE
                .into_iter()
                .filter(|r| has_happened(*r))
        };
        happened()
            .find(|reason| self.terminates(*reason))
            .or_else(|| happened().next())
            .unwrap_or(EndReason::None)
    }
}

#[cfg(test)]
mod tests;
