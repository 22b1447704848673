//! Product rule for the factors of the root of a covariance, and for the shear of a shutter.

use crate::lanes::Lanes;
use crate::render::geometry::{Linear, Shear, dot};

/// Gradients without the shutter.
pub(super) struct ByShear<V> {
    pub(super) mean: [V; 2],
    pub(super) root: [[V; 3]; 2],
    pub(super) jacobian: [[V; 3]; 2],
    pub(super) point: [V; 3],
}

impl<V: Lanes> Shear<V> {
    #[inline(always)]
    pub(super) fn backward(
        &self,
        mean: &[V; 2],
        by_root: &[[V; 3]; 2],
        still: &[[V; 3]; 2],
        linear: &Linear<V>,
        rate: [f32; 3],
    ) -> ByShear<V> {
        let (g, v, k) = (&self.gradient, &self.velocity, self.stretch);
        let along_mean = mean[0] * v[0] + mean[1] * v[1];
        let mut out = ByShear {
            mean: [
                mean[0] + k * g[0] * along_mean,
                mean[1] + k * g[1] * along_mean,
            ],
            root: *by_root,
            jacobian: linear.jacobian,
            point: self.u,
        };
        for c in 0..3 {
            let along = (v[0] * by_root[0][c] + v[1] * by_root[1][c]) * k;
            out.root[0][c] = g[0].mul_add(along, by_root[0][c]);
            out.root[1][c] = g[1].mul_add(along, by_root[1][c]);
        }
        // With respect to the shear's matrix, times the gradient of time.
        let mut by_shear = [V::splat(0.0); 2];
        for row in 0..2 {
            by_shear[row] =
                dot(&by_root[row], &still[0]) * g[0] + dot(&by_root[row], &still[1]) * g[1];
        }
        let along = self.time * along_mean + v[0] * by_shear[0] + v[1] * by_shear[1];
        let mut by_velocity = [V::splat(0.0); 2];
        for row in 0..2 {
            let direct = k * (self.time * mean[row] + by_shear[row]);
            by_velocity[row] = (k * k * g[row]).mul_add(along, direct);
        }
        for row in 0..2 {
            for c in 0..3 {
                out.jacobian[row][c] = -by_velocity[row] * self.u[c];
            }
        }
        let mut by_u = [V::splat(0.0); 3];
        for c in 0..3 {
            by_u[c] =
                -(linear.jacobian[0][c] * by_velocity[0] + linear.jacobian[1][c] * by_velocity[1]);
        }
        let [wx, wy, wz] = [V::splat(rate[0]), V::splat(rate[1]), V::splat(rate[2])];
        out.point = [
            by_u[1] * wz - by_u[2] * wy,
            by_u[2] * wx - by_u[0] * wz,
            by_u[0] * wy - by_u[1] * wx,
        ];
        out
    }
}

/// Gradients of the factors of the root.
pub(super) struct Factors<V> {
    /// Of the logarithms of the scales.
    pub(super) scale: [V; 3],
    pub(super) axes: [[V; 3]; 3],
    /// Of the lens's Jacobian and of the direction of depth in the axes of the world.
    pub(super) in_world: [[V; 3]; 3],
}

impl<V: Lanes> Factors<V> {
    #[inline(always)]
    pub(super) fn new(
        by_root: &[[V; 3]; 3],
        root: &[[V; 3]; 3],
        in_world: &[[V; 3]; 3],
        axes: &[[V; 3]; 3],
        scale: &[V; 3],
    ) -> Self {
        let mut out = Self {
            scale: *scale,
            axes: *axes,
            in_world: *in_world,
        };
        let mut scaled = *by_root;
        for k in 0..3 {
            out.scale[k] = by_root[0][k] * root[0][k]
                + by_root[1][k] * root[1][k]
                + by_root[2][k] * root[2][k];
            for row in 0..3 {
                scaled[row][k] = by_root[row][k] * scale[k];
            }
        }
        for j in 0..3 {
            for k in 0..3 {
                out.axes[j][k] = in_world[0][j] * scaled[0][k]
                    + in_world[1][j] * scaled[1][k]
                    + in_world[2][j] * scaled[2][k];
            }
            for row in 0..3 {
                out.in_world[row][j] = dot(&scaled[row], &axes[j]);
            }
        }
        out
    }
}

/// Gradient of a quaternion of any length from that of its matrix.
#[inline(always)]
pub(super) fn quaternion_gradient<V: Lanes>(quaternion: &[V; 4], g: &[[V; 3]; 3]) -> [V; 4] {
    let [w, x, y, z] = *quaternion;
    let square = w.mul_add(w, x.mul_add(x, y.mul_add(y, z * z)));
    let inverse = V::splat(1.0) / square.sqrt();
    let (w, x, y, z) = (w * inverse, x * inverse, y * inverse, z * inverse);
    let two = V::splat(2.0);
    let (a, b, c) = (g[2][1] - g[1][2], g[0][2] - g[2][0], g[1][0] - g[0][1]);
    let (d, e, f) = (g[1][0] + g[0][1], g[2][0] + g[0][2], g[2][1] + g[1][2]);
    let by = [
        two * (x * a + y * b + z * c),
        two * (y * d + z * e + w * a - two * x * (g[1][1] + g[2][2])),
        two * (x * d + z * f + w * b - two * y * (g[0][0] + g[2][2])),
        two * (x * e + y * f + w * c - two * z * (g[0][0] + g[1][1])),
    ];
    let along = by[0] * w + by[1] * x + by[2] * y + by[3] * z;
    [
        (by[0] - along * w) * inverse,
        (by[1] - along * x) * inverse,
        (by[2] - along * y) * inverse,
        (by[3] - along * z) * inverse,
    ]
}
