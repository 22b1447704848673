//! Configuration of the measurement of IMU noise: all of its tuned constants.
//!
//! One struct per concern, in the order of the data flow. Where a field names no source, its value
//! was chosen on simulated static recordings and the real ones of `test-data`; how the result
//! depends on it was not charted. Pairs are of gyroscope, rad/s, and accelerometer, m/s².

use estimator_config::config;

use crate::allan::FitConfig;

config! {
    /// Configuration of the measurement of IMU noise.
    pub struct Config {
        /// Bridging of small gaps.
        pub bridging: BridgingConfig = BridgingConfig::default(),
        /// Screening of the recording.
        pub screening: ScreeningConfig = ScreeningConfig::default(),
        /// Fit of the noise model.
        pub fit: FitConfig = FitConfig::default(),
        /// Maximum difference between the halves of a recording, in multiples of the expected
        /// noise. Lower reports drift that is noise.
        pub drift_sigma: f64 = 4.0,
    }

    /// Bridging of small gaps.
    pub struct BridgingConfig {
        /// Maximum length of a gap that is filled, s. Higher replaces noise by a constant, lower
        /// leaves short runs without long averages.
        pub max_gap_s: f64 = 0.1,
        /// Maximum fraction of filled samples: the noise missing in the fill is no more than it.
        pub max_filled_ratio: f64 = 1e-3,
        /// Maximum deviation of a gap from a whole number of periods, in periods.
        pub max_grid_deviation: f64 = 0.25,
    }

    /// Screening of the recording. The samples are processed in blocks. Lower thresholds exclude
    /// noise, higher ones measure motion as noise.
    pub struct ScreeningConfig {
        /// Minimum length of the longest static run without a gap, s.
        pub min_static_s: f64 = 60.0,
        /// Length of a block, s.
        pub block_s: f64 = 1.0,
        /// Maximum spread of a block relative to the median spread.
        pub max_spread_ratio: f64 = 4.0,
        /// Maximum deviation of a block's mean from the median mean, or `max_spread_ratio` times
        /// the median spread if that is larger. Biases change less, attitudes more: 0.05 m/s² is a
        /// tilt of 0.3°.
        pub max_mean_change: [f64; 2] = [0.02, 0.3],
        /// Maximum step of a block's mean from the previous block.
        pub max_step: [f64; 2] = [0.01, 0.05],
        /// Median spreads above which the IMU moved throughout: no IMU worth calibrating is as
        /// noisy as one that is carried.
        pub max_motion: [f64; 2] = [0.05, 0.5],
        /// Margin excluded on both sides of a motion, s.
        pub motion_margin_s: f64 = 2.0,
        /// Outlier threshold, in spreads from the median of the block.
        pub outlier_sigma: f64 = 10.0,
        /// Maximum number of outliers in a block; more are a motion.
        pub max_outliers: usize = 3,
        /// Minimum number of repetitions of a frozen value, whatever its probability.
        pub min_frozen_samples: usize = 20,
        /// Odds against such a run of repetitions by chance anywhere in the recording of an axis,
        /// above which it is frozen. Lower excludes coarse but valid values.
        pub frozen_odds: f64 = 1e6,
        /// Fraction of values at one end of the range above which the axis is saturated.
        pub max_clipped_ratio: f64 = 1e-3,
        /// Minimum number of levels between minimum and maximum; fewer are coarse.
        pub min_levels: usize = 12,
        /// Maximum relative deviation of the rate from its nominal value.
        pub max_rate_deviation: f64 = 0.01,
        /// Deviation of a sample from its nominal time above which it counts as jitter, in periods.
        pub jitter_periods: f64 = 0.2,
        /// Fraction of such samples above which they are reported.
        pub max_jitter_ratio: f64 = 0.01,
        /// Fraction of samples equal to the one before above which the sensor is slower than its
        /// samples.
        pub max_repeated_ratio: f64 = 0.2,
        /// Maximum temperature change over a recording, K: biases follow it.
        pub max_temperature_change_k: f32 = 3.0,
    }
}
