//! Results: disparity maps with a sigma per pixel, and depth maps.

use crate::error::DepthError;

/// Disparities of the left image, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DisparityMap {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Disparity: column in the left image minus column in the right image, px; NaN where absent.
    pub disparity: Vec<f32>,
    /// Half of the 95 % quantile of the error of such disparities, px; NaN where the disparity is.
    pub sigma: Vec<f32>,
}

/// Depths along the optical axis, row-major.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DepthMap {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Depth, m; NaN where absent.
    pub depth_m: Vec<f32>,
    /// Standard deviation of the depth, m, propagated to first order from that of the disparity;
    /// NaN where the depth is.
    pub sigma_m: Vec<f32>,
}

/// Geometry of a rectified stereo camera.
///
/// ```
/// use depth::Geometry;
///
/// let geometry = Geometry { focal_px: 700.0, center: [671.5, 375.5], baseline_m: 0.06, offset_px: 0.0 };
/// assert_eq!(geometry.depth_m(21.0), 2.0);
/// assert_eq!(geometry.disparity_px(2.0), 21.0);
///
/// let swapped = Geometry { baseline_m: -0.06, ..geometry };
/// assert!(swapped.validate().unwrap_err().to_string().contains("a baseline of -0.06 m"));
/// ```
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// Focal length of both cameras, px.
    pub focal_px: f64,
    /// Principal point of the left camera, px.
    pub center: [f64; 2],
    /// Stereo baseline, m.
    pub baseline_m: f64,
    /// Principal point of the right camera minus that of the left one along x, px; 0 for most
    /// pairs.
    pub offset_px: f64,
}

impl Geometry {
    /// # Errors
    /// [`DepthError::Geometry`] if the focal length or the baseline is not above 0, or a value is
    /// not finite.
    pub fn validate(&self) -> Result<(), DepthError> {
        let lengths = [self.focal_px, self.baseline_m];
        let others = [self.center[0], self.center[1], self.offset_px];
        let valid = lengths.iter().all(|v| *v > 0.0 && v.is_finite());
        if valid && others.iter().all(|v| v.is_finite()) {
            return Ok(());
        }
        Err(DepthError::Geometry {
            focal_px: self.focal_px,
            baseline_m: self.baseline_m,
        })
    }

    /// Depth of a disparity, m; infinite or negative for disparities at or beyond infinity.
    pub fn depth_m(&self, disparity_px: f64) -> f64 {
        self.focal_px * self.baseline_m / (disparity_px + self.offset_px)
    }

    /// Disparity of a depth, px.
    pub fn disparity_px(&self, depth_m: f64) -> f64 {
        self.focal_px * self.baseline_m / depth_m - self.offset_px
    }

    /// Depths of a map. Pixels whose sigma exceeds `max_relative_sigma` times their depth are
    /// absent: their depth is not determined.
    ///
    /// # Errors
    /// [`DepthError::Geometry`].
    ///
    /// ```
    /// use depth::{DisparityMap, Geometry};
    ///
    /// let geometry = Geometry { focal_px: 700.0, center: [1.0, 0.0], baseline_m: 0.06, offset_px: 0.0 };
    /// let map = DisparityMap {
    ///     width: 3,
    ///     height: 1,
    ///     disparity: vec![21.0, 0.5, f32::NAN],
    ///     sigma: vec![0.21, 0.21, f32::NAN],
    /// };
    /// let depth = geometry.depth(&map, 0.1)?;
    /// // A sigma of a hundredth of the disparity is one of a hundredth of the depth.
    /// assert_eq!((depth.depth_m[0], depth.sigma_m[0]), (2.0, 0.02));
    /// // Near infinity the depth is not determined.
    /// assert!(depth.depth_m[1].is_nan() && depth.depth_m[2].is_nan());
    /// # Ok::<(), depth::DepthError>(())
    /// ```
    pub fn depth(
        &self,
        map: &DisparityMap,
        max_relative_sigma: f64,
    ) -> Result<DepthMap, DepthError> {
        self.validate()?;
        let of = |(disparity, sigma): (&f32, &f32)| {
            let apart = f64::from(*disparity) + self.offset_px;
            let relative = f64::from(*sigma) / apart;
            // False for NaN.
            if apart > 0.0 && relative <= max_relative_sigma {
                let depth = self.depth_m(f64::from(*disparity));
                (depth as f32, (depth * relative) as f32)
            } else {
                (f32::NAN, f32::NAN)
            }
        };
        let pixels = map.disparity.iter().zip(&map.sigma).map(of);
        let (depth_m, sigma_m) = pixels.unzip();
        Ok(DepthMap {
            width: map.width,
            height: map.height,
            depth_m,
            sigma_m,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GEOMETRY: Geometry = Geometry {
        focal_px: 400.0,
        center: [319.5, 239.5],
        baseline_m: 0.1,
        offset_px: 2.0,
    };

    #[test]
    fn depth_sigma_follows_from_the_disparity_sigma() {
        let map = DisparityMap {
            width: 5,
            height: 1,
            disparity: vec![18.0, f32::NAN, -1.0, -2.0, -5.0],
            sigma: vec![0.2, f32::NAN, 0.2, 0.2, 0.2],
        };
        let depth = GEOMETRY.depth(&map, 0.25).unwrap();
        // 400 * 0.1 / 20; the sigma is 1 % of it, since that of the disparity is 1 % of 20.
        assert!((depth.depth_m[0] - 2.0).abs() < 1e-6);
        assert!((depth.sigma_m[0] - 0.02).abs() < 1e-6);
        let moved = GEOMETRY.depth_m(18.2) - GEOMETRY.depth_m(18.0);
        assert!((moved.abs() - 0.02).abs() < 5e-4, "{moved}");
        assert!((depth.depth_m[2] - 40.0).abs() < 1e-4);
        // At infinity, beyond it, and absent.
        assert!([1, 3, 4].iter().all(|i| depth.depth_m[*i].is_nan()));
        assert!([1, 3, 4].iter().all(|i| depth.sigma_m[*i].is_nan()));
        // 0.2 px of 1 px exceeds a limit of one tenth.
        assert!(GEOMETRY.depth(&map, 0.1).unwrap().depth_m[2].is_nan());
    }

    #[test]
    fn depth_and_disparity_are_inverse() {
        for depth in [0.2, 3.0, 80.0] {
            let there = GEOMETRY.depth_m(GEOMETRY.disparity_px(depth));
            assert!((there - depth).abs() < 1e-9 * depth);
        }
    }

    #[test]
    fn invalid_geometry_is_rejected() {
        let map = DisparityMap::default();
        for bad in [0.0, -1.0, f64::NAN, f64::INFINITY] {
            let geometry = Geometry {
                baseline_m: bad,
                ..GEOMETRY
            };
            let error = geometry.depth(&map, 1.0).unwrap_err();
            assert!(error.to_string().contains("baseline"), "{error}");
        }
    }
}
