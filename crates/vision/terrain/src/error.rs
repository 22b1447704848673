//! Errors of this crate.

/// Error of terrain reconstruction: the input must be corrected, nothing was changed by the call.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum TerrainError {
    /// The number of values of an image is not columns times rows.
    #[error("reading a depth image: found {found} values of {what}, expected {expected}")]
    ImageSize {
        /// Name of the image: `depth`, `sigma`, `color` or `classes`.
        what: &'static str,
        /// Number of values.
        found: usize,
        /// Columns times rows.
        expected: usize,
    },
    /// A number of a view is outside of what is possible.
    #[error("reading a depth image: {what} is {found}, expected {expected}")]
    View {
        /// Name of the number.
        what: &'static str,
        /// Its value.
        found: f64,
        /// The supported values.
        expected: &'static str,
    },
    /// A setting is outside of what is possible.
    #[error("configuring terrain: {what} is {found}, expected {expected}")]
    Config {
        /// Name of the setting.
        what: &'static str,
        /// Its value.
        found: f64,
        /// The supported values.
        expected: &'static str,
    },
    /// The view is too far from the origin of the world for the voxel grid.
    #[error(
        "fusing a depth image: found a view {distance_m} m from the world's origin, expected at most {max_m} m"
    )]
    TooFar {
        /// Distance of the view from the origin, m.
        distance_m: f64,
        /// Maximum distance, m.
        max_m: f64,
    },
}
