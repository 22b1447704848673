//! Errors of Gaussians.

/// Reasons why parameters are not Gaussians.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum GaussianError {
    /// A parameter is NaN or infinite: the file or the optimizer that it comes from is broken.
    #[error("the {parameter} of Gaussian {index} is not a finite number")]
    NotFinite {
        /// Index of the Gaussian.
        index: usize,
        /// Name of the parameter.
        parameter: &'static str,
    },
    /// A rotation of length zero has no direction.
    #[error("the rotation of Gaussian {index} is a quaternion of length 0 or not finite")]
    ZeroRotation {
        /// Index of the Gaussian.
        index: usize,
    },
    /// Harmonics of a higher degree than any renderer evaluates.
    #[error("spherical harmonics of degree {found}, expected 0 to 3")]
    Degree {
        /// Degree as found.
        found: usize,
    },
    /// The planes are not those of the degree, or have different lengths.
    #[error("planes of {lengths:?} values, expected {expected} planes of one length")]
    Planes {
        /// Length of each plane.
        lengths: Vec<usize>,
        /// Number of planes of this degree.
        expected: usize,
    },
}
