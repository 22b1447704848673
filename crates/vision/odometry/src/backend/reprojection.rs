//! Reprojection residuals: of one observation in both images, with Jacobians and a robust weight.

use nalgebra::{SMatrix, Vector2, Vector3};

use crate::backend::observation::{BearingMeasurement, BearingObservation, Camera};
use crate::backend::state::POSE_DIM;
use crate::backend::stereo::STEREO_DIM;
use crate::config::BackendConfig;

pub(crate) type ByPose = SMatrix<f64, 2, POSE_DIM>;
pub(crate) type ByStereo = SMatrix<f64, 2, STEREO_DIM>;

/// Huber weight and cost of a squared residual and a threshold in standard deviations.
#[inline]
pub(crate) fn huber(huber_sigma: f64, squared_residual: f64) -> (f64, f64) {
    if squared_residual <= huber_sigma * huber_sigma {
        (1.0, squared_residual)
    } else {
        let size = squared_residual.sqrt();
        (
            huber_sigma / size,
            2.0 * huber_sigma * size - huber_sigma * huber_sigma,
        )
    }
}

/// Reprojection residual in one image, px, with its Jacobians by the point in the left frame and by
/// the inverse range, and its robust weight and cost.
pub(crate) struct Residual {
    pub(crate) residual: Vector2<f64>,
    pub(crate) by_x: SMatrix<f64, 2, 3>,
    pub(crate) by_rho: Vector2<f64>,
    /// By the error of the stereo calibration; zero in the left image.
    pub(crate) by_stereo: ByStereo,
    pub(crate) weight: f64,
    pub(crate) cost: f64,
}

/// Residuals in both images of a point in the left frame, scaled by the inverse range. The left
/// residual of a host is zero by definition and omitted. A saturated residual has a constant cost
/// and no gradient.
pub(crate) fn residuals(
    camera: &Camera,
    observation: &BearingObservation,
    x: &Vector3<f64>,
    by_rho: &Vector3<f64>,
    rho: f64,
    is_host: bool,
    config: &BackendConfig,
) -> [Option<Residual>; 2] {
    let (observation_sigma_px, huber_sigma) = (config.observation_sigma_px, config.huber_sigma);
    let weigh = |residual: Vector2<f64>, by_x: SMatrix<f64, 2, 3>, by_rho: Vector2<f64>| {
        let (weight, cost) = huber(
            huber_sigma,
            residual.norm_squared() / (observation_sigma_px * observation_sigma_px),
        );
        Residual {
            residual,
            by_x,
            by_rho,
            by_stereo: ByStereo::zeros(),
            weight: weight / (observation_sigma_px * observation_sigma_px),
            cost,
        }
    };
    let saturated = |bearing: &BearingMeasurement| Residual {
        residual: Vector2::zeros(),
        by_x: SMatrix::zeros(),
        by_rho: Vector2::zeros(),
        by_stereo: ByStereo::zeros(),
        weight: 0.0,
        cost: huber(
            huber_sigma,
            bearing.saturated_residual() / (observation_sigma_px * observation_sigma_px),
        )
        .1,
    };
    let left = (!is_host).then(|| match observation.left.residual(x) {
        Some((residual, by)) => weigh(residual, by, by * by_rho),
        None => saturated(&observation.left),
    });
    let right = observation.right.as_ref().map(|right| {
        let (rotation, origin) = &camera.right_from_left;
        let point = camera.in_right(x, rho);
        let right = camera.stereo.compensate_lens_error(right);
        // The decentering changes Jacobians by less than a hundredth.
        let Some((residual, by)) = right.residual(&point) else {
            return saturated(&right);
        };
        let by_left = by * rotation;
        Residual {
            by_stereo: by * camera.stereo.jacobian(&right, &point, origin, rho),
            ..weigh(residual, by_left, by_left * by_rho + by * origin)
        }
    });
    [left, right]
}
