//! Bearing observations of landmarks and their residuals.
//!
//! A landmark is a ray in the left image of its host (the camera and frame that created it) and an
//! inverse range. In another image at another time its direction is `R ray + rho t`, which holds
//! for distant points too. A residual is the angle between the predicted and the measured
//! direction, along two directions perpendicular to the measured ray, times the pixels per radian
//! of the lens there: it is in pixels for any lens, without a projection.
//!
//! Every observation has an exposure offset against the state, both for unsynchronized cameras and
//! for rows of rolling shutters. Over this offset the body moves at constant rate and velocity.

use camera_models::{Eye as Side, Lens};
use nalgebra::{Matrix2x3, Matrix3, SMatrix, Vector2, Vector3};

use crate::backend::state::State;
use crate::backend::stereo::{STEREO_DIM, StereoGeometry};
use crate::rig::StereoCamera;

/// Geometry of one stereo camera; the body is the frame of states.
#[derive(Clone, Debug)]
pub(crate) struct Camera {
    pub(crate) left: Lens,
    pub(crate) right: Lens,
    pub(crate) body_from_left: (Matrix3<f64>, Vector3<f64>),
    /// Map to the right eye with the estimated error of the calibration, see
    /// [`StereoGeometry::right_from_left`].
    pub(crate) right_from_left: (Matrix3<f64>, Vector3<f64>),
    pub(crate) stereo: StereoGeometry,
    pub(crate) line_s: f64,
}

impl Camera {
    pub(crate) fn new(
        camera: &StereoCamera,
        body_from_rig: &cad_transforms::RigidTransform,
    ) -> Self {
        let parts = |t: &cad_transforms::RigidTransform| {
            (
                t.rotation().to_rotation_matrix().into_inner(),
                *t.translation(),
            )
        };
        Self {
            left: Lens::new(&camera.left),
            right: Lens::new(&camera.right),
            body_from_left: parts(&(*body_from_rig * camera.rig_from_left)),
            right_from_left: parts(&camera.right_from_left),
            stereo: StereoGeometry::new(parts(&camera.right_from_left)),
            line_s: camera.line_s,
        }
    }

    fn lens(&self, side: Side) -> &Lens {
        match side {
            Side::Left => &self.left,
            Side::Right => &self.right,
        }
    }

    /// Bearing of a pixel; `None` outside the domain of the camera model.
    pub(crate) fn bearing(&self, side: Side, pixel: [f32; 2]) -> Option<BearingMeasurement> {
        let lens = self.lens(side);
        let ray = Vector3::from(lens.unproject(pixel.map(f64::from))?);
        let ray = ray.normalize();
        let projected = lens.project_with_jacobians(ray.into())?;
        let reference = if ray.x.abs() < 0.6 {
            Vector3::x()
        } else {
            Vector3::y()
        };
        let first = ray.cross(&reference).normalize();
        let basis = Matrix2x3::from_rows(&[first.transpose(), ray.cross(&first).transpose()]);
        let jacobian = projected.by_point * basis.transpose();
        // Motion of the ray with the pixel.
        let by_pixel = basis.transpose() * jacobian.try_inverse()?;
        let model = lens.model();
        let from_center = [0, 1].map(|k| f64::from(pixel[k]) - [model.cx, model.cy][k]);
        Some(BearingMeasurement {
            ray,
            basis: basis * jacobian.determinant().abs().sqrt(),
            by_focal: by_pixel * Vector2::from(from_center),
            by_principal_point: by_pixel * Vector2::new(model.fx, 0.0),
        })
    }

    /// Exposure offset of a row against the middle row, s.
    pub(crate) fn row_after_s(&self, side: Side, y: f32) -> f64 {
        let rows = f64::from(self.lens(side).model().height);
        (f64::from(y) - 0.5 * (rows - 1.0)) * self.line_s
    }

    /// A point in the left frame, scaled by its inverse range, in the frame of the right eye, with
    /// the decentering. Of its bearings there, see [`StereoGeometry::compensate_lens_error`].
    pub(crate) fn in_right(&self, x: &Vector3<f64>, rho: f64) -> Vector3<f64> {
        let (rotation, origin) = &self.right_from_left;
        self.stereo.decenter(rotation * x + origin * rho)
    }

    /// Pixel in the right image of a point in the left frame, scaled by its inverse range.
    pub(crate) fn project_right(&self, x: &Vector3<f64>, rho: f64) -> Option<[f32; 2]> {
        let nominal = self.right.project(self.in_right(x, rho).into())?;
        let pixel = self.stereo.move_pixel(self.right.model(), nominal);
        Some(pixel.map(|v| v as f32))
    }

    /// Triangulates: inverse range along the left ray, and the remaining epipolar error in the
    /// right image, px.
    pub(crate) fn triangulate(
        &self,
        left: &BearingMeasurement,
        right: &BearingMeasurement,
    ) -> (f64, f64) {
        let right = self.stereo.compensate_lens_error(right);
        let (rotation, origin) = &self.right_from_left;
        let ray = rotation * left.ray;
        // Perpendicular to the right ray: basis (ray + rho origin) = 0.
        let (a, b) = (right.basis * origin, right.basis * ray);
        let rho = -a.dot(&b) / a.norm_squared();
        let x = self.stereo.decenter(ray + origin * rho);
        (rho, (right.basis * x / x.norm()).norm())
    }

    /// Derivative of a triangulated inverse range by the error of the stereo calibration; zero
    /// without a match in the right image.
    pub(crate) fn inverse_range_by_stereo(
        &self,
        observation: &BearingObservation,
        rho: f64,
    ) -> SMatrix<f64, 1, STEREO_DIM> {
        let Some(right) = &observation.right else {
            return SMatrix::zeros();
        };
        let origin = &self.right_from_left.1;
        let right = self.stereo.compensate_lens_error(right);
        let x = self.in_right(&observation.left.ray, rho);
        let along = right.basis * origin;
        let by_error = right.basis * self.stereo.jacobian(&right, &x, origin, rho);
        -along.transpose() * by_error / along.norm_squared()
    }

    /// Standard deviation of the epipolar error of a match with this inverse range, px, due to the
    /// uncertainty of the stereo calibration.
    pub(crate) fn epipolar_sigma(
        &self,
        left: &BearingMeasurement,
        right: &BearingMeasurement,
        rho: f64,
    ) -> f64 {
        let origin = &self.right_from_left.1;
        let right = self.stereo.compensate_lens_error(right);
        let x = self.in_right(&left.ray, rho);
        let along = right.basis * origin;
        let across = Vector2::new(-along.y, along.x).normalize();
        let by_error = right.basis * self.stereo.jacobian(&right, &x, origin, rho) / x.norm();
        let by_error = by_error.transpose() * across;
        by_error
            .dot(&(self.stereo.covariance * by_error))
            .max(0.0)
            .sqrt()
    }
}

/// Measured bearing: a unit ray, and two directions perpendicular to it, scaled by pixels per
/// radian.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BearingMeasurement {
    pub(crate) ray: Vector3<f64>,
    pub(crate) basis: Matrix2x3<f64>,
    /// Motion of the ray for a relative change of the distance from the principal point, with the
    /// distortion of the lens; perpendicular to the ray.
    pub(crate) by_focal: Vector3<f64>,
    /// The same for a motion along x by a focal length.
    pub(crate) by_principal_point: Vector3<f64>,
}

/// Cosine of the angle to the measured ray below which a residual is saturated: its direction has
/// no meaning.
const SATURATION_COSINE: f64 = 0.2;

impl BearingMeasurement {
    /// Residual of a point in the frame of this image, px, and its Jacobian by the point; `None` if
    /// saturated.
    #[inline]
    pub(crate) fn residual(&self, x: &Vector3<f64>) -> Option<(Vector2<f64>, Matrix2x3<f64>)> {
        let range = x.norm();
        let unit = x / range;
        if unit.dot(&self.ray) < SATURATION_COSINE {
            return None;
        }
        let residual = self.basis * unit;
        let jacobian = (self.basis - residual * unit.transpose()) / range;
        Some((residual, jacobian))
    }

    /// Squared residual of a point, px².
    pub(crate) fn squared_residual(&self, x: &Vector3<f64>) -> f64 {
        self.residual(x).map_or_else(
            || self.saturated_residual(),
            |(residual, _)| residual.norm_squared(),
        )
    }

    /// Squared residual of a saturated point, px²: that at the limit, so that the cost is
    /// continuous.
    pub(crate) fn saturated_residual(&self) -> f64 {
        // The basis has two orthogonal rows with a norm of pixels per radian.
        (1.0 - SATURATION_COSINE * SATURATION_COSINE) * 0.5 * self.basis.norm_squared()
    }
}

/// Observation of a landmark by one camera in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BearingObservation {
    pub(crate) camera: usize,
    pub(crate) left: BearingMeasurement,
    pub(crate) right: Option<BearingMeasurement>,
    /// Exposure offset against the state, s.
    pub(crate) exposure_offset_s: f64,
}

impl BearingObservation {
    /// The observation with its standard deviation multiplied by `times`.
    pub(crate) fn widened(mut self, times: f64) -> Self {
        self.left.basis /= times;
        if let Some(right) = &mut self.right {
            right.basis /= times;
        }
        self
    }
}

/// Body pose at the time of an observation.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CameraPose {
    /// World from body at the time of the observation.
    pub(crate) rotation: Matrix3<f64>,
    pub(crate) position: Vector3<f64>,
    /// Body at the time of the observation from body of the state.
    pub(crate) then_from_state: Matrix3<f64>,
}

impl CameraPose {
    #[inline]
    pub(crate) fn new(state: &State, exposure_offset_s: f64) -> Self {
        let (rotation, position) = state.pose_after(exposure_offset_s);
        let rotation = rotation.to_rotation_matrix().into_inner();
        let then_from_state = if exposure_offset_s == 0.0 {
            Matrix3::identity()
        } else {
            rotation.transpose() * state.rotation.to_rotation_matrix().into_inner()
        };
        Self {
            rotation,
            position,
            then_from_state,
        }
    }
}

/// Landmark in the left frame of an observing camera, scaled by its inverse range, with
/// intermediate values for Jacobians.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TransferredPoint {
    /// Point in the left frame of the target.
    pub(crate) x: Vector3<f64>,
    /// Derivative of `x` by the inverse range.
    pub(crate) by_rho: Vector3<f64>,
    /// Rotation: left frame of the target from world.
    pub(crate) left_from_world: Matrix3<f64>,
    /// Point in the body frame of the host, scaled by the inverse range.
    pub(crate) in_host: Vector3<f64>,
    /// Point in the body frame of the target, scaled by the inverse range.
    pub(crate) in_target: Vector3<f64>,
}

/// Transfers a landmark from its host to another observation.
#[inline]
pub(crate) fn transfer(
    ray: &Vector3<f64>,
    rho: f64,
    from: (&Camera, &CameraPose),
    to: (&Camera, &CameraPose),
) -> TransferredPoint {
    let (host_rotation, host_translation) = &from.0.body_from_left;
    let (rotation, translation) = &to.0.body_from_left;
    let in_host = host_rotation * ray + host_translation * rho;
    let body_from_world = to.1.rotation.transpose();
    let translation_between = from.1.position - to.1.position;
    let in_target = body_from_world * (from.1.rotation * in_host + translation_between * rho);
    let left_from_body = rotation.transpose();
    let by_rho = left_from_body
        * (body_from_world * (from.1.rotation * host_translation + translation_between)
            - translation);
    TransferredPoint {
        x: left_from_body * (in_target - translation * rho),
        by_rho,
        left_from_world: left_from_body * body_from_world,
        in_host,
        in_target,
    }
}
