//! How much work is done.

/// Points on the curve of error against time; `cargo xtask bench odometry` draws it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preset {
    /// Least time.
    Fast,
    /// The knee of the curve.
    Balanced,
    /// Least error.
    Accurate,
}

/// Settings of odometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Config {
    /// Corners followed in each camera.
    pub max_features: usize,
    /// Frames in the window.
    pub window_size: usize,
    /// Linearisations for a keyframe.
    pub max_iterations: usize,
    /// Whether the whole window is solved for every frame set, not for keyframes alone.
    pub optimize_every_frame: bool,
    /// Movement of corners, beyond that of turning, from one keyframe to the next, px in a picture 672 wide.
    pub keyframe_parallax_px: f64,
    /// Standard deviation of a corner's place, px.
    pub observation_sigma_px: f64,
}

impl Config {
    /// Those of a preset.
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
