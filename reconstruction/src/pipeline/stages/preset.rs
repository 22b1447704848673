//! Presets of the pipeline.

/// Trade-off of error against time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Preset {
    /// Least time.
    Fast,
    /// The knee of the curve.
    #[default]
    Balanced,
    /// Least error.
    Accurate,
}

impl Preset {
    /// Its name on the command line.
    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Fast => "fast",
            Self::Balanced => "balanced",
            Self::Accurate => "accurate",
        }
    }
}
