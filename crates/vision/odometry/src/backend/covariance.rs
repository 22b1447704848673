//! Covariance inflation: from the covariance of the solver to the reported one.

use cad_transforms::RigidTransform;
use nalgebra::{Const, DMatrix, Dyn, Matrix3, Matrix6, Matrix6x2, OMatrix, SMatrix};

use crate::backend::state::{POSE_DIM, ROTATION, STATE_DIM, State};
use crate::backend::stereo::STEREO_DIM;
use crate::config::CovarianceConfig;

/// Number of rows of the calibrations of one camera: extrinsics and stereo calibration.
pub(crate) const CALIBRATION_DIM: usize = POSE_DIM + STEREO_DIM;

/// Joint covariance of the newest state, the extrinsics of all cameras and their stereo
/// calibrations, and that of the scale errors of the gyroscope.
#[derive(Clone, Debug)]
pub(crate) struct NewestCovariance {
    pub(crate) joint: DMatrix<f64>,
    /// Errors in sigmas, see [`GyroScale`](crate::backend::gyro_scale::GyroScale).
    pub(crate) gyro_scale: Matrix3<f64>,
}

impl NewestCovariance {
    /// Covariance of the state.
    pub(crate) fn state(&self) -> SMatrix<f64, STATE_DIM, STATE_DIM> {
        self.joint
            .fixed_view::<STATE_DIM, STATE_DIM>(0, 0)
            .into_owned()
    }

    /// Covariance of the calibrations: extrinsics of all cameras, followed by their stereo
    /// calibrations.
    pub(crate) fn calibrations(&self) -> DMatrix<f64> {
        let size = self.joint.nrows() - STATE_DIM;
        self.joint
            .view((STATE_DIM, STATE_DIM), (size, size))
            .into_owned()
    }

    /// Covariance of the stereo calibrations.
    pub(crate) fn stereo(&self) -> DMatrix<f64> {
        let cameras = (self.joint.nrows() - STATE_DIM) / CALIBRATION_DIM;
        let (at, size) = (STATE_DIM + cameras * POSE_DIM, cameras * STEREO_DIM);
        self.joint.view((at, at), (size, size)).into_owned()
    }

    /// Adds this variance, rad², to the rotation of the left eye of a camera about each axis.
    pub(crate) fn add_rotation_variance(&mut self, camera: usize, variance: f64) {
        let at = STATE_DIM + camera * POSE_DIM + ROTATION;
        for k in at..at + 3 {
            self.joint[(k, k)] += variance;
        }
    }

    /// Covariance of the pose of a later state, which observes landmarks of this one and earlier
    /// ones. `by_calibrations` is the derivative of the motion since then by the errors of the
    /// calibrations.
    pub(crate) fn at_newest(
        &self,
        from: &State,
        to: &State,
        by_calibrations: Option<&OMatrix<f64, Const<POSE_DIM>, Dyn>>,
    ) -> Matrix6<f64> {
        let rigid = transport_jacobian(from, to);
        let start = rigid * self.pose() * rigid.transpose();
        let Some(by) = by_calibrations else {
            return start;
        };
        let with_calibrations = self.joint.view((0, STATE_DIM), (POSE_DIM, by.ncols()));
        let cross = rigid * with_calibrations * by.transpose();
        start + cross + cross.transpose() + by * self.calibrations() * by.transpose()
    }

    /// Covariance of the pose.
    pub(crate) fn pose(&self) -> Matrix6<f64> {
        self.joint
            .fixed_view::<POSE_DIM, POSE_DIM>(0, 0)
            .into_owned()
    }
}

/// Adds errors that the covariance of the solver does not model: observations of one feature are
/// correlated over frames, so that sigmas are multiplied by `sigma_inflation`, and lenses of left
/// eyes have constant errors. Values from simulated walks; see docs/decisions/0010-odometry.md.
fn inflate(config: &CovarianceConfig, covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let mut out = covariance * (config.sigma_inflation * config.sigma_inflation);
    for k in 0..3 {
        out[(k, k)] += config.position_sigma_floor_m.powi(2);
        out[(k + 3, k + 3)] += config.rotation_sigma_floor_rad.powi(2);
    }
    out
}

/// Covariance of a pose due to a tilt of the whole world about its origin, as a small motion in the
/// axes of the rig. Without an IMU the vertical of the world is that of the first rig pose, which
/// may not be upright.
pub(crate) fn tilt_uncertainty(
    config: &CovarianceConfig,
    world_from_rig: &RigidTransform,
) -> Matrix6<f64> {
    let back = world_from_rig.rotation().inverse().to_rotation_matrix();
    let mut jacobian = Matrix6x2::zeros();
    jacobian.fixed_view_mut::<3, 2>(0, 0).copy_from(
        &(-back.matrix() * world_from_rig.translation().cross_matrix()).fixed_view::<3, 2>(0, 0),
    );
    jacobian
        .fixed_view_mut::<3, 2>(3, 0)
        .copy_from(&back.matrix().fixed_view::<3, 2>(0, 0));
    jacobian
        * jacobian.transpose()
        * (config.initial_tilt_sigma_rad * config.initial_tilt_sigma_rad)
}

/// Inflates the covariance of a pose and converts it from errors of the body (position in the
/// world, rotation in the body) to a small motion of the rig in its own axes.
pub(crate) fn in_rig_frame(
    config: &CovarianceConfig,
    state: &State,
    body_from_rig: &RigidTransform,
    covariance: &Matrix6<f64>,
) -> Matrix6<f64> {
    to_rig_frame(state, body_from_rig, &inflate(config, covariance))
}

/// The same for the pose relative to nearby keyframes, whose error is that of few observations: it
/// has neither the floors nor an error of scale.
pub(crate) fn relative_in_rig_frame(
    config: &CovarianceConfig,
    state: &State,
    body_from_rig: &RigidTransform,
    covariance: &Matrix6<f64>,
) -> Matrix6<f64> {
    let inflated = covariance * (config.sigma_inflation * config.sigma_inflation);
    to_rig_frame(state, body_from_rig, &inflated)
}

fn to_rig_frame(
    state: &State,
    body_from_rig: &RigidTransform,
    covariance: &Matrix6<f64>,
) -> Matrix6<f64> {
    let mut to_own = Matrix6::identity();
    to_own
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&state.rotation.inverse().to_rotation_matrix().into_inner());
    let jacobian = adjoint(&body_from_rig.inverse()) * to_own;
    let own = jacobian * covariance * jacobian.transpose();
    (own + own.transpose()) * 0.5
}

/// Adjoint of a transform `b_from_a`: takes a small motion in the axes of `a` (translation,
/// rotation) to the same motion in those of `b`.
pub(crate) fn adjoint(b_from_a: &RigidTransform) -> Matrix6<f64> {
    let rotation = b_from_a.rotation().to_rotation_matrix().into_inner();
    let mut adjoint = Matrix6::zeros();
    adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    let lever_arm = b_from_a.translation().cross_matrix();
    adjoint
        .fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&(lever_arm * rotation));
    adjoint
}

/// Covariance of the pose of one state, transported rigidly to another state.
pub(crate) fn transport(from: &State, to: &State, covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let jacobian = transport_jacobian(from, to);
    jacobian * covariance * jacobian.transpose()
}

/// Jacobian of the rigid transport.
fn transport_jacobian(from: &State, to: &State) -> Matrix6<f64> {
    let mut jacobian = Matrix6::identity();
    let rotation = from.rotation.to_rotation_matrix().into_inner();
    let lever_arm = from.rotation.inverse() * (to.position - from.position);
    jacobian
        .fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&(-rotation * lever_arm.cross_matrix()));
    let relative = to.rotation.inverse() * from.rotation;
    jacobian
        .fixed_view_mut::<3, 3>(3, 3)
        .copy_from(&relative.to_rotation_matrix().into_inner());
    jacobian
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn world_tilt_rotates_poses_and_moves_distant_ones_vertically() {
        // Ten meters ahead, heading to the left.
        let rotation = [
            std::f64::consts::FRAC_1_SQRT_2,
            0.0,
            0.0,
            std::f64::consts::FRAC_1_SQRT_2,
        ];
        let pose = RigidTransform::from_wxyz(rotation, [10.0, 0.0, 0.0]).unwrap();
        let config = CovarianceConfig::default();
        let covariance = tilt_uncertainty(&config, &pose);
        let sigma = |k: usize| covariance[(k, k)].sqrt();
        let expected = [
            0.0,
            0.0,
            10.0 * config.initial_tilt_sigma_rad,
            config.initial_tilt_sigma_rad,
            config.initial_tilt_sigma_rad,
            0.0,
        ];
        for (k, expected) in expected.into_iter().enumerate() {
            assert!((sigma(k) - expected).abs() < 1e-9, "{k}: {}", sigma(k));
        }
        // A world tilted forward rolls the rig and lowers it; both have the same cause and are
        // correlated.
        let tilt =
            RigidTransform::from_wxyz([(0.05_f64).cos(), 0.0, (0.05_f64).sin(), 0.0], [0.0; 3]);
        let relative = pose.inverse() * tilt.unwrap() * pose;
        let lowered = relative.translation().z;
        let share = covariance[(2, 3)] / covariance[(3, 3)];
        let rolled = cad_transforms::so3::log(relative.rotation()).x;
        assert!(
            (lowered / rolled - share).abs() < 0.05 * share.abs(),
            "{lowered} {rolled} {share}"
        );
    }
}
