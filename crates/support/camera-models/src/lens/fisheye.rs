//! Equidistant fisheye with four terms (Kannala and Brandt 2006; OpenCV's `fisheye`): `θ_d = θ (1 +
//! k1 θ² + k2 θ⁴ + k3 θ⁶ + k4 θ⁸)`, θ the angle off the axis, up to π.
//!
//! The domain ends where `θ_d` is no longer increasing.

use std::f64::consts::PI;

use nalgebra::Matrix2x3;

use super::distorted::{ByCoefficients, DistortedPoint};
use super::domain::end_of_domain;

/// Ratio of radius and depth below which series replace quotients by 0.
const MIN_OFF_AXIS: f64 = 1e-9;

#[derive(Clone, Copy, Debug)]
pub(super) struct Fisheye {
    k: [f64; 4],
    widest_rad: f64,
}

impl Fisheye {
    pub(super) fn new(k: [f64; 4]) -> Self {
        let mut fisheye = Self { k, widest_rad: PI };
        fisheye.widest_rad = end_of_domain(PI, |angle| fisheye.slope(angle) > 0.0);
        fisheye
    }

    pub(super) fn widest_rad(&self) -> f64 {
        self.widest_rad
    }

    fn distorted_angle(&self, angle: f64) -> f64 {
        let [k1, k2, k3, k4] = self.k;
        let s = angle * angle;
        angle * (1.0 + s * (k1 + s * (k2 + s * (k3 + s * k4))))
    }

    fn slope(&self, angle: f64) -> f64 {
        let [k1, k2, k3, k4] = self.k;
        let s = angle * angle;
        1.0 + s * (3.0 * k1 + s * (5.0 * k2 + s * (7.0 * k3 + s * 9.0 * k4)))
    }

    pub(super) fn distort(&self, [x, y, z]: [f64; 3]) -> Option<[f64; 2]> {
        let r = x.hypot(y);
        let angle = r.atan2(z);
        let inside = angle <= self.widest_rad && (r > 0.0 || z > 0.0);
        if !inside {
            return None;
        }
        let scale = if r < MIN_OFF_AXIS * z {
            1.0 / z
        } else {
            self.distorted_angle(angle) / r
        };
        Some([x * scale, y * scale])
    }

    pub(super) fn distort_with_jacobians(&self, point: [f64; 3]) -> Option<DistortedPoint> {
        let at = self.distort(point)?;
        let [x, y, z] = point;
        let r = x.hypot(y);
        let mut by_coefficients = ByCoefficients::zeros();
        if r < MIN_OFF_AXIS * z {
            let by_point = Matrix2x3::new(1.0 / z, 0.0, -x / (z * z), 0.0, 1.0 / z, -y / (z * z));
            return Some(DistortedPoint {
                at,
                by_point,
                by_coefficients,
            });
        }
        let angle = r.atan2(z);
        let (cosine, sine) = (x / r, y / r);
        let scale = self.distorted_angle(angle) / r;
        let slope = self.slope(angle);
        let square = r * r + z * z;
        // Radial and tangential direction; the angle changes by z/(r²+z²) per radius, -r/(r²+z²)
        // per depth.
        let along = slope * z / square;
        let by_depth = -slope * r / square;
        let by_point = Matrix2x3::new(
            along * cosine * cosine + scale * sine * sine,
            (along - scale) * cosine * sine,
            by_depth * cosine,
            (along - scale) * cosine * sine,
            along * sine * sine + scale * cosine * cosine,
            by_depth * sine,
        );
        let mut power = angle;
        for k in 0..4 {
            power *= angle * angle;
            by_coefficients[(0, k)] = cosine * power;
            by_coefficients[(1, k)] = sine * power;
        }
        Some(DistortedPoint {
            at,
            by_point,
            by_coefficients,
        })
    }

    pub(super) fn undistort(&self, [x, y]: [f64; 2]) -> Option<[f64; 3]> {
        let goal = x.hypot(y);
        if goal == 0.0 {
            return Some([0.0, 0.0, 1.0]);
        }
        let (mut low, mut high) = (0.0, self.widest_rad);
        if goal.is_nan() || goal > self.distorted_angle(high) {
            return None;
        }
        // Newton's method, bracketed by an interval with the root: θ_d increases over the domain.
        let mut angle = goal.min(0.5 * (low + high));
        for _ in 0..60 {
            let excess = self.distorted_angle(angle) - goal;
            if excess.abs() < 1e-15 * goal.max(1.0) {
                break;
            }
            if excess > 0.0 {
                high = angle;
            } else {
                low = angle;
            }
            let next = angle - excess / self.slope(angle);
            angle = if next > low && next < high {
                next
            } else {
                0.5 * (low + high)
            };
        }
        let (sine, cosine) = angle.sin_cos();
        Some([sine * x / goal, sine * y / goal, cosine])
    }
}
