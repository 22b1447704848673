//! Camera extrinsics as estimated parameters, with their priors.
//!
//! The error of extrinsics is a small motion of the left optical frame in its own axes,
//! `[translation, rotation]`. The calibration is a prior: extrinsics that the data do not determine
//! keep their nominal value, or that after a detected shift.

use nalgebra::{DMatrix, Matrix3, Matrix6, Rotation3, SMatrix, UnitQuaternion, Vector3, Vector6};

use crate::backend::observation::Camera;
use crate::backend::state::POSE_DIM;
use crate::config::ExtrinsicsConfig;
use crate::rig::StereoCamera;
use cad_transforms::so3;

/// Extrinsics of a camera: body from left optical frame.
pub(crate) type Extrinsics = (Matrix3<f64>, Vector3<f64>);

/// Prior of the extrinsics of one camera.
#[derive(Clone, Debug)]
pub(crate) struct ExtrinsicsPrior {
    /// Nominal extrinsics.
    at: Extrinsics,
    pub(crate) information: Matrix6<f64>,
}

impl ExtrinsicsConfig {
    /// Prior covariance of a small motion of a left optical frame in its own axes, m and rad, for
    /// the stated covariance of its calibration, if any.
    ///
    /// ```
    /// use odometry::config::BackendConfig;
    ///
    /// let config = BackendConfig::default().extrinsics;
    /// let variance = config.prior_covariance(None)[(0, 0)];
    /// assert_eq!(variance, config.default_sigma[0].powi(2) + config.sigma_floor[0].powi(2));
    /// ```
    pub fn prior_covariance(&self, stated: Option<&Matrix6<f64>>) -> Matrix6<f64> {
        let squares = |sigmas: [f64; 2]| {
            let of = |k: usize| sigmas[k / 3] * sigmas[k / 3];
            Matrix6::from_diagonal(&Vector6::from_fn(|k, _| of(k)))
        };
        let own = stated.map_or_else(|| squares(self.default_sigma), |stated| *stated);
        own + squares(self.sigma_floor)
    }
}

impl ExtrinsicsPrior {
    /// Prior of a camera of the rig.
    pub(crate) fn new(config: &ExtrinsicsConfig, of: &StereoCamera, camera: &Camera) -> Self {
        let information = |stated: Option<&Matrix6<f64>>| {
            let factor = config.prior_covariance(stated).cholesky();
            factor.map(|factor| factor.inverse())
        };
        // An invalid stated covariance is ignored.
        let found = information(of.covariance.as_ref()).or_else(|| information(None));
        Self {
            at: camera.body_from_left,
            // Configured sigmas of zero: exact.
            information: found
                .unwrap_or_else(|| Matrix6::from_diagonal(&Vector6::from_element(1e12))),
        }
    }

    /// Priors of all cameras of the rig.
    pub(crate) fn of_rig(
        config: &ExtrinsicsConfig,
        of: &[StereoCamera],
        cameras: &[Camera],
    ) -> Vec<Self> {
        let each = of.iter().zip(cameras);
        each.map(|(of, camera)| Self::new(config, of, camera))
            .collect()
    }

    /// Standard deviations of the prior.
    pub(crate) fn sigmas(&self) -> Vector6<f64> {
        let covariance = self.information.try_inverse();
        covariance.map_or(Vector6::zeros(), |c| c.diagonal().map(f64::sqrt))
    }

    /// Inflates the covariance of extrinsics from bundle adjustment: the information of the
    /// observations is reduced as for poses, that of the prior is unchanged.
    pub(crate) fn inflate(&self, sigma_inflation: f64, covariance: &Matrix6<f64>) -> Matrix6<f64> {
        if covariance.trace() > self.sigmas().norm_squared() {
            // The solver could not determine it.
            return *covariance;
        }
        let inflate = covariance.try_inverse().and_then(|information| {
            let measured = information - self.information;
            (self.information + measured / (sigma_inflation * sigma_inflation)).try_inverse()
        });
        inflate.unwrap_or(covariance * (sigma_inflation * sigma_inflation))
    }

    /// Error of a camera's extrinsics relative to the prior.
    pub(crate) fn error(&self, camera: &Camera) -> Vector6<f64> {
        error(&self.at, &camera.body_from_left)
    }
}

/// Joint information of the calibrations of all cameras: that of their extrinsics, which are
/// independent, times `factor`, followed by that of their stereo calibrations.
pub(crate) fn joint_information(
    priors: &[ExtrinsicsPrior],
    factor: f64,
    stereo: &DMatrix<f64>,
) -> DMatrix<f64> {
    let extrinsics = priors.len() * POSE_DIM;
    let size = extrinsics + stereo.nrows();
    let mut information = DMatrix::zeros(size, size);
    for (k, prior) in priors.iter().enumerate() {
        let at = k * POSE_DIM;
        let mut view = information.fixed_view_mut::<POSE_DIM, POSE_DIM>(at, at);
        view += prior.information * factor;
    }
    let mut view = information.view_mut((extrinsics, extrinsics), stereo.shape());
    view += stereo;
    information
}

/// Error of extrinsics relative to other ones.
pub(crate) fn error(at: &Extrinsics, now: &Extrinsics) -> Vector6<f64> {
    let shift = at.0.transpose() * (now.1 - at.1);
    // Through a quaternion: the angle from the trace of a matrix would need a cosine that rounding
    // can put beyond 1.
    let rotation = Rotation3::from_matrix_unchecked(at.0.transpose() * now.0);
    let rotation = so3::log(&UnitQuaternion::from_rotation_matrix(&rotation));
    Vector6::from_fn(|k, _| if k < 3 { shift[k] } else { rotation[k - 3] })
}

/// Applies an error to extrinsics.
pub(crate) fn apply_error(extrinsics: &mut Extrinsics, error: &Vector6<f64>) {
    let (rotation, translation) = extrinsics;
    *translation += *rotation * error.fixed_rows::<3>(0);
    let by = so3::exp(error.fixed_rows::<3>(3).into_owned());
    *rotation *= by.to_rotation_matrix().into_inner();
}

/// Jacobians of a point `x` in the left frame of the target, scaled by its inverse range, with
/// respect to the extrinsics errors of the host camera and of the target camera. If both are the
/// same camera, its Jacobian is their sum. `now_from_then` is the rotation from the left frame of
/// the host to that of the target.
pub(crate) fn jacobians_by_extrinsics(
    ray: &Vector3<f64>,
    rho: f64,
    now_from_then: &Matrix3<f64>,
    x: &Vector3<f64>,
) -> [SMatrix<f64, 3, 6>; 2] {
    let of = |shift: Matrix3<f64>, rotation: Matrix3<f64>| {
        let mut by = SMatrix::<f64, 3, 6>::zeros();
        by.fixed_columns_mut::<3>(0).copy_from(&shift);
        by.fixed_columns_mut::<3>(3).copy_from(&rotation);
        by
    };
    [
        of(now_from_then * rho, -now_from_then * ray.cross_matrix()),
        of(Matrix3::identity() * -rho, x.cross_matrix()),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_rig;

    #[test]
    fn invalid_covariance_is_not_used() {
        let prior = |covariance: Option<Matrix6<f64>>| {
            let of = StereoCamera {
                covariance,
                ..test_rig::stereo(0.1)
            };
            let camera = Camera::new(&of, &cad_transforms::RigidTransform::identity());
            ExtrinsicsPrior::new(&Default::default(), &of, &camera).information
        };
        for invalid in [f64::NAN, -1e-3] {
            assert_eq!(prior(Some(Matrix6::identity() * invalid)), prior(None));
        }
        assert!(prior(Some(Matrix6::zeros())).trace() > prior(None).trace());
    }

    #[test]
    fn inflation_reduces_observation_information_and_preserves_the_prior() {
        let of = test_rig::stereo(0.1);
        let camera = Camera::new(&of, &cad_transforms::RigidTransform::identity());
        let prior = ExtrinsicsPrior::new(&Default::default(), &of, &camera);
        let before = prior
            .information
            .try_inverse()
            .expect("the prior information is invertible");
        // Observations with the same information as the prior: half the covariance, and theirs is
        // reduced by a factor of nine.
        let inflate = prior.inflate(3.0, &(before * 0.5));
        assert!((inflate - before * 0.9).amax() < 1e-9 * before.amax());
        // Observations without information, and a solver that reports no information.
        assert!((prior.inflate(3.0, &before) - before).amax() < 1e-9 * before.amax());
        let unknown = Matrix6::identity() * 1e6;
        assert_eq!(prior.inflate(3.0, &unknown), unknown);
    }
}
