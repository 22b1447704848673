//! Size and limits of an agent on the ground.

use estimator_config::config;

use crate::error::{SimulationError, check_positive, check_range};

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
            ("agent.radius_m", self.radius_m),
            ("agent.height_m", self.height_m),
            ("agent.half_length_m", self.half_length_m),
            ("agent.half_width_m", self.half_width_m),
            ("agent.track_m", self.track_m),
            ("agent.max_speed_m_s", self.max_speed_m_s),
            ("agent.max_yaw_rate_rad_s", self.max_yaw_rate_rad_s),
            ("agent.max_acceleration_m_s2", self.max_acceleration_m_s2),
            (
                "agent.max_yaw_acceleration_rad_s2",
                self.max_yaw_acceleration_rad_s2,
            ),
        ];
        for (name, value) in positive {
            check_positive(name, value)?;
        }
        let least = [
            ("agent.unknown_margin_m", self.unknown_margin_m),
            ("agent.eye_height_m", self.eye_height_m),
            ("agent.max_step_m", self.max_step_m),
            ("agent.max_hole_m2", self.max_hole_m2),
            ("agent.max_residual_m", self.max_residual_m),
        ];
        for (name, value) in least {
            check_range(name, value, [0.0, f64::MAX], "a number of 0 or more")?;
        }
        let below_right = std::f64::consts::FRAC_PI_2.next_down();
        check_range(
            "agent.max_slope_rad",
            self.max_slope_rad,
            [f64::MIN_POSITIVE, below_right],
            "an angle above 0 and below a right angle",
        )
    }
}
