//! Configuration of the bundle adjustment.
//!
//! The damping schedule is that of Levenberg and Marquardt (factors of 10). Where a field names no
//! source, its value was chosen on the simulated recordings of `cargo xtask bench calib`; how the
//! error depends on it was not charted.

use estimator_config::config;

config! {
    /// Configuration of [`solve`](super::solve).
    pub struct Config {
        /// Threshold of the Huber loss, in standard deviations. Lower gives up efficiency for
        /// normal noise, higher lets outliers bias the result.
        pub huber_sigma: f64 = 2.5,
        /// Maximum number of steps per round; there are three rounds, each with a better scale.
        pub max_steps: usize = 60,
        /// Relative decrease of the cost below which the last round ends. Higher ends along flat
        /// directions before the minimum.
        pub tolerance: f64 = 1e-10,
        /// The same for the first two rounds, which only give the scale.
        pub first_tolerance: f64 = 1e-4,
        /// The same for adjustments whose result is only compared or improved further.
        pub approximate_tolerance: f64 = 1e-6,
        /// Whether covariances are computed: they cost about as much as a step.
        pub covariance: bool = true,
        /// Initial damping, relative to the diagonal.
        pub initial_damping: f64 = 1e-4,
        /// Minimum damping.
        pub min_damping: f64 = 1e-14,
        /// Maximum damping; above it no step decreases the cost.
        pub max_damping: f64 = 1e10,
        /// Minimum fraction of points that can be projected at the initial values. Lower starts
        /// from poses that are wrong.
        pub min_projected_ratio: f64 = 0.6,
        /// Residual of a point that cannot be projected, in standard deviations. Lower lets a step
        /// improve the cost by turning points out of view.
        pub unprojected_sigma: f64 = 30.0,
    }

    /// Configuration of [`locate`](super::locate).
    pub struct LocateConfig {
        /// Threshold of the Huber loss, in standard deviations.
        pub huber_sigma: f64 = 2.5,
        /// Maximum number of steps per round; there are two rounds.
        pub max_steps: usize = 40,
        /// Relative decrease of the cost below which a round ends.
        pub tolerance: f64 = 1e-9,
        /// Initial damping, relative to the diagonal.
        pub initial_damping: f64 = 1e-4,
        /// Minimum damping.
        pub min_damping: f64 = 1e-12,
        /// Maximum damping; above it no step decreases the cost.
        pub max_damping: f64 = 1e8,
        /// Minimum fraction of points that can be projected at the initial pose.
        pub min_projected_ratio: f64 = 0.6,
        /// Residual of a point that cannot be projected, in standard deviations. Lower lets a pose
        /// improve its cost by turning points out of view.
        pub unprojected_sigma: f64 = 30.0,
    }
}

impl Config {
    /// For adjustments whose result is only compared or improved further: without covariances.
    pub(crate) fn approximate(&self) -> Self {
        Self {
            covariance: false,
            tolerance: self.approximate_tolerance,
            ..*self
        }
    }
}
