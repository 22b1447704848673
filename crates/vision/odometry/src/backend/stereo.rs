//! Stereo calibration of a camera as estimated parameters, with their prior.
//!
//! The error of the right eye against the left one has seven components: `[rotation of the right
//! eye about its x, y and z axes, rad; baseline, relative; focal length, relative; principal point
//! along x, in focal lengths; decentering]`. A vertical offset of the principal point acts as a
//! rotation about x, and a direction of the baseline as a rotation of the eye, to a hundredth of a
//! pixel for points beyond a metre.
//!
//! The decentering is the coefficient `p2` of the right lens minus that of the left one (Brown
//! 1966), where it acts across epipolar lines. There it equals a rotation about y, so that rows,
//! which lenses distort by more than a calibration states, do not determine that rotation.
//!
//! A walk determines the error: stereo measures an inverse range, parallax over time its ratio to
//! those of other points. A rotation about y adds a constant to all inverse ranges, which near and
//! distant points contradict differently; only the baseline acts on all alike, and needs an IMU.

use nalgebra::{DMatrix, Matrix3, Matrix6, SMatrix, SVector, Vector3};

use crate::backend::observation::{BearingMeasurement, Camera};
use crate::config::{BackendConfig, StereoCalibrationConfig};
use crate::rig::StereoCamera;
use cad_transforms::so3;
use camera_models::CameraModel;

/// Dimension of the error.
pub(crate) const STEREO_DIM: usize = 7;
/// Its components after the rotation.
const BASELINE: usize = 3;
const FOCAL: usize = 4;
const PRINCIPAL_POINT: usize = 5;
const DECENTERING: usize = 6;

/// Maximum tangent of the angle from the axis at which the decentering is evaluated.
const MAX_TANGENT: f64 = 2.5;

/// Error of a stereo calibration.
pub(crate) type StereoVector = SVector<f64, STEREO_DIM>;
pub(crate) type StereoMatrix = SMatrix<f64, STEREO_DIM, STEREO_DIM>;

/// Stereo geometry: nominal extrinsics of the right eye, and their error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct StereoGeometry {
    /// Nominal rotation and translation: right optical frame from left optical frame.
    nominal: (Matrix3<f64>, Vector3<f64>),
    /// Estimated error, see the module.
    pub(crate) error: StereoVector,
    /// Its covariance as reported. Only matching in stereo uses it.
    pub(crate) covariance: StereoMatrix,
}

impl StereoGeometry {
    pub(crate) fn new(nominal: (Matrix3<f64>, Vector3<f64>)) -> Self {
        Self {
            nominal,
            error: StereoVector::zeros(),
            covariance: StereoMatrix::zeros(),
        }
    }

    /// Map from a point in the left frame, scaled by its inverse range, and that inverse range to
    /// the point in the frame of the right eye: `rotation x + origin rho`. Errors of the lens are
    /// not in it, see [`Self::decenter`] and [`Self::compensate_lens_error`].
    pub(crate) fn right_from_left(&self) -> (Matrix3<f64>, Vector3<f64>) {
        let error = so3::exp(self.error.fixed_rows::<3>(0).into_owned());
        let error = error.to_rotation_matrix().into_inner();
        let (rotation, translation) = &self.nominal;
        (
            error * rotation,
            error * translation * self.error[BASELINE].exp(),
        )
    }

    /// A bearing of the right eye for points in the frame of its true lens: the nominal lens sees a
    /// point near the ray moved by the errors of focal length and principal point. They act on the
    /// image, after the distortion.
    pub(crate) fn compensate_lens_error(&self, bearing: &BearingMeasurement) -> BearingMeasurement {
        let [focal, principal_point] = self.lens_motion();
        let motion = bearing.by_focal * focal + bearing.by_principal_point * principal_point;
        BearingMeasurement {
            basis: bearing.basis + bearing.basis * motion * bearing.ray.transpose(),
            ..*bearing
        }
    }

    /// Factors of [`BearingMeasurement::by_focal`] and `by_principal_point`, which are for a
    /// measured pixel and not for the one without an error.
    fn lens_motion(&self) -> [f64; 2] {
        let inverse = (-self.error[FOCAL]).exp();
        [1.0 - inverse, inverse * self.error[PRINCIPAL_POINT]]
    }

    /// Pixel of the true right lens where the nominal one would see this pixel.
    pub(crate) fn move_pixel(&self, lens: &CameraModel, pixel: [f64; 2]) -> [f64; 2] {
        let focal = self.error[FOCAL].exp();
        [
            lens.cx + focal * (pixel[0] - lens.cx) + self.error[PRINCIPAL_POINT] * lens.fx,
            lens.cy + focal * (pixel[1] - lens.cy),
        ]
    }

    /// Applies the decentering to a point in the frame of the right eye.
    pub(crate) fn decenter(&self, point: Vector3<f64>) -> Vector3<f64> {
        let across = self.error[DECENTERING] * decentering_per_unit(&point);
        Vector3::new(point.x, point.y + across, point.z)
    }

    /// Jacobian by the error of a point as the nominal lens sees it. The point is in the frame of
    /// the right eye, scaled by its inverse range `rho`, and near the ray of `bearing`; `origin` is
    /// that of [`Self::right_from_left`].
    pub(crate) fn jacobian(
        &self,
        bearing: &BearingMeasurement,
        point: &Vector3<f64>,
        origin: &Vector3<f64>,
        rho: f64,
    ) -> SMatrix<f64, 3, STEREO_DIM> {
        let along = bearing.ray.dot(point) * (-self.error[FOCAL]).exp();
        let mut by = SMatrix::<f64, 3, STEREO_DIM>::zeros();
        by.fixed_columns_mut::<3>(0)
            .copy_from(&-point.cross_matrix());
        by.set_column(BASELINE, &(origin * rho));
        by.set_column(FOCAL, &(bearing.by_focal * along));
        by.set_column(PRINCIPAL_POINT, &(bearing.by_principal_point * along));
        let decentering = decentering_per_unit(point);
        by.set_column(DECENTERING, &Vector3::new(0.0, decentering, 0.0));
        by
    }
}

/// Motion of a point along y per unit of decentering: `2 x y` at a depth of 1.
fn decentering_per_unit(point: &Vector3<f64>) -> f64 {
    let depth = point.z.max(point.xy().norm() / MAX_TANGENT);
    if depth > 0.0 {
        2.0 * point.x * point.y / depth
    } else {
        0.0
    }
}

/// Joint information of the errors of all cameras before any image.
///
/// Sigmas are divided by the factor that reported sigmas are multiplied with: the solver takes
/// observations of one feature as independent, and the weight of the prior against them has to be
/// that of reported covariances. Cameras without a stated covariance are correlated.
///
/// # Panics
/// For a correlation of 1, with which the errors of two cameras could not differ.
pub(crate) fn prior_information(config: &BackendConfig, cameras: &[StereoCamera]) -> DMatrix<f64> {
    let stereo = &config.stereo;
    let size = cameras.len() * STEREO_DIM;
    let mut covariance = DMatrix::zeros(size, size);
    let inflation = config.covariance.sigma_inflation;
    for (k, camera) in cameras.iter().enumerate() {
        let is_stated = stated(camera).is_some();
        for (component, sigma) in stereo.prior_sigmas(camera).into_iter().enumerate() {
            let own = k * STEREO_DIM + component;
            covariance[(own, own)] = (sigma / inflation).powi(2);
            if is_stated {
                continue;
            }
            for (j, other) in cameras.iter().enumerate() {
                if j != k && stated(other).is_none() {
                    let at = (own, j * STEREO_DIM + component);
                    covariance[at] = stereo.correlation * covariance[(own, own)];
                }
            }
        }
    }
    covariance
        .try_inverse()
        .expect("sigmas are positive and the correlation is below 1")
}

/// Gives cameras their parts of a joint covariance of the errors, as the solver has it.
pub(crate) fn set_covariances(cameras: &mut [Camera], sigma_inflation: f64, joint: &DMatrix<f64>) {
    for (k, camera) in cameras.iter_mut().enumerate() {
        let at = k * STEREO_DIM;
        let own = joint.fixed_view::<STEREO_DIM, STEREO_DIM>(at, at);
        camera.stereo.covariance = own * (sigma_inflation * sigma_inflation);
    }
}

impl StereoCalibrationConfig {
    /// Prior sigmas of the error of a camera's stereo calibration, components as in
    /// [`RefinedStereo::error`](crate::mapping::RefinedStereo::error): of its
    /// [covariance](StereoCamera::right_from_left_covariance), if it states one.
    ///
    /// ```
    /// # use cad_transforms::RigidTransform;
    /// # use camera_models::{CameraModel, Distortion};
    /// use odometry::config::BackendConfig;
    /// # use odometry::rig::StereoCamera;
    /// # let lens = CameraModel::new((160, 120), [100.0, 100.0, 79.5, 59.5], Distortion::None);
    /// # let camera = StereoCamera {
    /// #     name: "front".to_owned(),
    /// #     left: lens,
    /// #     right: lens,
    /// #     rig_from_left: RigidTransform::identity(),
    /// #     covariance: None,
    /// #     right_from_left: RigidTransform::from_translation_m([-0.08, 0.0, 0.0])?,
    /// #     right_from_left_covariance: None,
    /// #     line_s: 0.0,
    /// # };
    /// let config = BackendConfig::default().stereo;
    /// // Without a stated covariance.
    /// assert_eq!(config.prior_sigmas(&camera)[3], config.baseline_sigma);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn prior_sigmas(&self, camera: &StereoCamera) -> [f64; STEREO_DIM] {
        let Some(covariance) = stated(camera) else {
            let rotation = self.rotation_sigma_rad;
            return [
                rotation,
                rotation,
                rotation,
                self.baseline_sigma,
                self.focal_sigma,
                self.principal_point_sigma,
                self.decentering_sigma,
            ];
        };
        let with_floor = |variance: f64, floor: f64| (variance + floor * floor).sqrt();
        let rotation = |axis: usize| {
            with_floor(
                covariance[(3 + axis, 3 + axis)],
                self.stated_rotation_floor_rad,
            )
        };
        // In the axes of the left eye, as the covariance is.
        let baseline = *camera.right_from_left.inverse().translation();
        let along = baseline.normalize();
        let variance = (along.transpose() * covariance.fixed_view::<3, 3>(0, 0) * along)[0];
        let relative = with_floor(variance / baseline.norm_squared(), self.stated_lens_floor);
        [
            rotation(0),
            rotation(1),
            rotation(2),
            relative,
            self.stated_lens_floor,
            self.stated_lens_floor,
            self.decentering_sigma,
        ]
    }
}

/// Stated covariance of the right eye, unless it is invalid: not finite, or with a negative
/// variance.
fn stated(camera: &StereoCamera) -> Option<&Matrix6<f64>> {
    let covariance = camera.right_from_left_covariance.as_ref()?;
    let is_finite = covariance.iter().all(|v| v.is_finite());
    // Rounding makes a variance of zero negative.
    let is_positive = || covariance.symmetric_eigenvalues().min() >= -1e-9 * covariance.trace();
    (is_finite && covariance.trace() >= 0.0 && is_positive()).then_some(covariance)
}

/// Applies a step to the error of a camera.
pub(crate) fn apply_error(camera: &mut Camera, step: &StereoVector) {
    camera.stereo.error += step;
    camera.right_from_left = camera.stereo.right_from_left();
}

#[cfg(test)]
mod tests {
    use super::*;
    use camera_models::{Distortion, Eye, Lens};
    use nalgebra::Vector2;

    /// A stereo camera whose lenses distort as wide-angle ones do.
    fn distorted() -> StereoCamera {
        let mut camera = crate::test_rig::stereo(0.1);
        let distortion = Distortion::RadTan4 {
            k1: -0.17,
            k2: 0.03,
            p1: 1e-3,
            p2: -5e-4,
        };
        camera.left.distortion = distortion;
        camera.right.distortion = distortion;
        camera
    }

    /// The residual of a right pixel, px, for a point of the left frame.
    fn residual(camera: &Camera, pixel: [f32; 2], x: &Vector3<f64>, rho: f64) -> Vector2<f64> {
        let right = camera.bearing(Eye::Right, pixel).expect("inside the image");
        let right = camera.stereo.compensate_lens_error(&right);
        let (residual, _) = right.residual(&camera.in_right(x, rho)).expect("in front");
        residual
    }

    #[test]
    fn jacobian_equals_finite_differences() {
        let mut camera = Camera::new(&distorted(), &cad_transforms::RigidTransform::identity());
        let error = StereoVector::from([1e-3, -2e-3, 1e-3, 0.01, -0.004, 0.003, 0.002]);
        apply_error(&mut camera, &error);
        let (x, rho) = (Vector3::new(0.3, -0.2, 0.9), 0.7);
        let pixel = camera.project_right(&x, rho).expect("inside the image");
        let right = camera.bearing(Eye::Right, pixel).expect("inside the image");
        let right = camera.stereo.compensate_lens_error(&right);
        let point = camera.in_right(&x, rho);
        let (_, by_point) = right.residual(&point).expect("in front");
        let origin = camera.right_from_left.1;
        let by = by_point * camera.stereo.jacobian(&right, &point, &origin, rho);
        for k in 0..STEREO_DIM {
            let h = 1e-6;
            let side = |h: f64| {
                let mut moved = camera.clone();
                let mut step = StereoVector::zeros();
                step[k] = h;
                apply_error(&mut moved, &step);
                residual(&moved, pixel, &x, rho)
            };
            let expected = (side(h) - side(-h)) / (2.0 * h);
            // The Jacobian of the rotation is that of a small error, and the decentering changes
            // the derivative by the point little. That by the focal length is without the product
            // with the principal point. Motions of the point up to 4e-3, in px:
            assert!(
                (by.column(k) - expected).amax() < 4e-3 * by_point.amax(),
                "{k}: {} {expected}",
                by.column(k)
            );
        }
    }

    /// Where the true lens, with its distortion, sees a point, its residual is zero, and the error
    /// of the focal length is that of the image: before the distortion it would be a fifth larger.
    #[test]
    fn lens_errors_act_after_the_distortion() {
        let nominal = distorted();
        for error in [0.01, -0.01] {
            let mut camera = Camera::new(&nominal, &cad_transforms::RigidTransform::identity());
            let lens = [0.0, 0.0, 0.0, 0.0, error, 0.004, 0.0];
            apply_error(&mut camera, &StereoVector::from(lens));
            let mut right = nominal.right;
            (right.fx, right.fy) = (right.fx * error.exp(), right.fy * error.exp());
            right.cx += 0.004 * nominal.right.fx;
            for x in [[0.5, 0.2, 0.8], [-0.6, -0.3, 0.7], [0.1, 0.4, 0.9]] {
                let x = Vector3::from(x);
                let (rotation, origin) = &camera.right_from_left;
                let point = rotation * x + origin * 0.5;
                let pixel = Lens::new(&right).project(point.into()).expect("inside");
                let projected = camera.project_right(&x, 0.5).expect("inside");
                let off = residual(&camera, projected, &x, 0.5);
                for k in 0..2 {
                    assert!(
                        (pixel[k] - f64::from(projected[k])).abs() < 1e-3,
                        "{pixel:?}"
                    );
                }
                // An error of 1 % is 3 px here.
                assert!(off.norm() < 0.05, "{error} at {x}: {off}");
            }
        }
    }

    #[test]
    fn cameras_without_covariance_may_deviate_alike() {
        let mut cameras = vec![crate::test_rig::stereo(0.1); 3];
        let config = BackendConfig::default();
        // Squared Mahalanobis distance of the same rotation of all right eyes, by stated sigmas.
        let distance = |cameras: &[StereoCamera], sigmas: f64| {
            let information = prior_information(&config, cameras);
            let mut error = DMatrix::zeros(information.nrows(), 1);
            for camera in 0..cameras.len() {
                error[camera * STEREO_DIM + 1] = sigmas * config.stereo.rotation_sigma_rad;
            }
            (error.transpose() * information * error)[0] / config.covariance.sigma_inflation.powi(2)
        };
        assert!((distance(&cameras[..1], 2.0) - 4.0).abs() < 1e-9);
        // Three independent ones would be 12.
        let expected = 3.0 * 4.0 / (1.0 + 2.0 * config.stereo.correlation);
        assert!((distance(&cameras, 2.0) - expected).abs() < 1e-9);
        // One that states its covariance says nothing of the others.
        cameras[2].right_from_left_covariance = Some(Matrix6::identity() * 1e-8);
        let information = prior_information(&config, &cameras);
        assert_eq!(information[(1, 2 * STEREO_DIM + 1)], 0.0);
        assert!(information[(1, STEREO_DIM + 1)] < 0.0);
    }

    #[test]
    fn invalid_covariance_is_not_stated() {
        let sigmas = |covariance: Option<Matrix6<f64>>| {
            let camera = StereoCamera {
                right_from_left_covariance: covariance,
                ..crate::test_rig::stereo(0.1)
            };
            StereoCalibrationConfig::default().prior_sigmas(&camera)
        };
        for invalid in [f64::NAN, f64::INFINITY, -1e-8] {
            assert_eq!(sigmas(Some(Matrix6::identity() * invalid)), sigmas(None));
        }
        assert!(sigmas(Some(Matrix6::zeros()))[0] < sigmas(None)[0]);
    }

    #[test]
    fn uncertain_rotation_about_x_widens_the_epipolar_tolerance() {
        let nominal = crate::test_rig::stereo(0.1);
        let mut camera = Camera::new(&nominal, &cad_transforms::RigidTransform::identity());
        let center = [nominal.left.cx as f32, nominal.left.cy as f32];
        let bearing = |side| camera.bearing(side, center).expect("inside the image");
        let [left, right] = [camera_models::Eye::Left, camera_models::Eye::Right].map(bearing);
        assert_eq!(camera.epipolar_sigma(&left, &right, 0.0), 0.0);
        camera.stereo.covariance[(0, 0)] = 2e-3_f64.powi(2);
        let expected = 2e-3 * nominal.right.fy;
        let found = camera.epipolar_sigma(&left, &right, 0.0);
        assert!(
            (found - expected).abs() < 1e-3 * expected,
            "{found} {expected}"
        );
        // A rotation about y moves this point along its epipolar line.
        camera.stereo.covariance = StereoMatrix::zeros();
        camera.stereo.covariance[(1, 1)] = 2e-3_f64.powi(2);
        assert!(camera.epipolar_sigma(&left, &right, 0.0) < 1e-3 * expected);
    }

    #[test]
    fn decentering_equals_a_rotation_about_y_in_rows_only() {
        let mut geometry = StereoGeometry::new((Matrix3::identity(), -0.06 * Vector3::x()));
        geometry.error[DECENTERING] = 1e-3;
        for (x, y) in [(0.4, 0.3), (-0.7, 0.2), (0.5, -0.5)] {
            let point = Vector3::new(x, y, 1.0);
            let decentered = geometry.decenter(point);
            let rotated = so3::exp(Vector3::new(0.0, 2e-3, 0.0)) * point;
            assert!((decentered.y - rotated.y / rotated.z).abs() < 4e-6);
            assert_eq!(decentered.xz(), point.xz());
        }
        // Its effect is bounded at a right angle.
        assert!(decentering_per_unit(&Vector3::new(1.0, 1.0, 0.0)) < 4.0);
        assert_eq!(decentering_per_unit(&Vector3::z()), 0.0);
    }

    #[test]
    fn without_an_error_the_geometry_is_nominal() {
        let nominal = (Matrix3::identity(), Vector3::new(-0.06, 0.0, 0.0));
        assert_eq!(StereoGeometry::new(nominal).right_from_left(), nominal);
    }
}
