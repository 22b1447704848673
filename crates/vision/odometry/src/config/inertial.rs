//! Constants of the inertial front end.

use estimator_config::config;

config! {
    /// IMU samples and their preintegration.
    pub struct InertialConfig {
        /// Factors on the noise densities of the data sheet or an Allan deviation, gyroscope and
        /// accelerometer; cover thermal drift and vibration. That of the gyroscope is 2 in reported
        /// sigmas, which are those of the solver times
        /// [`sigma_inflation`](crate::config::CovarianceConfig): noise of the gyroscope is
        /// independent from sample to sample, errors of matches are not. Lower is overconfident on
        /// real motion (`cargo xtask bench gtsam`), higher leaves the heading to images.
        pub noise_inflation: [f64; 2] = [2.0 / 3.0, 2.0],
        /// Prior sigma of the scale error of the gyroscope about each axis, which is estimated: a
        /// value for consumer MEMS parts.
        pub gyro_scale_sigma: f64 = 4e-3,
        /// What is not estimated adds a sigma that grows with the motion: misalignment of the
        /// gyroscope, 1e-3 in reported sigmas, scale and misalignment of the accelerometer.
        pub relative_error: [f64; 2] = [1e-3 / 3.0, 1e-3],
        /// Noise densities of the constant-velocity model without IMU samples, acceleration in
        /// m/s²/√Hz and rotation in rad/s/√Hz: the unknown acceleration of a walking person.
        pub constant_velocity_noise_density: [f64; 2] = [3.0, 0.7],
        /// Maximum interval between samples without a gap, in nominal intervals: up to three lost
        /// samples are interpolated. Higher integrates over a peak of the gait that was not
        /// measured.
        pub max_interval_ratio: f64 = 4.5,
        /// Silence after which another IMU takes over, ns. Shorter gaps are bridged by images and
        /// constant velocity: a change loses the biases, which take seconds to determine.
        pub takeover_delay_ns: i64 = 200_000_000,
        /// Saturation of the sensor.
        pub saturation: SaturationConfig = SaturationConfig::default(),
    }

    /// Detection of saturation below the nominal range: identical consecutive samples. Source:
    /// `cargo xtask bench odometry_faults`, fault `imu_clipping`. Pairs are of gyroscope, rad/s,
    /// and accelerometer, m/s².
    pub struct SaturationConfig {
        /// Fraction of the nominal range from which a sample is saturated.
        pub range_ratio: f64 = 0.995,
        /// Number of identical samples of an axis that mean saturation at values that it can have
        /// at rest, where only noise changes them.
        pub stuck_samples: usize = 12,
        /// The same at values that no axis has at rest. The noise of a gyroscope may be below its
        /// resolution, and four samples at a peak of the gait can be identical.
        pub stuck_samples_moving: [usize; 2] = [6, 4],
        /// Value that no axis has at rest.
        pub moving_threshold: [f64; 2] = [0.3, 12.0],
        /// Minimum saturation level: smaller identical samples are those of a coarse resolution.
        pub min_level: [f64; 2] = [0.05, 0.5],
    }
}
