//! Real spherical harmonics up to degree 3, in the order and with the signs of 3DGS files.
//!
//! A color is `max(0, 1/2 + Σ_k Y_k(d) f_k)`, with `d` the unit direction from the camera to the
//! Gaussian, in the world.

mod monomials;

pub use monomials::values;

use nalgebra::{DMatrix, UnitQuaternion, Vector3};

/// `Y_0`, the constant harmonic: `1 / (2 √π)`.
pub const CONSTANT: f32 = 0.282_094_8;

/// The coefficient of the constant harmonic of a color that is the same from all sides.
pub fn from_color(color: f32) -> f32 {
    (color - 0.5) / CONSTANT
}

/// The color of a coefficient of the constant harmonic, where no other is present.
pub fn to_color(coefficient: f32) -> f32 {
    coefficient * CONSTANT + 0.5
}

/// Coefficients of the harmonics of one degree after a rotation of the scene, from those before.
pub(crate) fn rotation_of_band(degree: usize, turn: &UnitQuaternion<f64>) -> DMatrix<f64> {
    let (first, size) = (degree * degree, 2 * degree + 1);
    let directions: Vec<Vector3<f64>> = (0..size).map(spiral).collect();
    let values = |turn: &UnitQuaternion<f64>| {
        DMatrix::from_fn(size, size, |row, k| {
            values(turn * directions[row], first + size)[first + k].0
        })
    };
    let after = values(turn).try_inverse();
    after.expect("a band has full rank in these directions") * values(&UnitQuaternion::identity())
}

/// Directions in which the harmonics of degrees 1 to 3 are independent.
fn spiral(k: usize) -> Vector3<f64> {
    let (z, angle) = (0.9 - 0.23 * k as f64, 2.4 * k as f64);
    let radius = (1.0_f64 - z * z).sqrt();
    Vector3::new(radius * libm::cos(angle), radius * libm::sin(angle), z)
}
