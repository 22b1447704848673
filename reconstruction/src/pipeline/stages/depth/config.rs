//! Constants of the stage `depth`.

use estimator_config::config;

use super::super::Preset;

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

    /// Keyframe spacing: a keyframe is due as soon as one of the two is reached.
    pub(super) struct KeyframeSpacing {
        /// Translation of the rig, m: one step of a person. Half of it doubles time and size.
        pub translation_m: f64 = 0.5,
        /// Rotation of the rig, degrees: a third of the field of view.
        pub rotation_deg: f64 = 20.0,
    }
}

impl DepthStageConfig {
    /// Configuration of a preset.
    pub(super) fn preset(preset: Preset) -> Self {
        let mut config = Self::default();
        match preset {
            Preset::Fast => {
                config.matching = ::depth::Config::preset(::depth::Preset::Fast);
                config.keyframes.translation_m = 1.0;
                config.keyframes.rotation_deg = 30.0;
            }
            Preset::Balanced => {}
            Preset::Accurate => {
                config.matching = ::depth::Config::preset(::depth::Preset::Accurate);
                config.keyframes.translation_m = 0.25;
                config.keyframes.rotation_deg = 10.0;
            }
        }
        config
    }
}
