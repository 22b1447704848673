//! What an eye saw of a landmark, and how well a guess explains it.
//!
//! A landmark is a ray of the left eye of the camera that it was first kept in (its host), and an inverse range. Seen by
//! another eye at another time it is at `R ray + rho t`, which holds for far things too. A residual is the angle between
//! where that is and where it was seen, along two directions across the ray, times the lens's pixels per radian there:
//! pixels for any lens, without projecting again.
//!
//! Every sight has a time of its own against the state's: cameras that are not synchronised and the rows of rolling shutters
//! alike. Between the two the body is taken to move at constant rate and velocity.

use calib::{Eye as Side, Lens};
use nalgebra::{Matrix2x3, Matrix3, Vector2, Vector3};

use crate::backend::state::State;
use crate::rig::StereoCamera;

/// The geometry of one stereo camera, body being the frame of states.
#[derive(Clone, Debug)]
pub(crate) struct Camera {
    pub(crate) left: Lens,
    pub(crate) right: Lens,
    pub(crate) body_from_left: (Matrix3<f64>, Vector3<f64>),
    pub(crate) right_from_left: (Matrix3<f64>, Vector3<f64>),
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
            line_s: camera.line_s,
        }
    }

    fn lens(&self, side: Side) -> &Lens {
        match side {
            Side::Left => &self.left,
            Side::Right => &self.right,
        }
    }

    /// Where an eye saw something; none if the lens cannot have.
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
        Some(BearingMeasurement {
            ray,
            basis: basis * jacobian.determinant().abs().sqrt(),
        })
    }

    /// How much later than the middle row a row is exposed, s.
    pub(crate) fn row_after_s(&self, side: Side, y: f32) -> f64 {
        let rows = f64::from(self.lens(side).model().height);
        (f64::from(y) - 0.5 * (rows - 1.0)) * self.line_s
    }

    /// Inverse range along the left ray that fits both rays best, and by how much the right one is then off, px.
    pub(crate) fn triangulate(
        &self,
        left: &BearingMeasurement,
        right: &BearingMeasurement,
    ) -> (f64, f64) {
        let (rotation, origin) = &self.right_from_left;
        let ray = rotation * left.ray;
        // Across the right ray: basis (ray + rho origin) = 0.
        let (a, b) = (right.basis * origin, right.basis * ray);
        let rho = -a.dot(&b) / a.norm_squared();
        let x = ray + origin * rho;
        (rho, (right.basis * x / x.norm()).norm())
    }
}

/// Where something was seen: a unit ray, and the two directions across it, times pixels per radian.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BearingMeasurement {
    pub(crate) ray: Vector3<f64>,
    pub(crate) basis: Matrix2x3<f64>,
}

/// Cosine of the angle from a ray beyond which a point is too far off for its residual to say which way.
const SATURATION_COSINE: f64 = 0.2;

impl BearingMeasurement {
    /// How far off, px, a point in this eye's frame is, and the derivatives by the point; none where it is too far off.
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

    /// Square of how far off a point is, px².
    pub(crate) fn squared_residual(&self, x: &Vector3<f64>) -> f64 {
        self.residual(x).map_or_else(
            || self.saturated_residual(),
            |(residual, _)| residual.norm_squared(),
        )
    }

    /// The same of whatever is too far off: that of a point that only just is, so that costs do not leap.
    pub(crate) fn saturated_residual(&self) -> f64 {
        // The basis has two rows at right angles, both as long as there are pixels in a radian.
        (1.0 - SATURATION_COSINE * SATURATION_COSINE) * 0.5 * self.basis.norm_squared()
    }
}

/// A landmark as one camera saw it in one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct BearingObservation {
    pub(crate) camera: usize,
    pub(crate) left: BearingMeasurement,
    pub(crate) right: Option<BearingMeasurement>,
    /// How much later than its state it was seen, s.
    pub(crate) exposure_offset_s: f64,
}

impl BearingObservation {
    /// The same with so many times the standard deviation.
    pub(crate) fn widened(mut self, times: f64) -> Self {
        self.left.basis /= times;
        if let Some(right) = &mut self.right {
            right.basis /= times;
        }
        self
    }
}

/// A camera at the time of a sight: what takes rays to the world and back.
#[derive(Clone, Copy, Debug)]
pub(crate) struct CameraPose {
    /// World from body then.
    pub(crate) rotation: Matrix3<f64>,
    pub(crate) position: Vector3<f64>,
    /// Body then from body of the state.
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

/// A point in the left frame of a sight's camera, times the landmark's inverse range, and what it depends on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct TransferredPoint {
    /// In the target's left frame.
    pub(crate) x: Vector3<f64>,
    /// By the inverse range.
    pub(crate) by_rho: Vector3<f64>,
    /// Target's left frame from world.
    pub(crate) left_from_world: Matrix3<f64>,
    /// In the host's body, times the inverse range.
    pub(crate) in_host: Vector3<f64>,
    /// In the target's body, times the inverse range.
    pub(crate) in_target: Vector3<f64>,
}

/// Takes a landmark from its host to another sight.
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
