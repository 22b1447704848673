//! Errors of stereo matching.

/// Error of stereo matching.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DepthError {
    /// Invalid image: the number of pixels must be width times height.
    #[error(transparent)]
    Image(#[from] imaging::ImageSizeError),
    /// The size of an image differs from that of the matcher or of the other image: rectify both to
    /// one size.
    #[error(
        "matching a pair: found a {eye} image of {found:?} pixels, expected {expected:?} (columns and rows)"
    )]
    Size {
        /// Name of the image: `left`, `right` or `true`.
        eye: &'static str,
        /// Columns and rows.
        found: [usize; 2],
        /// Columns and rows.
        expected: [usize; 2],
    },
    /// Unsupported disparity range: choose another one.
    #[error("setting the disparity range: found {found}, expected {expected}")]
    Band {
        /// The requested range.
        found: String,
        /// The supported values.
        expected: String,
    },
    /// Invalid configuration.
    #[error("configuring a matcher: {what} is {found}, expected {expected}")]
    Config {
        /// Name of the setting.
        what: &'static str,
        /// Value of the setting.
        found: String,
        /// The supported values.
        expected: String,
    },
    /// Invalid stereo geometry: it must come from a calibration.
    #[error(
        "converting disparity to depth: found a focal length of {focal_px} px and a baseline of {baseline_m} m, \
         expected both above 0 and all values finite"
    )]
    Geometry {
        /// Focal length, px.
        focal_px: f64,
        /// Stereo baseline, m.
        baseline_m: f64,
    },
}
