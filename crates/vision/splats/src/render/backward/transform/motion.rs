//! Gradients with respect to the motion of the camera.

use crate::lanes::Lanes;
use crate::render::geometry::{Linear, Placement, dot};

/// Row times the transpose of a matrix.
#[inline(always)]
pub(super) fn times_transposed<V: Lanes>(row: &[V; 3], matrix: &[[V; 3]; 3]) -> [V; 3] {
    [
        dot(row, &matrix[0]),
        dot(row, &matrix[1]),
        dot(row, &matrix[2]),
    ]
}

/// Gradients with respect to the camera's motion `p → p - v - ω × p`.
#[inline(always)]
pub(super) fn motion<V: Lanes>(
    place: &Placement<V>,
    linear: &Linear<V>,
    rotation: &[[V; 3]; 3],
    by_camera: &[[V; 3]; 3],
    by_point: &[V; 3],
    by_direction: &[V; 3],
) -> [V; 6] {
    let p = &place.p;
    let turned = times_transposed(by_direction, rotation);
    let [j, h] = &linear.jacobian;
    let [m, n, d] = by_camera;
    // Rotation of the covariance: antisymmetric part of the Jacobian and its gradient; the row of
    // the Jacobian that is depth is 0 0 1.
    let twist = [
        m[2] * j[1] + n[2] * h[1] - m[1] * j[2] - n[1] * h[2] - d[1],
        d[0] + m[0] * j[2] + n[0] * h[2] - m[2] * j[0] - n[2] * h[0],
        m[1] * j[0] + n[1] * h[0] - m[0] * j[1] - n[0] * h[1],
    ];
    [
        -(by_point[0] + turned[0]),
        -(by_point[1] + turned[1]),
        -(by_point[2] + turned[2]),
        twist[0] - (p[1] * by_point[2] - p[2] * by_point[1]),
        twist[1] - (p[2] * by_point[0] - p[0] * by_point[2]),
        twist[2] - (p[0] * by_point[1] - p[1] * by_point[0]),
    ]
}
