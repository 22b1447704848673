//! The scene at the start of a training: oriented discs where depth was measured.

use estimator_config::config;
use gaussians::GaussianError;

use crate::error::SplatError;
use crate::scene::{Splat, Splats};

/// Opacity at the start, as a logit: a half.
const START_LOGIT: f32 = 0.0;

/// Thickness of a disc against its radius, where depth is more precise than that.
const MIN_THICKNESS: f32 = 0.2;

config! {
    /// Configuration of the points at which a scene starts.
    pub struct StartConfig {
        /// Largest number of points. Voxels grow by a half of an octave until there are no more.
        pub max_points: usize = 75_000,
        /// Edge of a voxel at the distance of its nearest view, px.
        pub spacing_px: f64 = 2.0,
        /// Smallest edge of a voxel, m.
        pub min_spacing_m: f64 = 0.02,
        /// Largest standard deviation of a depth, as a share of it.
        pub max_relative_sigma: f64 = 0.1,
        /// Every which pixel of a row and column is used.
        pub step_px: usize = 4,
        /// Edge of a voxel in standard deviations of the depths in it, at least: smaller ones
        /// would be layers in front of each other.
        pub spacing_sigmas: f64 = 1.0,
        /// Views that are combined with each view.
        pub fused_views: usize = 16,
        /// Largest difference between depths that are combined, standard deviations.
        pub fused_sigmas: f64 = 3.0,
        /// Smallest standard deviation of a combined depth, as a share of that of a single one:
        /// errors of views are not independent.
        pub min_fused_sigma: f64 = 0.25,
        /// How far along its normal a point is moved at most to where views agree, standard
        /// deviations.
        pub search_sigmas: f64 = 3.0,
        /// Smallest mean correlation of the views there.
        pub min_agreement: f64 = 0.6,
        /// Fewest views besides the nearest one.
        pub min_agreeing_views: usize = 2,
    }
}

/// A measured point of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StartPoint {
    /// In the world, m.
    pub position_m: [f32; 3],
    /// Normal of the surface, of any length; `None` where it is unknown.
    pub normal: Option<[f32; 3]>,
    /// Distance to the neighboring points, m.
    pub spacing_m: f32,
    /// Standard deviation along the normal, m.
    pub sigma_m: f32,
    /// Red, green and blue, 0 to 1.
    pub color: [f32; 3],
}

/// Discs at points: half of the spacing wide, as thick as the points are uncertain. Points without
/// normal become spheres.
///
/// ```
/// use splats::{StartPoint, splats_from_points};
///
/// let point = StartPoint {
///     position_m: [0.0, 0.0, 2.0],
///     normal: Some([0.0, -1.0, 0.0]),
///     spacing_m: 0.1,
///     sigma_m: 0.001,
///     color: [0.8, 0.4, 0.1],
/// };
/// let splats = splats_from_points(&[point])?;
/// let disc = splats.get(0);
/// assert!((disc.log_scale[0].exp() - 0.05).abs() < 1e-6);
/// assert!((disc.log_scale[2].exp() - 0.01).abs() < 1e-6);
/// # Ok::<(), splats::SplatError>(())
/// ```
///
/// # Errors
/// [`GaussianError::NotFinite`] if a value is not finite or a spacing not above 0.
pub fn splats_from_points(points: &[StartPoint]) -> Result<Splats, SplatError> {
    let mut splats = Splats::empty(0)?;
    for (index, point) in points.iter().enumerate() {
        let radius = 0.5 * point.spacing_m;
        let positive = radius > 0.0 && point.sigma_m >= 0.0;
        if !positive {
            let parameter = "spacing or sigma";
            return Err(GaussianError::NotFinite { index, parameter }.into());
        }
        let mut splat = Splat::sphere(radius, point.color);
        splat.position_m = point.position_m;
        splat.opacity_logit = START_LOGIT;
        if let Some(normal) = point.normal {
            splat.log_scale[2] = libm::logf(point.sigma_m.max(MIN_THICKNESS * radius));
            splat.rotation_wxyz = rotation_to(normal);
        }
        splats.push(&splat)?;
    }
    Ok(splats)
}

/// The smallest rotation that takes z to a direction. In f64: opposite to z its first component
/// is a difference of nearly equal numbers.
fn rotation_to(direction: [f32; 3]) -> [f32; 4] {
    let [x, y, z] = direction.map(f64::from);
    let norm = (x * x + y * y + z * z).sqrt();
    let w = norm + z;
    match w > 1e-9 * norm {
        true => {
            let length = (w * w + x * x + y * y).sqrt();
            [w, -y, x, 0.0].map(|v| (v / length) as f32)
        }
        false => [0.0, 1.0, 0.0, 0.0],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Quaternion, UnitQuaternion, Vector3};

    #[test]
    fn discs_lie_on_their_surface() {
        for normal in [
            [1.0, 2.0, -0.5],
            [0.0, 0.0, 3.0],
            [0.0, 0.0, -1.0],
            [0.1, 0.0, -2.0],
        ] {
            let [w, x, y, z] = rotation_to(normal);
            let q = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
            let found = q * Vector3::z();
            let expected = Vector3::from(normal).normalize();
            assert!((found - expected).norm() < 1e-6, "{found} {expected}");
        }
        let point = StartPoint {
            position_m: [0.0; 3],
            normal: None,
            spacing_m: 0.0,
            sigma_m: 0.1,
            color: [0.5; 3],
        };
        assert!(splats_from_points(&[point]).is_err());
    }
}
