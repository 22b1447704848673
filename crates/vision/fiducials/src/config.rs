//! Configuration of the template fit.

use estimator_config::config;

config! {
    /// Configuration of [`fit`](crate::fit()).
    pub struct Config {
        /// Correlation of all eyes with the pattern at the start from which on it is not moved.
        pub min_start_correlation: f64 = 0.8,
        /// Maximum number of iterations.
        pub max_iterations: usize = 12,
        /// Motion of the corners in an iteration at which the fit has converged, cells: what
        /// remains is a small part of it.
        pub convergence_cells: f64 = 0.01,
        /// Likewise before pixels are selected again.
        pub first_convergence_cells: f64 = 0.05,
        /// Motion of the corners from the start up to which pixels are not selected again, cells.
        pub kept_cells: f64 = 0.15,
        /// Change of the logarithm of the blur, likewise.
        pub kept_log_blur: f64 = 0.25,
        /// Motion of the corners in an iteration that does not lower the cost, at which the fit has
        /// converged, cells.
        pub rejected_cells: f64 = 0.01,
        /// Noise of a pixel that no fit is better than, gray levels.
        pub noise_levels: f64 = 2.0,
        /// Residuals beyond this multiple of their median count less.
        pub robust_ratio: f64 = 2.5,
        /// Blur of lens and sensor, and its prior, px.
        pub blur_px: f64 = 0.7,
        /// Uncertainty of the logarithm of the blur.
        pub blur_sigma: f64 = 0.5,
        /// Exponent of the tone curve: gray levels are proportional to this power of light. 0.45
        /// for sRGB and most video.
        pub tone: f64 = 0.45,
        /// Uncertainty of that exponent.
        pub tone_sigma: f64 = 0.1,
        /// Minimum difference of white and black, gray levels.
        pub min_contrast_levels: f64 = 12.0,
        /// Maximum number of pixels of an eye that count, evenly spread over larger tags. Errors
        /// of the model, which all pixels share, limit the accuracy, not noise.
        pub max_pixels: usize = 500,
        /// Minimum share of the tag's cells inside the image.
        pub min_share: f64 = 0.5,
        /// Maximum number of wrong bits of a tag of known identity.
        pub max_wrong_bits: u32 = 5,
        /// Minimum share of the cells that agree with the code: of a sharp tag, of which the others
        /// are covered, and of one that motion blurs, whose bits contradict hardly anything.
        pub min_agreeing_share: [f64; 2] = [0.45, 0.75],
        /// Motion during the exposure from which on a tag counts as blurred, cells.
        pub blurred_cells: f64 = 0.7,
        /// Maximum robust cost of a second pose above that of the first, in units of the noise of
        /// pixels: three sigmas squared. Neighboring pixels share their errors, hence more.
        pub max_excess_cost: f64 = 80.0,
        /// Multiple of the decrease of the cost that the next iteration promises by which the cost
        /// of a second pose may be too high before its fit is given up.
        pub give_up_ratio: f64 = 3.0,
        /// Minimum rotation between two poses that count as two, rad.
        pub min_other_rad: f64 = 0.03,
        /// Standard deviation of the tilt below which no fit is trusted, rad: that of images of the
        /// simulated rig.
        pub tilt_floor_rad: f64 = 0.012,
        /// Likewise for each cell of motion during the exposure, rad.
        pub tilt_per_cell_rad: f64 = 0.04,
        /// Standard deviation of a corner below which no fit is trusted, as a share of the blur.
        pub corner_floor_ratio: f64 = 0.06,
    }
}
