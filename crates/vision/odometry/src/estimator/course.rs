//! Uncertainty of the course: the direction of motion relative to the body.
//!
//! Images measure it in the axes of a camera, so that an error of the rotation between camera and
//! body turns every step of a path. The window does not estimate this rotation, and no observation
//! in it contradicts one: its uncertainty, the prior that bundle adjustment estimates it with, is
//! added to positions (a consider parameter; Schmidt, Application of state-space methods to
//! navigation problems, 1966).

use cad_transforms::RigidTransform;
use nalgebra::{Matrix3, Matrix6, UnitQuaternion};

use crate::backend::extrinsics::ExtrinsicsPrior;
use crate::backend::observation::Camera;
use crate::config::BackendConfig;
use crate::rig::StereoCamera;

/// The path so far, as its positions depend on the rotation.
#[derive(Clone, Debug)]
pub(super) struct Course {
    /// Sigma of the rotation about any axis, by the sigmas of the solver.
    sigma: f64,
    /// Derivative of the position in the world by a rotation of all steps in the axes of the body.
    by_rotation: Matrix3<f64>,
}

impl Course {
    /// A path that begins. Errors of the cameras are independent, and their mean counts.
    pub(super) fn new(config: &BackendConfig, of: &[StereoCamera], cameras: &[Camera]) -> Self {
        let variances = of.iter().zip(cameras).map(|(of, camera)| {
            let sigmas = ExtrinsicsPrior::new(&config.extrinsics, of, camera).sigmas();
            sigmas.fixed_rows::<3>(3).norm_squared() / 3.0
        });
        let of_mean = variances.sum::<f64>() / (of.len().max(1) as f64).powi(2);
        Self {
            sigma: of_mean.sqrt() / config.covariance.sigma_inflation,
            by_rotation: Matrix3::zeros(),
        }
    }

    /// Adds a step of the body: its rotation in the world after it, and the pose in its frame
    /// before it.
    pub(super) fn advance(&mut self, rotation: &UnitQuaternion<f64>, step: &RigidTransform) {
        let back = step.rotation().inverse();
        let in_body = back * step.translation();
        self.by_rotation -= rotation.to_rotation_matrix() * in_body.cross_matrix();
    }

    /// Covariance of the pose, position in the world, by the sigmas of the solver.
    pub(super) fn covariance(&self) -> Matrix6<f64> {
        let mut covariance = Matrix6::zeros();
        let by = self.by_rotation * self.sigma;
        (covariance.fixed_view_mut::<3, 3>(0, 0)).copy_from(&(by * by.transpose()));
        covariance
    }
}

#[cfg(test)]
mod tests {
    use cad_transforms::so3;
    use nalgebra::Vector3;

    use super::*;

    /// Walks a square with sides of 4 m, forward along x of the body, and a wrong rotation between
    /// camera and body; returns the position.
    fn walk(error: &Vector3<f64>, sides: usize, course: &mut Course) -> Vector3<f64> {
        let (mut rotation, mut position) = (UnitQuaternion::identity(), Vector3::zeros());
        for side in 0..sides {
            if side > 0 {
                rotation *= so3::exp(Vector3::z() * std::f64::consts::FRAC_PI_2);
            }
            for _ in 0..40 {
                let step = [0.1, 0.0, 0.0];
                position += rotation * (so3::exp(*error) * Vector3::from(step));
                let step = RigidTransform::from_translation_m(step).expect("a finite step");
                course.advance(&rotation, &step);
            }
        }
        position
    }

    /// A path of a rig with one camera, and its rotation sigma.
    fn course(covariance: Option<Matrix6<f64>>) -> (Course, f64) {
        let config = BackendConfig::default();
        let of = StereoCamera {
            covariance,
            ..crate::test_rig::stereo(0.1)
        };
        let camera = Camera::new(&of, &RigidTransform::identity());
        let course = Course::new(&config, &[of], &[camera]);
        let sigma = course.sigma * config.covariance.sigma_inflation;
        (course, sigma)
    }

    #[test]
    fn error_of_the_rotation_turns_the_path() {
        for sides in [1, 2, 4] {
            let (mut path, _) = course(None);
            let exact = walk(&Vector3::zeros(), sides, &mut path);
            let mut expected = Matrix3::zeros();
            for axis in 0..3 {
                let mut error = Vector3::zeros();
                error[axis] = 1e-5;
                let by = (walk(&error, sides, &mut course(None).0) - exact) / 1e-5 * path.sigma;
                expected += by * by.transpose();
            }
            let found = path.covariance().fixed_view::<3, 3>(0, 0).into_owned();
            assert!(
                (found - expected).amax() < 1e-4 * expected.amax(),
                "{sides}"
            );
        }
        // Back at the start a rotation about the vertical has no effect, but a climb remains.
        let (mut path, _) = course(None);
        walk(&Vector3::zeros(), 4, &mut path);
        let covariance = path.covariance();
        assert!(covariance[(0, 0)] < 1e-9 && covariance[(2, 2)] > 1e-6);
    }

    #[test]
    fn sigma_is_that_of_the_calibration() {
        let config = BackendConfig::default().extrinsics;
        let (stated, floor) = (5e-4_f64, config.sigma_floor[1]);
        let (_, sigma) = course(Some(Matrix6::identity() * (stated * stated)));
        assert!((sigma - stated.hypot(floor)).abs() < 1e-9);
        let (_, sigma) = course(None);
        assert!((sigma - config.default_sigma[1].hypot(floor)).abs() < 1e-9);
    }
}
