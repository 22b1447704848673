//! Projection of a Gaussian into an image, and its gradient.

use nalgebra::{Matrix2, Matrix2x3, Matrix3, Vector2, Vector3, Vector4};

use super::lens::{Linear, linearize};
use super::scene::Scene;
use super::slope::Slope;
use crate::camera::Camera;
use crate::config::RenderConfig;
use crate::scene::{Plane, coefficients};
use gaussians::harmonics;

/// A Gaussian in an image, with what its gradient needs.
pub(super) struct Footprint {
    pub(super) index: usize,
    /// Depth of the mean along the optical axis, m.
    pub(super) z: f64,
    pub(super) slope: Slope,
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
    /// Covariance of pixel and depth without shutter, m px.
    still_with_depth: Vector2<f64>,
    compensation: f64,
    /// The compensation's lower bound holds.
    is_bounded: bool,
    rolling: Option<Rolling>,
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
    /// With respect to the depth of the mean.
    pub(super) z: f64,
    pub(super) slope: Vector2<f64>,
}

/// Gradients with respect to what there is without shutter.
struct WithoutShutter {
    mean: Vector2<f64>,
    covariance: Matrix2<f64>,
    /// With respect to the covariance of pixel and depth.
    with_depth: Vector2<f64>,
    /// With respect to the lens's Jacobian, the part of the shutter.
    jacobian: Matrix2x3<f64>,
    /// With respect to the point, the parts of the shutter and of the depth.
    point: Vector3<f64>,
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
    let in_camera = rotation * axes(scene, index);
    let root = linear.jacobian * in_camera;
    let still_covariance = root * root.transpose();
    let still_with_depth = root * in_camera.row(2).transpose();
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
    let slope = Slope::new(&sheared, &(moving * still_with_depth), p.z, config)?;
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
        slope,
        mean,
        conic,
        opacity,
        color: color(scene, index, camera).0,
        p,
        linear,
        still_mean,
        still_covariance,
        still_with_depth,
        compensation,
        is_bounded,
        rolling,
    })
}

/// Rotation times scales: the covariance's root.
fn axes(scene: &Scene, index: usize) -> Matrix3<f64> {
    scene.rotation(index) * Matrix3::from_diagonal(&scene.scale(index))
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
        let by = self.without_shutter(config, gradient);
        let (mut g_jacobian, mut g_p) = (by.jacobian, by.point);
        let root = axes(scene, index);
        let v = rotation * root * root.transpose() * rotation.transpose();
        g_jacobian += 2.0 * by.covariance * jacobian * v + by.with_depth * v.row(2);
        g_p += jacobian_of_mean(camera, self).transpose() * by.mean;
        for (k, by) in self.linear.by_point.iter().enumerate() {
            g_p[k] += g_jacobian.dot(by);
        }
        let mut g_v = jacobian.transpose() * by.covariance * jacobian;
        let depth_column = jacobian.transpose() * by.with_depth * 0.5;
        for k in 0..3 {
            g_v[(k, 2)] += depth_column[k];
            g_v[(2, k)] += depth_column[k];
        }
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

    fn without_shutter(
        &self,
        config: &RenderConfig,
        gradient: &FootprintGradient,
    ) -> WithoutShutter {
        let by_slope = self.slope.backward(&gradient.slope);
        let q = self.conic;
        let mut g = by_slope.covariance - q * gradient.conic * q;
        if !self.is_bounded {
            let (rho, det) = (self.compensation, q.determinant());
            let by_rho = gradient.opacity * self.opacity / rho;
            let dilation = f64::from(config.dilation_px2);
            let inner = q * (1.0 - rho * rho) - Matrix2::identity() * (dilation * det);
            g += inner * (0.5 * by_rho / rho);
        }
        let Some(r) = &self.rolling else {
            return WithoutShutter {
                mean: gradient.mean,
                covariance: g,
                with_depth: by_slope.with_depth,
                jacobian: Matrix2x3::zeros(),
                point: Vector3::z() * (gradient.z + by_slope.z),
            };
        };
        let moving = Matrix2::identity() + r.v * r.g.transpose() * r.stretch;
        let g_mean = moving.transpose() * gradient.mean;
        let g_covariance = moving.transpose() * g * moving;
        let g_moving = 2.0 * g * moving * self.still_covariance
            + by_slope.with_depth * self.still_with_depth.transpose();
        let change = r.g * (r.stretch * r.stretch);
        let g_velocity = gradient.mean * (r.stretch * r.time)
            + change * (r.time * gradient.mean.dot(&r.v))
            + g_moving * r.g * r.stretch
            + change * r.v.dot(&(g_moving * r.g));
        let g_jacobian = -g_velocity * r.u.transpose();
        let g_u: Vector3<f64> = -self.linear.jacobian.transpose() * g_velocity;
        WithoutShutter {
            mean: g_mean,
            covariance: g_covariance,
            with_depth: moving.transpose() * by_slope.with_depth,
            jacobian: g_jacobian,
            point: g_u.cross(&r.rate) + Vector3::z() * (gradient.z + by_slope.z),
        }
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
