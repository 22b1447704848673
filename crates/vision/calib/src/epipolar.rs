//! Epipolar error of a matched pair of pixels, without a depth.
//!
//! Contract: pixels are those of the delivered, distorted images. Both measures are in pixels of
//! undistorted images with the pair's mean focal length near the axis, so that they are comparable
//! between lens models. A pixel without a direction, or one behind the rectified plane, gives
//! `None`.
//!
//! ```
//! # use calib::epipolar;
//! # use camera_models::{CameraModel, Distortion, StereoCalibration};
//! # use cad_transforms::RigidTransform;
//! # let left = CameraModel { width: 640, height: 480, fx: 500.0, fy: 500.0, cx: 320.0, cy: 240.0,
//! #     distortion: Distortion::None };
//! # let stereo = StereoCalibration { left, right: left,
//! #     right_from_left: RigidTransform::from_translation_m([-0.1, 0.0, 0.0]).unwrap(), imu: None,
//! #     provenance: camera_models::Provenance { format: None, files: Vec::new(), part: None } };
//! let rows = epipolar::row_difference(&stereo, [330.0, 250.0], [310.0, 251.5]).unwrap();
//! assert!((rows - 1.5).abs() < 1e-9);
//! ```
//!
//! ```
//! # use calib::epipolar;
//! # use camera_models::{CameraModel, Distortion, StereoCalibration};
//! # use cad_transforms::RigidTransform;
//! # let left = CameraModel { width: 640, height: 480, fx: 500.0, fy: 500.0, cx: 320.0, cy: 240.0,
//! #     distortion: Distortion::None };
//! # let stereo = StereoCalibration { left, right: left,
//! #     right_from_left: RigidTransform::from_translation_m([-0.1, 0.0, 0.0]).unwrap(), imu: None,
//! #     provenance: camera_models::Provenance { format: None, files: Vec::new(), part: None } };
//! let rows = epipolar::row_difference(&stereo, [330.0, 250.0], [310.0, 251.5]).unwrap();
//! assert!((rows - 1.5).abs() < 1e-9);
//! ```

use camera_models::rectify::{RectifyError, rotations};
use camera_models::{CameraModel, Distortion, Lens, StereoCalibration};
use nalgebra::{Matrix3, Vector3};

/// A stereo pair prepared for many matches.
#[derive(Clone, Debug)]
pub struct Epipolar {
    left: Lens,
    right: Lens,
    rectified_from_left: Matrix3<f64>,
    rectified_from_right: Matrix3<f64>,
    /// `x_right' E x_left = 0` for the directions of one point.
    essential: Matrix3<f64>,
    focal_px: f64,
}

impl Epipolar {
    /// Prepares a pair.
    ///
    /// # Errors
    /// [`RectifyError::NotBeside`].
    pub fn new(stereo: &StereoCalibration) -> Result<Self, RectifyError> {
        let (rectified_from_left, rectified_from_right) = rotations(stereo)?;
        let matrix = |rows: [f64; 9]| Matrix3::from_row_slice(&rows);
        let offset = stereo.right_from_left.translation().normalize();
        Ok(Self {
            left: Lens::new(&stereo.left),
            right: Lens::new(&stereo.right),
            rectified_from_left: matrix(rectified_from_left.rotation_rows()),
            rectified_from_right: matrix(rectified_from_right.rotation_rows()),
            essential: offset.cross_matrix() * matrix(stereo.right_from_left.rotation_rows()),
            focal_px: (near_axis(&stereo.left) * near_axis(&stereo.right)).sqrt(),
        })
    }

    /// Focal length to which the measures refer, pixels.
    pub fn focal_px(&self) -> f64 {
        self.focal_px
    }

    /// Row of the right pixel minus row of the left one after rectification, pixels.
    pub fn row_difference(&self, left_px: [f64; 2], right_px: [f64; 2]) -> Option<f64> {
        let row = |lens: &Lens, turn: &Matrix3<f64>, pixel| {
            let direction = turn * Vector3::from(lens.unproject(pixel)?);
            (direction.z > 0.0).then(|| self.focal_px * direction.y / direction.z)
        };
        let left = row(&self.left, &self.rectified_from_left, left_px)?;
        let right = row(&self.right, &self.rectified_from_right, right_px)?;
        Some(right - left)
    }

    /// Sampson distance: to first order, the smallest joint displacement of the two pixels that
    /// satisfies the epipolar constraint (Hartley and Zisserman 2004, section 11.4.3). Signed,
    /// pixels.
    pub fn sampson_distance(&self, left_px: [f64; 2], right_px: [f64; 2]) -> Option<f64> {
        let on_plane = |lens: &Lens, pixel| {
            let [x, y, z] = lens.unproject(pixel)?;
            (z > 0.0).then(|| Vector3::new(x / z, y / z, 1.0))
        };
        let left = on_plane(&self.left, left_px)?;
        let right = on_plane(&self.right, right_px)?;
        let in_right = self.essential * left;
        let in_left = self.essential.transpose() * right;
        let slope = in_right.xy().norm_squared() + in_left.xy().norm_squared();
        (slope > 0.0).then(|| self.focal_px * right.dot(&in_right) / slope.sqrt())
    }
}

/// [`Epipolar::row_difference`] of a single match; also `None` for a pair that cannot be rectified.
pub fn row_difference(
    stereo: &StereoCalibration,
    left_px: [f64; 2],
    right_px: [f64; 2],
) -> Option<f64> {
    Epipolar::new(stereo)
        .ok()?
        .row_difference(left_px, right_px)
}

/// Pixels per radian on the axis, the mean of x and y.
fn near_axis(model: &CameraModel) -> f64 {
    let shrunk = match model.distortion {
        Distortion::DoubleSphere { xi, .. } => 1.0 + xi,
        _ => 1.0,
    };
    (model.fx * model.fy).sqrt() / shrunk
}

#[cfg(test)]
mod tests;
