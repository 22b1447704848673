//! Where cameras sit on the body, when that is estimated along with everything else.
//!
//! An error of a mount is a small motion of the left optical frame in its own axes, `[shift, rotation]`. A mount that nothing moves stays
//! where calibration put it: what calibration said is a prior.

use nalgebra::{Matrix3, Matrix6, Rotation3, SMatrix, UnitQuaternion, Vector3, Vector6};

use crate::backend::covariance::SIGMA_INFLATION;
use crate::backend::observation::Camera;
use crate::rig::StereoCamera;
use crate::so3;

/// Sigmas of a mount of which calibration told none, m and rad. The place is taken to be known: a walk shows it less well than a
/// ruler (5 to 20 mm off where 5 mm were left to it), and it matters less than a turn.
const DEFAULT_EXTRINSICS_SIGMA: [f64; 2] = [1e-3, 3.5e-3];
/// What is added to what calibration told, m and rad: plates bend and warm, the IMU's own mount has errors too, and what a walk
/// shows of a mount that is right is up to a tenth of a degree off.
const EXTRINSICS_SIGMA_FLOOR: [f64; 2] = [3e-4, 1.2e-3];

/// What is known of a mount beforehand.
#[derive(Clone, Debug)]
pub(crate) struct ExtrinsicsPrior {
    /// Body from left eye.
    at: (Matrix3<f64>, Vector3<f64>),
    pub(crate) information: Matrix6<f64>,
}

impl ExtrinsicsPrior {
    /// Of a camera of the rig, as it sits on the body.
    pub(crate) fn new(of: &StereoCamera, camera: &Camera) -> Self {
        let squares = |sigmas: [f64; 2]| {
            let of = |k: usize| sigmas[k / 3] * sigmas[k / 3];
            Matrix6::from_diagonal(&Vector6::from_fn(|k, _| of(k)))
        };
        let prior = of
            .covariance
            .unwrap_or_else(|| squares(DEFAULT_EXTRINSICS_SIGMA));
        let covariance = prior + squares(EXTRINSICS_SIGMA_FLOOR);
        let inverse = covariance.try_inverse();
        Self {
            at: camera.body_from_left,
            information: inverse
                .unwrap_or_else(|| Matrix6::from_diagonal(&Vector6::from_element(1e12))),
        }
    }

    /// Standard deviations beforehand.
    pub(crate) fn sigmas(&self) -> Vector6<f64> {
        let covariance = self.information.try_inverse();
        covariance.map_or(Vector6::zeros(), |c| c.diagonal().map(f64::sqrt))
    }

    /// The covariance of a mount, of which the adjustment says this: what sights told counts as much less as it does for poses, what was
    /// known beforehand as much as ever.
    pub(crate) fn inflate(&self, covariance: &Matrix6<f64>) -> Matrix6<f64> {
        if covariance.trace() > self.sigmas().norm_squared() {
            // Nothing could be said of it.
            return *covariance;
        }
        let inflate = covariance.try_inverse().and_then(|information| {
            let measured = information - self.information;
            (self.information + measured / (SIGMA_INFLATION * SIGMA_INFLATION)).try_inverse()
        });
        inflate.unwrap_or(covariance * (SIGMA_INFLATION * SIGMA_INFLATION))
    }

    /// By which error a camera is off.
    pub(crate) fn error(&self, camera: &Camera) -> Vector6<f64> {
        let (rotation, translation) = &self.at;
        let (now, now_translation) = &camera.body_from_left;
        let shift = rotation.transpose() * (now_translation - translation);
        // By way of a quaternion: the angle of a matrix is that of its trace, whose cosine rounding may put beyond one.
        let rotation_error = Rotation3::from_matrix_unchecked(rotation.transpose() * now);
        let rotation_error = so3::log(&UnitQuaternion::from_rotation_matrix(&rotation_error));
        Vector6::from_fn(|k, _| {
            if k < 3 {
                shift[k]
            } else {
                rotation_error[k - 3]
            }
        })
    }
}

/// Moves a camera by an error.
pub(crate) fn apply_error(camera: &mut Camera, error: &Vector6<f64>) {
    let (rotation, translation) = &mut camera.body_from_left;
    *translation += *rotation * error.fixed_rows::<3>(0);
    let by = so3::exp(&error.fixed_rows::<3>(3).into_owned());
    *rotation *= by.to_rotation_matrix().into_inner();
}

/// Derivatives of a point `x` in the target's left frame, times its inverse range, by the errors of the mounts of the host's camera
/// and of the target's. If that is one camera, their sum is its own. `now_from_then` turns the host's left frame into the target's.
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
        of(now_from_then * rho, -now_from_then * so3::cross(ray)),
        of(Matrix3::identity() * -rho, so3::cross(x)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_rig;

    #[test]
    fn what_sights_told_counts_less_and_what_was_known_as_ever() {
        let of = test_rig::stereo(0.1);
        let camera = Camera::new(&of, &cad_transforms::RigidTransform::identity());
        let prior = ExtrinsicsPrior::new(&of, &camera);
        let before = prior.information.try_inverse().expect("it is known");
        // Sights that tell as much as was known: half the square, and nine times less of theirs is honest.
        let inflate = prior.inflate(&(before * 0.5));
        assert!((inflate - before * 0.9).amax() < 1e-9 * before.amax());
        // Sights that tell nothing, and an adjustment that says that it knows nothing.
        assert!((prior.inflate(&before) - before).amax() < 1e-9 * before.amax());
        let unknown = Matrix6::identity() * 1e6;
        assert_eq!(prior.inflate(&unknown), unknown);
    }
}
