//! Configuration of the estimator: all of its tuned constants, and the presets.
//!
//! One struct per concern, in the order of the data flow. Where a field names no source, its value
//! was chosen on the simulated walks of `cargo xtask bench odometry` and its fault schedules
//! (`odometry_faults`), with images 672 px wide; how the error depends on it was not charted.

use estimator_config::config;

mod backend;
mod estimator;
mod frontend;
mod inertial;
mod mapping;

pub use backend::{
    BackendConfig, CovarianceConfig, ExtrinsicsConfig, NewestPoseConfig, StereoCalibrationConfig,
};
pub use estimator::{
    CameraShiftConfig, EstimatorConfig, InitializationConfig, KeyframeConfig,
    ReinitializationConfig,
};
pub use frontend::{
    CrossCameraConfig, DetectorConfig, FrontendConfig, KeypointConfig, StaleImageConfig,
    StereoConfig,
};
pub use inertial::{InertialConfig, SaturationConfig};
pub use mapping::{LoopClosureConfig, MappingConfig};

/// Presets between speed and accuracy; `cargo xtask bench odometry` measures both.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preset {
    /// Fastest.
    Fast,
    /// The knee of the curve of error against time.
    Balanced,
    /// A larger window of more keyframes.
    Accurate,
}

config! {
    /// Configuration of the estimator. The default is [`Preset::Balanced`].
    ///
    /// ```
    /// use odometry::{Config, Preset};
    ///
    /// let mut config = Config::preset(Preset::Fast);
    /// assert_eq!(config.frontend.max_features, 60);
    /// // Any field can be changed for an experiment.
    /// config.mapping.loop_closure.max_distance_m = 3.0;
    /// assert_ne!(config, Config::preset(Preset::Fast));
    /// ```
    pub struct Config {
        /// From images to features.
        pub frontend: FrontendConfig = FrontendConfig::default(),
        /// From IMU samples to preintegrated motion.
        pub inertial: InertialConfig = InertialConfig::default(),
        /// The sliding window and its solver.
        pub backend: BackendConfig = BackendConfig::default(),
        /// Decisions between the two: keyframes, outliers, losses.
        pub estimator: EstimatorConfig = EstimatorConfig::default(),
        /// Bundle adjustment of the whole session.
        pub mapping: MappingConfig = MappingConfig::default(),
    }
}

impl Config {
    /// Configuration of a preset.
    ///
    /// ```
    /// use odometry::{Config, Preset};
    ///
    /// let [fast, accurate] = [Preset::Fast, Preset::Accurate].map(Config::preset);
    /// assert!(fast.backend.window_size < accurate.backend.window_size);
    /// assert!(fast.backend.max_iterations < accurate.backend.max_iterations);
    ///
    /// // One value of a preset replaced: images of a camera with large pixels.
    /// let mut own = Config::preset(Preset::Balanced);
    /// own.backend.observation_sigma_px = 0.3;
    /// assert_eq!(own.backend.window_size, 8);
    /// ```
    pub fn preset(preset: Preset) -> Self {
        let mut config = Self::default();
        match preset {
            Preset::Fast => {
                config.frontend.max_features = 60;
                config.backend.window_size = 6;
                config.backend.max_iterations = 2;
            }
            Preset::Balanced => {}
            // More features, whose errors are alike, do not help, nor does a window that is
            // optimized at every frame: docs/decisions/0010-odometry.md.
            Preset::Accurate => {
                config.backend.window_size = 12;
                config.backend.max_iterations = 6;
                config.estimator.keyframes.min_parallax = 9.0 / 672.0;
            }
        }
        config
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn presets_differ_in_cost_only_where_they_say_so() {
        let [fast, balanced, accurate] =
            [Preset::Fast, Preset::Balanced, Preset::Accurate].map(Config::preset);
        assert_eq!(balanced, Config::default());
        let cost = |c: &Config| c.frontend.max_features * c.backend.window_size;
        assert!(cost(&fast) < cost(&balanced) && cost(&balanced) < cost(&accurate));
        for preset in [fast, accurate] {
            assert_eq!(preset.inertial, balanced.inertial);
            assert_eq!(preset.mapping, balanced.mapping);
        }
    }

    #[test]
    fn values_are_sensible() {
        let Config {
            frontend,
            inertial,
            backend,
            estimator,
            mapping,
        } = Config::default();
        let ratios = [
            frontend.klt.min_ncc,
            frontend.stereo.min_ncc,
            frontend.cross_camera.max_inverse_range_error_ratio,
            estimator.min_inlier_ratio,
            estimator.imu_suspect_inlier_ratio,
            estimator.vision_only_inlier_ratio,
            estimator.keyframes.min_tracked_ratio,
            estimator.keyframes.min_parallax,
            estimator.camera_shift.min_rotated_inlier_ratio,
            mapping.loop_closure.min_inlier_ratio,
            mapping.loop_closure.second_best_ratio,
        ];
        assert!(ratios.iter().all(|r| *r > 0.0 && *r < 1.0), "{ratios:?}");
        // The IMU is rejected only for a better explanation.
        assert!(estimator.imu_suspect_inlier_ratio < estimator.vision_only_inlier_ratio);
        assert!(
            estimator.keyframes.min_tracked_ratio_early < estimator.keyframes.min_tracked_ratio
        );
        // Loss scales decrease.
        let decreases = |scales: &[f64]| scales.windows(2).all(|pair| pair[0] >= pair[1]);
        assert!(decreases(&mapping.loop_closure.tukey_sigma));
        assert!(decreases(&backend.newest_pose.tukey_sigma));
        assert!(decreases(&backend.newest_pose.tukey_sigma_without_imu));
        assert!(mapping.loop_closure.cauchy_sigma < mapping.loop_closure.cauchy_sigma_first);
        // In reported sigmas the IMU is not better than its data sheet.
        let sigma_inflation = backend.covariance.sigma_inflation;
        assert!(sigma_inflation >= 1.0);
        assert!((inertial.noise_inflation.iter()).all(|times| times * sigma_inflation >= 1.0));
        assert!(frontend.stereo.max_level < frontend.pyramid.max_levels);
        assert!(frontend.temporal_max_level < frontend.pyramid.max_levels);
    }
}
