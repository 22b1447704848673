//! Why there is no depth.

/// See the variants.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DepthError {
    /// Not a picture: give as many pixels as the size says.
    #[error("taking a picture: found {found} pixels, expected {width} x {height}, at least one")]
    Image {
        /// Columns.
        width: usize,
        /// Rows.
        height: usize,
        /// Pixels.
        found: usize,
    },
    /// Pictures of another size than the matcher was made for, or than each other: rectify both to one size.
    #[error(
        "matching a pair: found a {eye} picture of {found:?} pixels, expected {expected:?} (columns and rows)"
    )]
    Size {
        /// `left` or `right`.
        eye: &'static str,
        /// Columns and rows.
        found: [usize; 2],
        /// Columns and rows.
        expected: [usize; 2],
    },
    /// Disparities that cannot be looked for: choose others.
    #[error("choosing disparities to look for: found {found}, expected {expected}")]
    Band {
        /// What was asked for.
        found: String,
        /// What is possible.
        expected: String,
    },
    /// Settings that cannot be followed.
    #[error("setting up a matcher: {what} is {found}, expected {expected}")]
    Settings {
        /// Which.
        what: &'static str,
        /// Its value.
        found: String,
        /// What is possible.
        expected: String,
    },
    /// Not a pair of cameras: give their calibration.
    #[error(
        "turning disparity into depth: found a focal length of {focal_px} px and a baseline of {baseline_m} m, \
         expected both above 0, and all numbers finite"
    )]
    Geometry {
        /// px.
        focal_px: f64,
        /// m.
        baseline_m: f64,
    },
}
