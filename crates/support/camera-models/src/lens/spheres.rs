//! Double sphere (Usenko, Demmel and Cremers, "The Double Sphere Camera Model", 2018) and extended
//! unified camera (Khomutenko, Garcia and Martinet 2016; formulas and domains after the former
//! paper).

use nalgebra::Matrix2x3;

use super::distorted::{ByCoefficients, DistortedPoint};
use super::domain::{end_of_domain, unit};

#[derive(Clone, Copy, Debug)]
pub(super) struct DoubleSphere {
    pub(super) xi: f64,
    pub(super) alpha: f64,
}

#[derive(Clone, Copy, Debug)]
pub(super) struct Eucm {
    pub(super) alpha: f64,
    pub(super) beta: f64,
}

/// `w` of both models' condition for a point to be in the domain.
fn weight(alpha: f64) -> f64 {
    if alpha <= 0.5 {
        alpha / (1.0 - alpha)
    } else {
        (1.0 - alpha) / alpha
    }
}

/// The quotient `(x, y) / n` with the derivatives of `n` with respect to the point and two
/// coefficients.
fn quotient(
    [x, y]: [f64; 2],
    n: f64,
    n_by_point: [f64; 3],
    n_by_coefficients: [f64; 2],
) -> DistortedPoint {
    let (a, b) = (x / n, y / n);
    let [nx, ny, nz] = n_by_point.map(|d| d / n);
    let by_point = Matrix2x3::new(
        1.0 / n - a * nx,
        -a * ny,
        -a * nz,
        -b * nx,
        1.0 / n - b * ny,
        -b * nz,
    );
    let mut by_coefficients = ByCoefficients::zeros();
    for (k, d) in n_by_coefficients.into_iter().enumerate() {
        by_coefficients[(0, k)] = -a * d / n;
        by_coefficients[(1, k)] = -b * d / n;
    }
    DistortedPoint {
        at: [a, b],
        by_point,
        by_coefficients,
    }
}

impl DoubleSphere {
    /// The two distances of the model, the depth between them, and the denominator.
    fn distances(&self, [x, y, z]: [f64; 3]) -> Option<(f64, f64, f64, f64)> {
        let d1 = (x * x + y * y + z * z).sqrt();
        let w1 = weight(self.alpha);
        let w2 = (w1 + self.xi) / (2.0 * w1 * self.xi + self.xi * self.xi + 1.0).sqrt();
        let inside = d1 > 0.0 && z > -w2 * d1;
        if !inside {
            return None;
        }
        let depth = self.xi * d1 + z;
        let d2 = (x * x + y * y + depth * depth).sqrt();
        let n = self.alpha * d2 + (1.0 - self.alpha) * depth;
        (n > 0.0).then_some((d1, d2, depth, n))
    }

    pub(super) fn distort(&self, point: [f64; 3]) -> Option<[f64; 2]> {
        let (.., n) = self.distances(point)?;
        Some([point[0] / n, point[1] / n])
    }

    pub(super) fn distort_with_jacobians(&self, point: [f64; 3]) -> Option<DistortedPoint> {
        let [x, y, z] = point;
        let (d1, d2, depth, n) = self.distances(point)?;
        let rest = 1.0 - self.alpha;
        let depth_by = [self.xi * x / d1, self.xi * y / d1, self.xi * z / d1 + 1.0];
        let along = self.alpha * depth / d2 + rest;
        let by_point = [
            self.alpha * x / d2 + along * depth_by[0],
            self.alpha * y / d2 + along * depth_by[1],
            along * depth_by[2],
        ];
        Some(quotient([x, y], n, by_point, [along * d1, d2 - depth]))
    }

    pub(super) fn undistort(&self, [x, y]: [f64; 2]) -> Option<[f64; 3]> {
        let s = x * x + y * y;
        let under_root = 1.0 - (2.0 * self.alpha - 1.0) * s;
        if under_root.is_nan() || under_root < 0.0 {
            return None;
        }
        let z = (1.0 - self.alpha * self.alpha * s)
            / (self.alpha * under_root.sqrt() + 1.0 - self.alpha);
        let root = z * z + (1.0 - self.xi * self.xi) * s;
        if root.is_nan() || root < 0.0 {
            return None;
        }
        let scale = (z * self.xi + root.sqrt()) / (z * z + s);
        let direction = unit([scale * x, scale * y, scale * z - self.xi])?;
        self.distances(direction).map(|_| direction)
    }

    pub(super) fn widest_rad(&self) -> f64 {
        end_of_domain(std::f64::consts::PI, |angle| {
            self.distances([angle.sin(), 0.0, angle.cos()]).is_some()
        })
    }
}

impl Eucm {
    /// The distance of the model and the denominator.
    fn distances(&self, [x, y, z]: [f64; 3]) -> Option<(f64, f64)> {
        let d = (self.beta * (x * x + y * y) + z * z).sqrt();
        let n = self.alpha * d + (1.0 - self.alpha) * z;
        (d > 0.0 && z > -weight(self.alpha) * d && n > 0.0).then_some((d, n))
    }

    pub(super) fn distort(&self, point: [f64; 3]) -> Option<[f64; 2]> {
        let (_, n) = self.distances(point)?;
        Some([point[0] / n, point[1] / n])
    }

    pub(super) fn distort_with_jacobians(&self, point: [f64; 3]) -> Option<DistortedPoint> {
        let [x, y, z] = point;
        let (d, n) = self.distances(point)?;
        let side = self.alpha * self.beta / d;
        let by_point = [side * x, side * y, self.alpha * z / d + 1.0 - self.alpha];
        let by_beta = self.alpha * (x * x + y * y) / (2.0 * d);
        Some(quotient([x, y], n, by_point, [d - z, by_beta]))
    }

    pub(super) fn undistort(&self, [x, y]: [f64; 2]) -> Option<[f64; 3]> {
        let s = x * x + y * y;
        let under_root = 1.0 - (2.0 * self.alpha - 1.0) * self.beta * s;
        if under_root.is_nan() || under_root < 0.0 {
            return None;
        }
        let z = (1.0 - self.beta * self.alpha * self.alpha * s)
            / (self.alpha * under_root.sqrt() + 1.0 - self.alpha);
        let direction = unit([x, y, z])?;
        self.distances(direction).map(|_| direction)
    }

    pub(super) fn widest_rad(&self) -> f64 {
        end_of_domain(std::f64::consts::PI, |angle| {
            self.distances([angle.sin(), 0.0, angle.cos()]).is_some()
        })
    }
}
