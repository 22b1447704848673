//! Random Gaussians, for tests and examples of this crate and of those that render.

use crate::GaussianError;
use crate::splats::{Splat, Splats, coefficients};

/// Random Gaussians in front of a camera at the origin that looks along z, 0.5 to 4.5 m away.
/// `mean_log_scale` is the mean of the logarithms of their scales, whose standard deviation is 0.7.
///
/// ```
/// let splats = gaussians::random_splats(7, 100, 1, -2.6)?;
/// assert_eq!((splats.len(), splats.degree()), (100, 1));
/// # Ok::<(), gaussians::GaussianError>(())
/// ```
///
/// # Errors
/// [`GaussianError::Degree`] above [`crate::MAX_DEGREE`].
pub fn random_splats(
    seed: u64,
    count: usize,
    degree: usize,
    mean_log_scale: f32,
) -> Result<Splats, GaussianError> {
    let mut splats = Splats::empty(degree)?;
    for i in 0..count as u64 {
        let uniform = |k: u64| counter_random::uniform(seed, k, i) as f32;
        let bell = |k: u64| counter_random::bell(seed, k, i) as f32;
        let z = 0.5 + 4.0 * uniform(0);
        let mut splat = Splat::sphere(0.1, [0.5; 3]);
        splat.position_m = [
            (uniform(1) - 0.5) * 1.6 * z,
            (uniform(2) - 0.5) * 1.4 * z,
            z,
        ];
        splat.log_scale = std::array::from_fn(|k| mean_log_scale + 0.7 * bell(3 + k as u64));
        splat.rotation_wxyz = std::array::from_fn(|k| 0.2 + bell(6 + k as u64));
        splat.opacity_logit = 1.0 + 2.0 * bell(10);
        for k in 0..coefficients(degree) {
            let size = if k == 0 { 0.8 } else { 0.2 };
            splat.harmonics[k] = std::array::from_fn(|c| size * bell(11 + 3 * k as u64 + c as u64));
        }
        splats.push(&splat)?;
    }
    Ok(splats)
}
