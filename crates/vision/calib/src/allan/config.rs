//! Configuration of the fit of the noise model.

use estimator_config::config;

config! {
    /// Configuration of [`fit()`](super::fit()). Values were chosen on simulated noise, see the
    /// tests of the stated uncertainties; how the result depends on the others was not charted.
    pub struct FitConfig {
        /// Minimum number of points of a curve.
        pub min_points: usize = 8,
        /// Maximum averaging time at which the fit begins, s. Higher leaves out white noise, lower
        /// includes the filter of the sensor.
        pub max_start_s: f64 = 2.0,
        /// Probability of the residuals below which a fit counts as misfit. Higher adds uncertainty
        /// to good curves.
        pub max_misfit_probability: f64 = 1e-4,
        /// Misfit fractions that are tried.
        pub misfits: [f64; 12] = [0.005, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3, 0.5, 0.8],
        /// Deviation of the curve from the model, as a fraction and root mean square where a term
        /// matters, up to which the term is called determined. Higher calls known what the curve
        /// does not show: a ramp of the rate is 0.5 or more off a random walk. Real curves of 36
        /// hours are up to 0.15 off.
        pub max_known_misfit: f64 = 0.3,
        /// Minimum significance of a determined power, in standard deviations. Lower states values
        /// that are noise.
        pub min_significance_sigma: f64 = 3.0,
        /// Upper limits: the power at which an estimate would be as small as it is with this
        /// probability. Source: nominally this is more than the stated 95 %; estimates of bias
        /// instability beside a random walk are skewed downwards, and with 1.6 standard deviations
        /// one limit in four was too low in simulations where the two are hard to separate.
        pub limit_probability: f64 = 0.0047,
        /// The same in standard deviations of a normal variable.
        pub limit_sigma: f64 = 2.6,
    }
}
