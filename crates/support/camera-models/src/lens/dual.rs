//! Reference implementation with dual numbers: the models as written in their papers, so that
//! derivatives come from the rules of differentiation and not from formulas of ours.

use std::ops::{Add, Div, Mul, Sub};

use crate::camera::{CameraModel, Distortion};

/// Point and parameters of the largest model.
pub(super) const INPUTS: usize = 3 + CameraModel::MAX_PARAMETERS;

/// A value and its derivatives with respect to all inputs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Dual {
    pub(super) value: f64,
    pub(super) by: [f64; INPUTS],
}

impl Dual {
    fn constant(value: f64) -> Self {
        Self {
            value,
            by: [0.0; INPUTS],
        }
    }

    fn input(value: f64, number: usize) -> Self {
        let mut dual = Self::constant(value);
        dual.by[number] = 1.0;
        dual
    }

    fn map(self, value: f64, slope: f64) -> Self {
        Self {
            value,
            by: self.by.map(|d| d * slope),
        }
    }

    fn sqrt(self) -> Self {
        let root = self.value.sqrt();
        self.map(root, 0.5 / root)
    }

    /// The angle whose tangent is `self / x`.
    fn atan2(self, x: Self) -> Self {
        let square = self.value * self.value + x.value * x.value;
        let by = std::array::from_fn(|i| (x.value * self.by[i] - self.value * x.by[i]) / square);
        Self {
            value: self.value.atan2(x.value),
            by,
        }
    }
}

impl Add for Dual {
    type Output = Self;
    fn add(self, b: Self) -> Self {
        Self {
            value: self.value + b.value,
            by: std::array::from_fn(|i| self.by[i] + b.by[i]),
        }
    }
}

impl Sub for Dual {
    type Output = Self;
    fn sub(self, b: Self) -> Self {
        self + b.map(-b.value, -1.0)
    }
}

impl Mul for Dual {
    type Output = Self;
    #[expect(clippy::suspicious_arithmetic_impl, reason = "the product rule adds")]
    fn mul(self, b: Self) -> Self {
        Self {
            value: self.value * b.value,
            by: std::array::from_fn(|i| self.by[i] * b.value + self.value * b.by[i]),
        }
    }
}

impl Div for Dual {
    type Output = Self;
    fn div(self, b: Self) -> Self {
        self * b.map(1.0 / b.value, -1.0 / (b.value * b.value))
    }
}

/// The pixel of a point, whether or not it is in the domain of the model.
pub(super) fn project(model: &CameraModel, point: [f64; 3]) -> [Dual; 2] {
    let [x, y, z] = std::array::from_fn(|i| Dual::input(point[i], i));
    let parameters = model.parameters();
    let p: Vec<Dual> = (0..parameters.len())
        .map(|i| Dual::input(parameters[i], 3 + i))
        .collect();
    let (focal, centre, c) = (&p[..2], &p[2..4], &p[4..]);
    let [one, two, three] = [1.0, 2.0, 3.0].map(Dual::constant);
    let (a, b) = match model.distortion {
        Distortion::DoubleSphere { .. } => {
            let (xi, alpha) = (c[0], c[1]);
            let d1 = (x * x + y * y + z * z).sqrt();
            let d2 = (x * x + y * y + (xi * d1 + z) * (xi * d1 + z)).sqrt();
            let n = alpha * d2 + (one - alpha) * (xi * d1 + z);
            (x / n, y / n)
        }
        Distortion::Eucm { .. } => {
            let (alpha, beta) = (c[0], c[1]);
            let n = alpha * (beta * (x * x + y * y) + z * z).sqrt() + (one - alpha) * z;
            (x / n, y / n)
        }
        Distortion::KannalaBrandt4 { .. } => {
            let r = (x * x + y * y).sqrt();
            let t = r.atan2(z);
            let powers = (0..4).map(|k| (0..2 * k + 3).fold(one, |product, _| product * t));
            let bent = powers.zip(c).fold(t, |sum, (power, &k)| sum + k * power);
            (bent * x / r, bent * y / r)
        }
        _ => {
            // OpenCV's documentation of calib3d.
            let (a, b) = (x / z, y / z);
            let r2 = a * a + b * b;
            let k = |i: usize| c.get(i).copied().unwrap_or(Dual::constant(0.0));
            // Radial2 has no tangential terms between its radial ones and the others.
            let radial = (one + k(0) * r2 + k(1) * r2 * r2 + k(4) * r2 * r2 * r2)
                / (one + k(5) * r2 + k(6) * r2 * r2 + k(7) * r2 * r2 * r2);
            let (p1, p2) = (k(2), k(3));
            (
                a * radial + two * p1 * a * b + p2 * (three * a * a + b * b),
                b * radial + p1 * (a * a + three * b * b) + two * p2 * a * b,
            )
        }
    };
    [focal[0] * a + centre[0], focal[1] * b + centre[1]]
}
