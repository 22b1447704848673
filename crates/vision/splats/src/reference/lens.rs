//! Linearization of a lens.

use nalgebra::{Matrix2x3, Vector2, Vector3};

use crate::camera::Camera;
use crate::config::RenderConfig;

/// Step of the differences of a distorted lens's Jacobian, as a share of the depth.
const LENS_STEP: f64 = 1e-5;

/// Linearization of the lens at a point.
pub(super) struct Linear {
    pub(super) jacobian: Matrix2x3<f64>,
    /// Derivatives of the Jacobian with respect to the point.
    pub(super) by_point: [Matrix2x3<f64>; 3],
}

/// Pixel of a point and the lens's linearization there.
pub(super) fn linearize(
    camera: &Camera,
    p: Vector3<f64>,
    config: &RenderConfig,
) -> Option<(Vector2<f64>, Linear)> {
    let model = camera.model();
    if model.distortion != camera_models::Distortion::None {
        return linearize_lens(camera, p, config);
    }
    let mean = Vector2::new(
        model.fx * p.x / p.z + model.cx,
        model.fy * p.y / p.z + model.cy,
    );
    let mut jacobian = Matrix2x3::zeros();
    let mut by_point = [Matrix2x3::zeros(); 3];
    let sizes = [model.width, model.height];
    let (focals, centers) = ([model.fx, model.fy], [model.cx, model.cy]);
    for k in 0..2 {
        let (f, center, size) = (focals[k], centers[k], f64::from(sizes[k]));
        let beyond = f64::from(config.margin) * size + 0.5;
        let slope = p[k] / p.z;
        let bounded = slope.clamp((-beyond - center) / f, (size - 1.0 + beyond - center) / f);
        jacobian[(k, k)] = f / p.z;
        jacobian[(k, 2)] = -f * bounded / p.z;
        by_point[2][(k, k)] = -f / (p.z * p.z);
        if bounded == slope {
            by_point[k][(k, 2)] = -f / (p.z * p.z);
            by_point[2][(k, 2)] = 2.0 * f * slope / (p.z * p.z);
        } else {
            by_point[2][(k, 2)] = f * bounded / (p.z * p.z);
        }
    }
    Some((mean, Linear { jacobian, by_point }))
}

fn linearize_lens(
    camera: &Camera,
    p: Vector3<f64>,
    config: &RenderConfig,
) -> Option<(Vector2<f64>, Linear)> {
    let at = |p: Vector3<f64>| camera.lens().project_with_jacobians(p.into());
    let here = at(p)?;
    let sizes = [camera.model().width, camera.model().height];
    for (pixel, size) in here.pixel.into_iter().zip(sizes.map(f64::from)) {
        let beyond = f64::from(config.margin) * size + 0.5;
        if !(-beyond..=size - 1.0 + beyond).contains(&pixel) {
            return None;
        }
    }
    let step = LENS_STEP * p.z;
    let mut by_point = [Matrix2x3::zeros(); 3];
    for (k, by) in by_point.iter_mut().enumerate() {
        let beside = |sign: f64| {
            let mut q = p;
            q[k] += sign * step;
            at(q)
        };
        // At the edge of the lens's domain the Jacobian is taken as constant.
        if let (Some(after), Some(before)) = (beside(1.0), beside(-1.0)) {
            *by = (after.by_point - before.by_point) / (2.0 * step);
        }
    }
    let jacobian = here.by_point;
    Some((here.pixel.into(), Linear { jacobian, by_point }))
}
