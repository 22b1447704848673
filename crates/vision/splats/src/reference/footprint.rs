//! Projection of a Gaussian into an image, and its gradient.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3, Vector4};

use super::scene::Scene;
use crate::camera::Camera;
use crate::config::RenderConfig;
use crate::scene::{Plane, coefficients};
use gaussians::harmonics;

/// Step of the differences of a distorted lens's Jacobian, as a share of the depth.
const LENS_STEP: f64 = 1e-5;

/// A Gaussian in an image, with what its gradient needs.
pub(super) struct Footprint {
    pub(super) index: usize,
    /// Depth along the optical axis, m.
    pub(super) z: f64,
    /// Mean, px.
    pub(super) mean: Vector2<f64>,
    /// Inverse covariance, px⁻².
    pub(super) conic: Matrix2<f64>,
    /// Opacity after compensation.
    pub(super) opacity: f64,
    pub(super) color: Vector3<f64>,
    p: Vector3<f64>,
    linear: Linear,
    /// Mean without shutter, px.
    still_mean: Vector2<f64>,
    /// Covariance without shutter and without dilation, px².
    still_covariance: Matrix2<f64>,
    compensation: f64,
    /// The compensation's lower bound holds.
    is_bounded: bool,
    rolling: Option<Rolling>,
}

/// Linearization of the lens at a point.
struct Linear {
    jacobian: Matrix2x3<f64>,
    /// Derivatives of the Jacobian with respect to the point.
    by_point: [Matrix2x3<f64>; 3],
}

/// A rolling shutter at one Gaussian.
struct Rolling {
    /// Velocity of the point relative to the camera, negated, m/s.
    u: Vector3<f64>,
    /// Velocity of the mean, px/s.
    v: Vector2<f64>,
    g: Vector2<f64>,
    rate: Vector3<f64>,
    /// `gᵀ (m - reference)`, s.
    time: f64,
    /// `1 / (1 - gᵀ v)`.
    stretch: f64,
}

/// Gradient with respect to a footprint.
pub(super) struct FootprintGradient {
    pub(super) mean: Vector2<f64>,
    /// With respect to all four entries of the conic.
    pub(super) conic: Matrix2<f64>,
    pub(super) opacity: f64,
    pub(super) color: Vector3<f64>,
    pub(super) z: f64,
}

/// All visible Gaussians, by depth; those of equal depth by index.
pub(super) fn all(scene: &Scene, camera: &Camera, config: &RenderConfig) -> Vec<Footprint> {
    let indices = 0..scene.len();
    let mut all: Vec<_> = indices
        .filter_map(|i| project(scene, i, camera, config))
        .collect();
    all.sort_by(|a, b| a.z.total_cmp(&b.z).then(a.index.cmp(&b.index)));
    all
}

fn project(
    scene: &Scene,
    index: usize,
    camera: &Camera,
    config: &RenderConfig,
) -> Option<Footprint> {
    let pose = camera.camera_from_world();
    let p = pose.rotation() * scene.position(index) + pose.translation();
    if !(p.z >= f64::from(config.near_m) && p.z <= f64::from(config.far_m)) {
        return None;
    }
    let (still_mean, linear) = linearize(camera, p, config)?;
    let rotation = pose.rotation().to_rotation_matrix().into_inner();
    let root = linear.jacobian * rotation * axes(scene, index);
    let still_covariance = root * root.transpose();
    let rolling = match camera.shutter() {
        None => None,
        Some(shutter) => {
            let g = Vector2::from(shutter.time_gradient_s_per_px);
            let rate = Vector3::from(shutter.rate_rad_s);
            let u = Vector3::from(shutter.velocity_m_s) + rate.cross(&p);
            let v = -linear.jacobian * u;
            let shear = 1.0 - g.dot(&v);
            if shear < f64::from(config.min_shear) {
                return None;
            }
            let time = g.dot(&(still_mean - Vector2::from(shutter.reference_px)));
            let stretch = 1.0 / shear;
            Some(Rolling {
                u,
                v,
                g,
                rate,
                time,
                stretch,
            })
        }
    };
    let (mut mean, mut moving) = (still_mean, Matrix2::identity());
    if let Some(r) = &rolling {
        mean += r.v * (r.stretch * r.time);
        moving += r.v * r.g.transpose() * r.stretch;
    }
    let sheared = moving * still_covariance * moving.transpose();
    let covariance = sheared + Matrix2::identity() * f64::from(config.dilation_px2);
    let conic = covariance.try_inverse()?;
    let floor = f64::from(config.min_compensation);
    let square = (sheared.determinant() / covariance.determinant()).max(0.0);
    let (compensation, is_bounded) = match config.compensate {
        true => (square.sqrt().max(floor), square.sqrt() <= floor),
        false => (1.0, true),
    };
    let opacity = scene.opacity(index) * compensation;
    if opacity < f64::from(config.min_alpha) || !conic.iter().all(|v| v.is_finite()) {
        return None;
    }
    Some(Footprint {
        index,
        z: p.z,
        mean,
        conic,
        opacity,
        color: color(scene, index, camera).0,
        p,
        linear,
        still_mean,
        still_covariance,
        compensation,
        is_bounded,
        rolling,
    })
}

/// Rotation times scales: the covariance's root.
fn axes(scene: &Scene, index: usize) -> Matrix3<f64> {
    scene.rotation(index) * Matrix3::from_diagonal(&scene.scale(index))
}

/// Pixel of a point and the lens's linearization there.
fn linearize(
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

/// Color towards the camera; which channels are above 0; direction and distance from the camera.
fn color(
    scene: &Scene,
    index: usize,
    camera: &Camera,
) -> (Vector3<f64>, [bool; 3], Vector3<f64>, f64) {
    let center = camera.camera_from_world().inverse();
    let offset = scene.position(index) - center.translation();
    let direction = offset.normalize();
    let values = harmonics::values(direction, coefficients(scene.degree));
    let mut color = Vector3::repeat(0.5);
    for ((value, _), f) in values.iter().zip(scene.harmonics(index)) {
        color += f * *value;
    }
    let positive = std::array::from_fn(|c| color[c] > 0.0);
    (
        color.map(|v| v.max(0.0)),
        positive,
        direction,
        offset.norm(),
    )
}

impl Footprint {
    /// Adds the gradient with respect to this Gaussian's parameters to `planes`; returns that with
    /// respect to the camera's small motion: `p → p - v - ω × p`, m and rad.
    pub(super) fn backward(
        &self,
        scene: &Scene,
        camera: &Camera,
        config: &RenderConfig,
        gradient: &FootprintGradient,
        planes: &mut [Vec<f64>],
    ) -> (Vector3<f64>, Vector3<f64>) {
        let index = self.index;
        let jacobian = self.linear.jacobian;
        let rotation = camera
            .camera_from_world()
            .rotation()
            .to_rotation_matrix()
            .into_inner();
        let (mean, covariance, mut g_jacobian, mut g_p) = self.without_shutter(config, gradient);
        let root = axes(scene, index);
        let v = rotation * root * root.transpose() * rotation.transpose();
        g_jacobian += 2.0 * covariance * jacobian * v;
        g_p += jacobian_of_mean(camera, self).transpose() * mean;
        for (k, by) in self.linear.by_point.iter().enumerate() {
            g_p[k] += g_jacobian.dot(by);
        }
        g_p.z += gradient.z;

        let g_v = jacobian.transpose() * covariance * jacobian;
        let via_direction = self.color_backward(scene, camera, gradient.color, planes);
        let g_position = rotation.transpose() * g_p + via_direction;
        for k in 0..3 {
            planes[Plane::POSITION + k][index] += g_position[k];
        }
        let g_root = 2.0 * rotation.transpose() * g_v * rotation * root;
        shape_backward(scene, index, &g_root, planes);
        let o = scene.opacity(index);
        planes[Plane::OPACITY][index] += o * (1.0 - o) * self.compensation * gradient.opacity;

        let k = g_v * v;
        let twist = Vector3::new(
            k[(1, 2)] - k[(2, 1)],
            k[(2, 0)] - k[(0, 2)],
            k[(0, 1)] - k[(1, 0)],
        );
        let velocity = -g_p - rotation * via_direction;
        (velocity, -self.p.cross(&g_p) + 2.0 * twist)
    }

    /// Gradients with respect to mean and covariance without shutter, and the part of the shutter
    /// in those with respect to the lens's Jacobian and the point.
    fn without_shutter(
        &self,
        config: &RenderConfig,
        gradient: &FootprintGradient,
    ) -> (Vector2<f64>, Matrix2<f64>, Matrix2x3<f64>, Vector3<f64>) {
        let q = self.conic;
        let mut g = -q * gradient.conic * q;
        if !self.is_bounded {
            let (rho, det) = (self.compensation, q.determinant());
            let by_rho = gradient.opacity * self.opacity / rho;
            let dilation = f64::from(config.dilation_px2);
            let inner = q * (1.0 - rho * rho) - Matrix2::identity() * (dilation * det);
            g += inner * (0.5 * by_rho / rho);
        }
        let Some(r) = &self.rolling else {
            return (gradient.mean, g, Matrix2x3::zeros(), Vector3::zeros());
        };
        let moving = Matrix2::identity() + r.v * r.g.transpose() * r.stretch;
        let g_mean = moving.transpose() * gradient.mean;
        let g_covariance = moving.transpose() * g * moving;
        let g_moving = 2.0 * g * moving * self.still_covariance;
        let change = r.g * (r.stretch * r.stretch);
        let g_velocity = gradient.mean * (r.stretch * r.time)
            + change * (r.time * gradient.mean.dot(&r.v))
            + g_moving * r.g * r.stretch
            + change * r.v.dot(&(g_moving * r.g));
        let g_jacobian = -g_velocity * r.u.transpose();
        let g_u: Vector3<f64> = -self.linear.jacobian.transpose() * g_velocity;
        (g_mean, g_covariance, g_jacobian, g_u.cross(&r.rate))
    }

    /// The harmonics' gradients; returns the position's through the direction.
    fn color_backward(
        &self,
        scene: &Scene,
        camera: &Camera,
        gradient: Vector3<f64>,
        planes: &mut [Vec<f64>],
    ) -> Vector3<f64> {
        let (_, positive, direction, distance) = color(scene, self.index, camera);
        let gradient = Vector3::from_fn(|c, _| if positive[c] { gradient[c] } else { 0.0 });
        let values = harmonics::values(direction, coefficients(scene.degree));
        let mut by_direction = Vector3::zeros();
        for (k, ((value, slope), f)) in values.iter().zip(scene.harmonics(self.index)).enumerate() {
            for c in 0..3 {
                planes[Plane::HARMONICS + 3 * k + c][self.index] += value * gradient[c];
            }
            by_direction += slope * f.dot(&gradient);
        }
        (by_direction - direction * direction.dot(&by_direction)) / distance
    }
}

/// Jacobian of the mean's pixel: that of the linearization, but never bounded.
fn jacobian_of_mean(camera: &Camera, of: &Footprint) -> Matrix2x3<f64> {
    let (model, p) = (camera.model(), of.p);
    if model.distortion != camera_models::Distortion::None {
        return of.linear.jacobian;
    }
    let mut jacobian = of.linear.jacobian;
    let from_center = of.still_mean - Vector2::new(model.cx, model.cy);
    jacobian.set_column(2, &(-from_center / p.z));
    jacobian
}

/// Gradients of scales and rotation from that of the covariance's root.
fn shape_backward(scene: &Scene, index: usize, g_root: &Matrix3<f64>, planes: &mut [Vec<f64>]) {
    let (rotation, scale) = (scene.rotation(index), scene.scale(index));
    for k in 0..3 {
        let along = rotation.column(k).dot(&g_root.column(k));
        planes[Plane::SCALE + k][index] += scale[k] * along;
    }
    let g = g_root * Matrix3::from_diagonal(&scale);
    let stored = scene.quaternion(index);
    let unit = stored.normalize();
    let (w, x, y, z) = (unit[0], unit[1], unit[2], unit[3]);
    let a = |i: usize, j: usize| g[(i, j)];
    let by_unit = Vector4::new(
        x * (a(2, 1) - a(1, 2)) + y * (a(0, 2) - a(2, 0)) + z * (a(1, 0) - a(0, 1)),
        -2.0 * x * (a(1, 1) + a(2, 2))
            + y * (a(1, 0) + a(0, 1))
            + z * (a(2, 0) + a(0, 2))
            + w * (a(2, 1) - a(1, 2)),
        x * (a(1, 0) + a(0, 1)) - 2.0 * y * (a(0, 0) + a(2, 2))
            + z * (a(2, 1) + a(1, 2))
            + w * (a(0, 2) - a(2, 0)),
        x * (a(2, 0) + a(0, 2)) + y * (a(2, 1) + a(1, 2)) - 2.0 * z * (a(0, 0) + a(1, 1))
            + w * (a(1, 0) - a(0, 1)),
    ) * 2.0;
    let by_stored = (by_unit - unit * unit.dot(&by_unit)) / stored.norm();
    for k in 0..4 {
        planes[Plane::ROTATION + k][index] += by_stored[k];
    }
}
