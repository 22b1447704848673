//! Time step, gravity and contacts of rigid bodies.

use estimator_config::config;

use crate::error::{SimulationError, check_range};

config! {
    /// Time step, gravity and contacts of rigid bodies.
    pub struct BodiesConfig {
        /// Duration of a step, s: that of MuJoCo's models. Longer steps are faster, and bodies sink
        /// in deeper as they land.
        pub step_s: f64 = 0.002,
        /// Acceleration of free fall, m/s2, along -z.
        pub gravity_m_s2: f64 = 9.81,
        /// Coefficient of friction of all pairs: rubber on stone. Lower slides on slopes.
        pub friction: f64 = 1.0,
        /// Natural frequency of contacts, Hz; the engine's default for ground. Higher is stiffer,
        /// above half of the rate of steps it has no effect.
        pub contact_frequency_hz: f64 = 60.0,
        /// Damping ratio of contacts; the engine's default. Lower bounces.
        pub contact_damping: f64 = 10.0,
        /// Iterations of the solver in a step; the engine's default. Fewer let stacks sink.
        pub solver_iterations: usize = 4,
    }
}

impl BodiesConfig {
    /// # Errors
    /// [`SimulationError::Setting`] with the name.
    pub(super) fn check(&self) -> Result<(), SimulationError> {
        check_range(
            "step_s",
            self.step_s,
            [1e-5, 0.1],
            "a duration from 1e-5 to 0.1 s",
        )?;
        check_range(
            "gravity_m_s2",
            self.gravity_m_s2,
            [0.0, 100.0],
            "0 to 100 m/s2",
        )?;
        check_range("friction", self.friction, [0.0, 100.0], "0 to 100")?;
        check_range(
            "contact_frequency_hz",
            self.contact_frequency_hz,
            [1.0, 1e5],
            "1 to 100000 Hz",
        )?;
        check_range(
            "contact_damping",
            self.contact_damping,
            [1e-3, 1e3],
            "0.001 to 1000",
        )?;
        check_range(
            "solver_iterations",
            self.solver_iterations as f64,
            [1.0, 1000.0],
            "1 to 1000",
        )
    }
}
