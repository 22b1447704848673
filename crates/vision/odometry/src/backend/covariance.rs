//! How sure a pose is: from what a solution says of itself to what is told.

use cad_transforms::RigidTransform;
use nalgebra::{Matrix6, Matrix6x2};

use crate::backend::state::State;
use crate::so3::cross;

/// How many times as large as a solution says the sigmas of what sights tell are; see [`inflate`].
pub(crate) const SIGMA_INFLATION: f64 = 3.0;
/// See [`inflate`].
const POSITION_SIGMA_FLOOR_M: f64 = 0.003;
const SCALE_SIGMA: f64 = 1.5e-3;
const DRIFT_PER_METRE: f64 = 8e-4;
const ROTATION_SIGMA_FLOOR_RAD: f64 = 2.5e-3;
/// How far from upright a rig may have begun whose world no IMU levelled, rad.
const INITIAL_TILT_SIGMA_RAD: f64 = 0.35;

/// What a solution's covariance does not know: sights of one corner are wrong alike from frame to frame, and calibrations are a
/// little wrong for good. Sigmas are so many times as large, and what a scale error makes of the distance from the start, and what
/// is wrong alike all along makes of the way that nothing closed, m, is added. Measured on simulated walks; see
/// docs/decisions/0010-odometry.md.
fn inflate(state: &State, path_length_m: f64, covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let mut out = covariance * (SIGMA_INFLATION * SIGMA_INFLATION);
    let position_sigma_m = POSITION_SIGMA_FLOOR_M
        + SCALE_SIGMA * state.position.norm()
        + DRIFT_PER_METRE * path_length_m;
    for k in 0..3 {
        out[(k, k)] += position_sigma_m * position_sigma_m;
        out[(k + 3, k + 3)] += ROTATION_SIGMA_FLOOR_RAD * ROTATION_SIGMA_FLOOR_RAD;
    }
    out
}

/// What a tilt of the whole world about its origin makes of a pose, as a small motion in the rig's own axes. The up of a world
/// that no IMU levelled is that of the first rig, which nobody knows to be upright.
pub(crate) fn tilt_uncertainty(world_from_rig: &RigidTransform) -> Matrix6<f64> {
    let back = world_from_rig.rotation().inverse().to_rotation_matrix();
    let mut jacobian = Matrix6x2::zeros();
    jacobian.fixed_view_mut::<3, 2>(0, 0).copy_from(
        &(-back.matrix() * cross(world_from_rig.translation())).fixed_view::<3, 2>(0, 0),
    );
    jacobian
        .fixed_view_mut::<3, 2>(3, 0)
        .copy_from(&back.matrix().fixed_view::<3, 2>(0, 0));
    jacobian * jacobian.transpose() * (INITIAL_TILT_SIGMA_RAD * INITIAL_TILT_SIGMA_RAD)
}

/// From errors of the body's position in the world and its turn to those of a small motion of the rig in its own axes.
pub(crate) fn in_rig_frame(
    state: &State,
    body_from_rig: &RigidTransform,
    path_length_m: f64,
    covariance: &Matrix6<f64>,
) -> Matrix6<f64> {
    let mut to_own = Matrix6::identity();
    to_own
        .fixed_view_mut::<3, 3>(0, 0)
        .copy_from(&state.rotation.inverse().to_rotation_matrix().into_inner());
    let rig_from_body = body_from_rig.inverse();
    let rotation = rig_from_body.rotation().to_rotation_matrix().into_inner();
    let mut adjoint = Matrix6::zeros();
    adjoint.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    adjoint.fixed_view_mut::<3, 3>(3, 3).copy_from(&rotation);
    let lever_arm = cross(rig_from_body.translation());
    adjoint
        .fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&(lever_arm * rotation));
    let jacobian = adjoint * to_own;
    let own = jacobian * inflate(state, path_length_m, covariance) * jacobian.transpose();
    (own + own.transpose()) * 0.5
}

/// The covariance of one state's pose, carried rigidly to another one.
pub(crate) fn transport(from: &State, to: &State, covariance: &Matrix6<f64>) -> Matrix6<f64> {
    let mut jacobian = Matrix6::identity();
    let rotation = from.rotation.to_rotation_matrix().into_inner();
    let lever_arm = from.rotation.inverse() * (to.position - from.position);
    jacobian
        .fixed_view_mut::<3, 3>(0, 3)
        .copy_from(&(-rotation * cross(&lever_arm)));
    let relative = to.rotation.inverse() * from.rotation;
    jacobian
        .fixed_view_mut::<3, 3>(3, 3)
        .copy_from(&relative.to_rotation_matrix().into_inner());
    jacobian * covariance * jacobian.transpose()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tilt_turns_poses_and_lifts_what_is_far() {
        // Ten metres ahead, looking to the left.
        let rotation = [
            std::f64::consts::FRAC_1_SQRT_2,
            0.0,
            0.0,
            std::f64::consts::FRAC_1_SQRT_2,
        ];
        let pose = RigidTransform::from_wxyz(rotation, [10.0, 0.0, 0.0]).unwrap();
        let covariance = tilt_uncertainty(&pose);
        let sigma = |k: usize| covariance[(k, k)].sqrt();
        let expected = [
            0.0,
            0.0,
            10.0 * INITIAL_TILT_SIGMA_RAD,
            INITIAL_TILT_SIGMA_RAD,
            INITIAL_TILT_SIGMA_RAD,
            0.0,
        ];
        for (k, expected) in expected.into_iter().enumerate() {
            assert!((sigma(k) - expected).abs() < 1e-9, "{k}: {}", sigma(k));
        }
        // Nose down by a world that leans forward: the rig's roll, and it is lower. Both are the same error.
        let tilt =
            RigidTransform::from_wxyz([(0.05_f64).cos(), 0.0, (0.05_f64).sin(), 0.0], [0.0; 3]);
        let relative = pose.inverse() * tilt.unwrap() * pose;
        let lowered = relative.translation().z;
        let share = covariance[(2, 3)] / covariance[(3, 3)];
        let rolled = relative.rotation().scaled_axis().x;
        assert!(
            (lowered / rolled - share).abs() < 0.05 * share.abs(),
            "{lowered} {rolled} {share}"
        );
    }
}
