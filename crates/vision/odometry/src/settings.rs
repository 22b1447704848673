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
pub struct Settings {
    /// Corners followed in each camera.
    pub corners: usize,
    /// Frames in the window.
    pub frames: usize,
    /// Linearisations for a keyframe.
    pub rounds: usize,
    /// Whether the whole window is solved for every frame set, not for keyframes alone.
    pub every: bool,
    /// Movement of corners, beyond that of turning, from one keyframe to the next, px in a picture 672 wide.
    pub parallax_px: f64,
    /// Standard deviation of a corner's place, px.
    pub sigma_px: f64,
}

impl Settings {
    /// Those of a preset.
    pub fn preset(preset: Preset) -> Self {
        let balanced = Self {
            corners: 110,
            frames: 8,
            rounds: 4,
            every: false,
            parallax_px: 12.0,
            sigma_px: 0.5,
        };
        match preset {
            Preset::Fast => Self {
                corners: 60,
                frames: 6,
                rounds: 2,
                ..balanced
            },
            Preset::Balanced => balanced,
            Preset::Accurate => Self {
                corners: 220,
                frames: 12,
                rounds: 6,
                every: true,
                parallax_px: 9.0,
                ..balanced
            },
        }
    }
}
