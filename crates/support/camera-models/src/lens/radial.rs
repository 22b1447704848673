//! Pinhole with radial and tangential distortion: none, radial, radial-tangential, rational (Brown
//! 1966; OpenCV's `calib3d`).
//!
//! The domain ends where the distorted radius is no longer increasing with the radius, at the
//! latest 89.4 degrees off the axis. The small tangential terms are ignored for that.

use nalgebra::Matrix2x3;

use super::distorted::{ByCoefficients, DistortedPoint};
use super::domain::{end_of_domain, unit};
use crate::camera::Rational;

/// Maximum angle off the axis, rad.
const MAX_ANGLE_RAD: f64 = 1.56;
/// Newton's method has converged when the residual on the plane z = 1 is below this.
const CONVERGENCE: f64 = 1e-14;
/// Maximum residual of a valid inverse, relative to the distance from the axis.
const MAX_INVERSION_ERROR: f64 = 1e-10;

#[derive(Clone, Copy, Debug)]
pub(super) struct Radial {
    model: Rational,
    /// Number of coefficients of the model in OpenCV's order.
    count: usize,
    /// Squared radius on the plane z = 1 where the domain ends.
    limit: f64,
}

/// The radial factor `over / under` at a squared radius, with its derivative.
struct Factor {
    over: f64,
    under: f64,
    value: f64,
    slope: f64,
}

impl Radial {
    pub(super) fn new(model: Rational, coefficients: &[f64]) -> Self {
        let mut radial = Self {
            model,
            count: coefficients.len(),
            limit: f64::INFINITY,
        };
        let widest = end_of_domain(MAX_ANGLE_RAD, |angle| {
            let tangent = angle.tan();
            let s = tangent * tangent;
            let factor = radial.factor(s);
            // d(r g)/dr = g + 2 s g'
            factor.under > 0.0 && factor.value + 2.0 * s * factor.slope > 0.0
        });
        radial.limit = widest.tan().powi(2);
        radial
    }

    pub(super) fn widest_rad(&self) -> f64 {
        self.limit.sqrt().atan()
    }

    fn factor(&self, s: f64) -> Factor {
        let value = |[a, b, c]: [f64; 3]| 1.0 + s * (a + s * (b + s * c));
        let slope = |[a, b, c]: [f64; 3]| a + s * (2.0 * b + s * 3.0 * c);
        let (over, under) = (value(self.model.over), value(self.model.under));
        Factor {
            over,
            under,
            value: over / under,
            slope: (slope(self.model.over) * under - over * slope(self.model.under))
                / (under * under),
        }
    }

    /// The point on the plane z = 1, if it is inside the domain.
    fn on_plane(&self, [x, y, z]: [f64; 3]) -> Option<[f64; 2]> {
        let (a, b) = (x / z, y / z);
        (z > 0.0 && a * a + b * b <= self.limit).then_some([a, b])
    }

    fn apply_coefficients(&self, [a, b]: [f64; 2], factor: &Factor) -> [f64; 2] {
        let s = a * a + b * b;
        let [p1, p2] = self.model.tangential;
        [
            a * factor.value + 2.0 * p1 * a * b + p2 * (s + 2.0 * a * a),
            b * factor.value + p1 * (s + 2.0 * b * b) + 2.0 * p2 * a * b,
        ]
    }

    /// Jacobian of the distorted point with respect to the point on the plane, row-major.
    fn by_plane(&self, [a, b]: [f64; 2], factor: &Factor) -> [[f64; 2]; 2] {
        let [p1, p2] = self.model.tangential;
        let (g, h) = (factor.value, 2.0 * factor.slope);
        let mixed = a * b * h + 2.0 * p1 * a + 2.0 * p2 * b;
        [
            [g + a * a * h + 2.0 * p1 * b + 6.0 * p2 * a, mixed],
            [mixed, g + b * b * h + 6.0 * p1 * b + 2.0 * p2 * a],
        ]
    }

    pub(super) fn distort(&self, x_in_camera: [f64; 3]) -> Option<[f64; 2]> {
        let on_plane @ [a, b] = self.on_plane(x_in_camera)?;
        Some(self.apply_coefficients(on_plane, &self.factor(a * a + b * b)))
    }

    pub(super) fn distort_with_jacobians(&self, x_in_camera: [f64; 3]) -> Option<DistortedPoint> {
        let on_plane @ [a, b] = self.on_plane(x_in_camera)?;
        let s = a * a + b * b;
        let factor = self.factor(s);
        let inverse = 1.0 / x_in_camera[2];
        let [[xx, xy], [yx, yy]] = self.by_plane(on_plane, &factor);
        let by_point = Matrix2x3::new(
            xx * inverse,
            xy * inverse,
            -(xx * a + xy * b) * inverse,
            yx * inverse,
            yy * inverse,
            -(yx * a + yy * b) * inverse,
        );
        let over = 1.0 / factor.under;
        let under = -factor.over / (factor.under * factor.under);
        let powers = [s, s * s, s * s * s];
        // k1 k2 p1 p2 k3 k4 k5 k6
        let columns = [
            [a * over * powers[0], b * over * powers[0]],
            [a * over * powers[1], b * over * powers[1]],
            [2.0 * a * b, s + 2.0 * b * b],
            [s + 2.0 * a * a, 2.0 * a * b],
            [a * over * powers[2], b * over * powers[2]],
            [a * under * powers[0], b * under * powers[0]],
            [a * under * powers[1], b * under * powers[1]],
            [a * under * powers[2], b * under * powers[2]],
        ];
        let mut by_coefficients = ByCoefficients::zeros();
        for (k, [x, y]) in columns.into_iter().enumerate().take(self.count) {
            by_coefficients[(0, k)] = x;
            by_coefficients[(1, k)] = y;
        }
        Some(DistortedPoint {
            at: self.apply_coefficients(on_plane, &factor),
            by_point,
            by_coefficients,
        })
    }

    pub(super) fn undistort(&self, at: [f64; 2]) -> Option<[f64; 3]> {
        let [mut a, mut b] = self.first_guess(at);
        let mut miss = f64::INFINITY;
        for _ in 0..30 {
            let factor = self.factor(a * a + b * b);
            let [da, db] = self.apply_coefficients([a, b], &factor);
            let (ea, eb) = (at[0] - da, at[1] - db);
            miss = ea.abs().max(eb.abs());
            if miss < CONVERGENCE {
                break;
            }
            let [[xx, xy], [yx, yy]] = self.by_plane([a, b], &factor);
            let determinant = xx * yy - xy * yx;
            a += (ea * yy - eb * xy) / determinant;
            b += (eb * xx - ea * yx) / determinant;
        }
        (miss < MAX_INVERSION_ERROR * (1.0 + at[0].hypot(at[1])) && a * a + b * b <= self.limit)
            .then(|| unit([a, b, 1.0]))
            .flatten()
    }

    /// Inverse of the radial part alone, by bisection, so that Newton's method starts on the right
    /// side of the end of the domain.
    fn first_guess(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let goal = (x * x + y * y).sqrt();
        let distorted = |r: f64| r * self.factor(r * r).value;
        let (mut low, mut high) = (0.0, self.limit.sqrt());
        if distorted(high) <= goal {
            low = high;
        }
        // A twentieth of a percent is accurate enough as a start for Newton's method.
        while high - low > 5e-4 * high {
            let middle = 0.5 * (low + high);
            if distorted(middle) < goal {
                low = middle;
            } else {
                high = middle;
            }
        }
        let scale = if goal > 0.0 {
            0.5 * (low + high) / goal
        } else {
            0.0
        };
        [x * scale, y * scale]
    }
}
