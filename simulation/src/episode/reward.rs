//! Rewards: plain terms with weights, so that a caller can change the weights or replace them.

use estimator_config::config;

use crate::SimulationError;
use crate::error::check_range;

/// Names of the terms, in the order of [`StepResult::reward_terms`](crate::StepResult).
pub const REWARD_TERMS: [&str; 8] = [
    "progress_m",
    "goal",
    "collision",
    "time_s",
    "cross_track_m_s",
    "speed_tracking_s",
    "yaw_rate_tracking_s",
    "end",
];

config! {
    /// Weights of the terms. The reward is their sum, each term times its weight.
    pub struct RewardConfig {
        /// Per m by which the geodesic distance to the goal fell, or the position along the path
        /// rose.
        pub progress: f64 = 1.0,
        /// For the step in which the goal is reached.
        pub goal: f64 = 10.0,
        /// For a step that was stopped by an obstacle, step, drop, ceiling or unknown ground.
        pub collision: f64 = -0.05,
        /// Per s.
        pub time: f64 = -0.05,
        /// Per m of distance from the path, and s. Only where a path is followed.
        pub cross_track: f64 = -0.5,
        /// Per s, times `exp(-(error / tracking_sigma)²)` of the velocity. Only for velocity
        /// tracking. Source of the form: rewards of legged_gym (Rudin et al. 2022).
        pub speed_tracking: f64 = 1.0,
        /// The same of the yaw rate.
        pub yaw_rate_tracking: f64 = 0.5,
        /// For the step in which the episode terminates without success.
        pub end: f64 = 0.0,
        /// Error at which the tracking terms are 1/e, m/s or rad/s. Source: legged_gym, whose
        /// squared error is divided by 0.25.
        pub tracking_sigma: f64 = 0.5,
    }
}

impl RewardConfig {
    pub(crate) fn check(&self) -> Result<(), SimulationError> {
        let [
            progress,
            goal,
            collision,
            time,
            cross_track,
            speed,
            yaw_rate,
            end,
        ] = self.weights();
        for (name, value) in [
            ("reward.progress", progress),
            ("reward.goal", goal),
            ("reward.collision", collision),
            ("reward.time", time),
            ("reward.cross_track", cross_track),
            ("reward.speed_tracking", speed),
            ("reward.yaw_rate_tracking", yaw_rate),
            ("reward.end", end),
        ] {
            check_range(name, value, [-1e9, 1e9], "a finite number")?;
        }
        // Its square must not vanish.
        check_range(
            "reward.tracking_sigma",
            self.tracking_sigma,
            [1e-6, 1e9],
            "0.000001 to 1000000000",
        )
    }

    /// Weights in the order of [`REWARD_TERMS`].
    pub fn weights(&self) -> [f64; REWARD_TERMS.len()] {
        [
            self.progress,
            self.goal,
            self.collision,
            self.time,
            self.cross_track,
            self.speed_tracking,
            self.yaw_rate_tracking,
            self.end,
        ]
    }

    /// The sum of terms times weights, in order.
    pub(crate) fn total(&self, terms: &[f64; REWARD_TERMS.len()]) -> f64 {
        let weights = self.weights();
        (0..terms.len()).fold(0.0, |sum, k| sum + weights[k] * terms[k])
    }

    /// A tracking term of 0 to 1.
    pub(crate) fn tracking(&self, squared_error: f64) -> f64 {
        libm::exp(-squared_error / (self.tracking_sigma * self.tracking_sigma))
    }
}
