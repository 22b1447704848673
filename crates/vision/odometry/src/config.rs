//! Configuration and presets of the estimator.

/// Presets between speed and accuracy; `cargo xtask bench odometry` measures both.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preset {
    /// Fastest.
    Fast,
    /// The knee of the curve of error against time.
    Balanced,
    /// Most accurate.
    Accurate,
}

/// Configuration of the estimator.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Maximum number of features tracked per camera. Compare OpenVINS `num_pts`.
    pub max_features: usize,
    /// Number of frames in the sliding window. Compare OpenVINS `max_clones`.
    pub window_size: usize,
    /// Maximum number of solver iterations for a keyframe.
    pub max_iterations: usize,
    /// Whether the whole window is optimized for every frame set, and not for keyframes only.
    pub optimize_every_frame: bool,
    /// Median parallax of features, rotation removed, from one keyframe to the next, px in an image
    /// 672 px wide.
    pub keyframe_parallax_px: f64,
    /// Standard deviation of an observation, px.
    pub observation_sigma_px: f64,
}

impl Config {
    /// Configuration of a preset.
    pub fn preset(preset: Preset) -> Self {
        let balanced = Self {
            max_features: 110,
            window_size: 8,
            max_iterations: 4,
            optimize_every_frame: false,
            keyframe_parallax_px: 12.0,
            observation_sigma_px: 0.5,
        };
        match preset {
            Preset::Fast => Self {
                max_features: 60,
                window_size: 6,
                max_iterations: 2,
                ..balanced
            },
            Preset::Balanced => balanced,
            Preset::Accurate => Self {
                max_features: 220,
                window_size: 12,
                max_iterations: 6,
                optimize_every_frame: true,
                keyframe_parallax_px: 9.0,
                ..balanced
            },
        }
    }
}
