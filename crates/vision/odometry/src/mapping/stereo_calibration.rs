//! Stereo calibrations after bundle adjustment.

use cad_transforms::RigidTransform;
use camera_models::CameraModel;
use nalgebra::{Matrix6, SMatrix};

use crate::backend::stereo::{StereoMatrix, StereoVector};
use crate::backend::window::Window;

/// Chi-square quantile of six dimensions that is exceeded with a probability of 0.27 %, as three
/// sigmas of a normal distribution.
const CHI2_THREE_SIGMA: f64 = 20.062;

/// Estimated error of the stereo calibration of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefinedStereo {
    /// Error of the right eye against the left one: rotation of the right eye about its x, y and z
    /// axes, rad; baseline, relative; focal length, relative; principal point along x, in focal
    /// lengths; decentering of the right lens minus that of the left one (`p2` of OpenCV), which
    /// acts across epipolar lines only.
    pub error: [f64; 7],
    /// Its covariance. What the walk does not determine has that of the calibration.
    pub covariance: SMatrix<f64, 7, 7>,
    /// Whether the error without the decentering is larger than three sigmas of its covariance: the
    /// calibration is wrong.
    pub is_significant: bool,
}

impl RefinedStereo {
    /// Calibrations of all cameras of a window, with their covariances as the solver has them.
    pub(super) fn of(
        sigma_inflation: f64,
        window: &Window,
        covariances: &[StereoMatrix],
    ) -> Vec<Self> {
        let square = sigma_inflation * sigma_inflation;
        let each = window.cameras.iter().zip(covariances);
        each.map(|(camera, covariance)| Self::new(camera.stereo.error, covariance * square))
            .collect()
    }

    fn new(error: StereoVector, covariance: StereoMatrix) -> Self {
        let geometric = error.fixed_rows::<6>(0).into_owned();
        let own: Matrix6<f64> = covariance.fixed_view::<6, 6>(0, 0).into_owned();
        let solved = own.cholesky().map(|c| c.solve(&geometric));
        Self {
            error: error.into(),
            covariance,
            is_significant: solved.is_some_and(|solved| geometric.dot(&solved) > CHI2_THREE_SIGMA),
        }
    }

    /// Standard deviations of [`Self::error`].
    ///
    /// ```
    /// # use nalgebra::SMatrix;
    /// # use odometry::mapping::RefinedStereo;
    /// let refined = RefinedStereo {
    ///     error: [0.0, 1.7e-3, 0.0, 0.0, 0.0, 0.0, 0.0],
    ///     covariance: SMatrix::identity() * 1e-8,
    ///     is_significant: true,
    /// };
    /// assert!((refined.sigmas()[1] - 1e-4).abs() < 1e-12);
    /// ```
    pub fn sigmas(&self) -> [f64; 7] {
        std::array::from_fn(|k| self.covariance[(k, k)].max(0.0).sqrt())
    }

    /// Corrected lens of the right eye and extrinsics between the eyes, from the nominal ones.
    /// The decentering is not corrected, since its effect along epipolar lines is not known.
    ///
    /// ```
    /// # use cad_transforms::RigidTransform;
    /// # use camera_models::{CameraModel, Distortion};
    /// # use nalgebra::SMatrix;
    /// # use odometry::mapping::RefinedStereo;
    /// let lens = CameraModel::new((672, 376), [350.0, 350.0, 335.5, 187.5], Distortion::None);
    /// let right_from_left = RigidTransform::from_translation_m([-0.06, 0.0, 0.0])?;
    /// let refined = RefinedStereo {
    ///     error: [0.0, 0.0, 0.0, 0.01, 0.0, 0.002, 0.0],
    ///     covariance: SMatrix::identity() * 1e-8,
    ///     is_significant: true,
    /// };
    /// let (lens, right_from_left) = refined.corrected(&lens, &right_from_left);
    /// assert!((lens.cx - 336.2).abs() < 1e-9);
    /// assert!((right_from_left.translation_m()[0] + 0.0606).abs() < 1e-5);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn corrected(
        &self,
        right: &CameraModel,
        right_from_left: &RigidTransform,
    ) -> (CameraModel, RigidTransform) {
        let [x, y, z, baseline, focal, principal_point, _] = self.error;
        let longer = right_from_left.translation_m().map(|m| m * baseline.exp());
        let rotation = RigidTransform::from_rotation_vector([x, y, z], [0.0; 3]);
        let stretched = RigidTransform::from_wxyz(right_from_left.rotation_wxyz(), longer);
        let corrected = rotation
            .and_then(|rotation| Ok(rotation * stretched?))
            .unwrap_or(*right_from_left);
        let lens = CameraModel {
            fx: right.fx * focal.exp(),
            fy: right.fy * focal.exp(),
            cx: right.cx + principal_point * right.fx,
            ..*right
        };
        (lens, corrected)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::observation::Camera;
    use crate::backend::stereo::apply_error;
    use crate::test_rig;
    use camera_models::{Distortion, Lens};
    use nalgebra::Vector3;

    #[test]
    fn corrected_calibration_projects_as_the_estimate() {
        let mut nominal = test_rig::stereo(0.1);
        nominal.right.distortion = Distortion::RadTan4 {
            k1: -0.17,
            k2: 0.03,
            p1: 1e-3,
            p2: -5e-4,
        };
        let error = StereoVector::from([2e-3, -1e-3, 3e-3, 0.02, -0.01, 0.004, 0.0]);
        let mut camera = Camera::new(&nominal, &RigidTransform::identity());
        apply_error(&mut camera, &error);
        let refined = RefinedStereo::new(error, SMatrix::identity() * 1e-8);
        assert!(refined.is_significant);
        let (lens, right_from_left) = refined.corrected(&nominal.right, &nominal.right_from_left);
        let x = Vector3::new(0.3, -0.2, 1.2);
        let seen_by_nominal = camera.right.project(camera.in_right(&x, 1.0).into());
        let expected = seen_by_nominal.map(|p| camera.stereo.move_pixel(&nominal.right, p));
        let found = Lens::new(&lens).project(right_from_left.apply(x.into()));
        let (expected, found) = (expected.expect("inside"), found.expect("inside"));
        for k in 0..2 {
            assert!(
                (expected[k] - found[k]).abs() < 1e-9,
                "{expected:?} {found:?}"
            );
        }
    }

    #[test]
    fn error_within_its_sigmas_is_not_significant() {
        let refined = RefinedStereo::new(StereoVector::repeat(1e-4), SMatrix::identity() * 1e-8);
        assert!(!refined.is_significant);
        // Nor is a decentering, which does not change the geometry.
        let mut error = StereoVector::zeros();
        error[6] = 5e-3;
        assert!(!RefinedStereo::new(error, SMatrix::identity() * 1e-8).is_significant);
    }
}
