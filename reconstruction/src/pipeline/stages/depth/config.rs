//! Constants of the stage `depth`.

use estimator_config::config;

use super::super::keyframe_spacing::KeyframeSpacing;
use super::super::preset::Preset;

config! {
    /// Which frames get depth, and which depths are stored.
    pub(super) struct DepthStageConfig {
        /// The matcher.
        pub matching: ::depth::Config = ::depth::Config::default(),
        /// Spacing of keyframes.
        pub keyframes: KeyframeSpacing = KeyframeSpacing::default(),
        /// Minimum distance of the disparity search, m: excludes the wearer's hands and knees.
        pub min_distance_m: f64 = 0.25,
        /// Maximum sigma as a ratio of the depth: beyond it the first-order error model does not
        /// hold.
        pub max_relative_sigma: f64 = 0.2,
    }
}

impl DepthStageConfig {
    /// Configuration of a preset.
    pub(super) fn preset(preset: Preset) -> Self {
        let mut config = Self {
            keyframes: KeyframeSpacing::preset(preset),
            ..Self::default()
        };
        match preset {
            Preset::Fast => {
                config.matching = ::depth::Config::preset(::depth::Preset::Fast);
            }
            Preset::Balanced => {}
            Preset::Accurate => {
                config.matching = ::depth::Config::preset(::depth::Preset::Accurate);
            }
        }
        config
    }
}
