//! Uncertainty of the course: the direction of motion relative to the body.
//!
//! Images measure it in the axes of a camera, so that an error of the rotation between camera and
//! body turns every step of a path. The window does not estimate this rotation, and no observation
//! in it contradicts one: its uncertainty is added to positions (a consider parameter; Schmidt,
//! Application of state-space methods to navigation problems, 1966).

use cad_transforms::RigidTransform;
use nalgebra::{Matrix3, UnitQuaternion};

use crate::config::CovarianceConfig;

/// The path so far, as its positions depend on the rotation.
#[derive(Clone, Debug, Default)]
pub(super) struct Course {
    /// Derivative of the position in the world by a rotation of all steps in the axes of the body.
    by_rotation: Matrix3<f64>,
}

impl Course {
    /// Adds a step of the body: its rotation in the world after it, and the pose in its frame
    /// before it.
    pub(super) fn advance(&mut self, rotation: &UnitQuaternion<f64>, step: &RigidTransform) {
        let back = step.rotation().inverse();
        let in_body = back * step.translation();
        self.by_rotation -= rotation.to_rotation_matrix() * in_body.cross_matrix();
    }

    /// Covariance of the position in the world, by the sigmas of the solver.
    pub(super) fn covariance(&self, config: &CovarianceConfig) -> Matrix3<f64> {
        let sigma = config.rotation_sigma_floor_rad / config.sigma_inflation;
        self.by_rotation * self.by_rotation.transpose() * (sigma * sigma)
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

    #[test]
    fn error_of_the_rotation_turns_the_path() {
        let config = CovarianceConfig::default();
        for sides in [1, 2, 4] {
            let mut course = Course::default();
            let exact = walk(&Vector3::zeros(), sides, &mut course);
            let mut expected = Matrix3::zeros();
            for axis in 0..3 {
                let mut error = Vector3::zeros();
                error[axis] = 1e-5;
                let moved = walk(&error, sides, &mut Course::default());
                let by = (moved - exact) / 1e-5 * config.rotation_sigma_floor_rad;
                expected += by * by.transpose();
            }
            let found = course.covariance(&config) * config.sigma_inflation.powi(2);
            assert!(
                (found - expected).amax() < 1e-4 * expected.amax(),
                "{sides}"
            );
        }
        // Back at the start a rotation about the vertical has no effect, but a climb remains.
        let mut course = Course::default();
        walk(&Vector3::zeros(), 4, &mut course);
        let covariance = course.covariance(&config);
        assert!(covariance[(0, 0)] < 1e-9 && covariance[(2, 2)] > 1e-6);
    }
}
