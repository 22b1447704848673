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
