//! Depth of a Gaussian over its pixels, which is linear: `z + gᵀ (u - m)` with the slope g.
//!
//! With `N` the root of the covariance in the image and `n` that of the depth (the row of depth of
//! camera, axes and scales), pixel and depth of the Gaussian have the covariance `N n` under the
//! affine projection at its mean, so that the mean of the depth at a pixel has the slope
//! `(N Nᵀ + δ I)⁻¹ N n`: for a disc that of its plane. δ damps the slope of what is thinner than a
//! pixel. The bound is a factor on the slope where depth, within the ellipse of an opaque Gaussian,
//! would change by more than a share of `z - near`.

use super::geometry::{Shape, dot, row_times};
use super::view::View;
use crate::config::RenderConfig;
use crate::lanes::Lanes;

/// The root of the variance of depth, m.
#[inline(always)]
pub(super) fn depth_root<V: Lanes>(view: &View, axes: &[[V; 3]; 3], scale: &[V; 3]) -> [V; 3] {
    let [x, y, z] = view.rotation[2];
    let [a, b, c] = row_times(&[V::splat(x), V::splat(y), V::splat(z)], axes);
    [a * scale[0], b * scale[1], c * scale[2]]
}

/// Change of depth over the image, and what its gradient needs.
pub(super) struct Slope<V> {
    /// Along x and y, m/px.
    pub(super) value: [V; 2],
    /// Without the bound.
    free: [V; 2],
    /// The covariance in the image times that, m px.
    spread: [V; 2],
    /// Variance of depth over the Gaussian's pixels without the bound, m².
    variance: V,
    /// Mask: the bound holds.
    bounded: V,
    /// Factor of the bound.
    factor: V,
    /// `(N Nᵀ + δ I)⁻¹`: xx, xy, yy, px⁻².
    inverse: [V; 3],
}

/// Gradients of what a slope depends on.
pub(super) struct BySlope<V> {
    pub(super) root: [[V; 3]; 2],
    pub(super) depth_root: [V; 3],
    pub(super) z: V,
}

impl<V: Lanes> Slope<V> {
    /// `shape` is that of the root with the dilation of the image; z in m.
    #[inline(always)]
    pub(super) fn new(
        root: &[[V; 3]; 2],
        depth_root: &[V; 3],
        shape: &Shape<V>,
        z: V,
        (view, config): (&View, &RenderConfig),
    ) -> Self {
        let s = V::splat;
        let damped = Shape::new(root, config.slope_dilation_px2);
        let over = s(1.0) / damped.determinant;
        let [xx, xy, yy] = damped.covariance;
        let inverse = [yy * over, -xy * over, xx * over];
        let (x, y) = (dot(&root[0], depth_root), dot(&root[1], depth_root));
        let free = symmetric(&inverse, &[x, y]);
        let spread = symmetric(&shape.covariance, &free);
        let variance = free[0].mul_add(spread[0], free[1] * spread[1]);
        let deviation = variance.max(s(0.0)).sqrt();
        let limit = (z - s(config.near_m)) * s(view.slope_limit);
        let bounded = limit.less(deviation);
        let factor = bounded.select(limit / deviation, s(1.0));
        Self {
            value: [free[0] * factor, free[1] * factor],
            free,
            spread,
            variance,
            bounded,
            factor,
            inverse,
        }
    }

    /// From the gradient with respect to the slope.
    #[inline(always)]
    pub(super) fn backward(
        &self,
        by: &[V; 2],
        root: &[[V; 3]; 2],
        depth_root: &[V; 3],
        z: V,
        config: &RenderConfig,
    ) -> BySlope<V> {
        let (g, factor) = (&self.free, self.factor);
        let by_factor = by[0] * g[0] + by[1] * g[1];
        let through_bound = (factor * by_factor).and(self.bounded);
        let along = (through_bound / self.variance).and(self.bounded);
        let by_free = [
            factor * by[0] - along * self.spread[0],
            factor * by[1] - along * self.spread[1],
        ];
        let by_covariance = symmetric(&self.inverse, &by_free);
        let mut out = BySlope {
            root: *root,
            depth_root: *depth_root,
            z: through_bound / (z - V::splat(config.near_m)),
        };
        for k in 0..3 {
            let across = by_covariance[0] * root[0][k] + by_covariance[1] * root[1][k];
            let on_plane = g[0] * root[0][k] + g[1] * root[1][k];
            let beside = depth_root[k] - on_plane;
            let turned = along.mul_add(on_plane, across);
            for row in 0..2 {
                out.root[row][k] = by_covariance[row] * beside - g[row] * turned;
            }
            out.depth_root[k] = across;
        }
        out
    }
}

/// A symmetric matrix, xx, xy, yy, times a vector.
#[inline(always)]
fn symmetric<V: Lanes>(matrix: &[V; 3], [x, y]: &[V; 2]) -> [V; 2] {
    let [xx, xy, yy] = *matrix;
    [xx.mul_add(*x, xy * *y), xy.mul_add(*x, yy * *y)]
}
