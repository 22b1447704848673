//! Spherical harmonics as a table of monomials: value and gradient follow from the same table.
//!
//! Source: the real harmonics with the Condon-Shortley phase (Sloan, Stupid Spherical Harmonics
//! Tricks, 2008, appendix A2); the fractions under the roots are written out.

use nalgebra::Vector3;
use std::f64::consts::PI;

/// One monomial: factor and exponents of x, y and z.
type Monomial = (f64, [i32; 3]);

/// Square of the constant of each harmonic, times π, and its polynomial.
const TABLE: [(f64, &[Monomial]); 16] = [
    (1.0 / 4.0, &[(1.0, [0, 0, 0])]),
    (3.0 / 4.0, &[(-1.0, [0, 1, 0])]),
    (3.0 / 4.0, &[(1.0, [0, 0, 1])]),
    (3.0 / 4.0, &[(-1.0, [1, 0, 0])]),
    (15.0 / 4.0, &[(1.0, [1, 1, 0])]),
    (15.0 / 4.0, &[(-1.0, [0, 1, 1])]),
    (
        5.0 / 16.0,
        &[(2.0, [0, 0, 2]), (-1.0, [2, 0, 0]), (-1.0, [0, 2, 0])],
    ),
    (15.0 / 4.0, &[(-1.0, [1, 0, 1])]),
    (15.0 / 16.0, &[(1.0, [2, 0, 0]), (-1.0, [0, 2, 0])]),
    (35.0 / 32.0, &[(-3.0, [2, 1, 0]), (1.0, [0, 3, 0])]),
    (105.0 / 4.0, &[(1.0, [1, 1, 1])]),
    (
        21.0 / 32.0,
        &[(-4.0, [0, 1, 2]), (1.0, [2, 1, 0]), (1.0, [0, 3, 0])],
    ),
    (
        7.0 / 16.0,
        &[(2.0, [0, 0, 3]), (-3.0, [2, 0, 1]), (-3.0, [0, 2, 1])],
    ),
    (
        21.0 / 32.0,
        &[(-4.0, [1, 0, 2]), (1.0, [3, 0, 0]), (1.0, [1, 2, 0])],
    ),
    (105.0 / 16.0, &[(1.0, [2, 0, 1]), (-1.0, [0, 2, 1])]),
    (35.0 / 32.0, &[(-1.0, [3, 0, 0]), (3.0, [1, 2, 0])]),
];

/// The first harmonics in a direction, each with its gradient.
pub fn values(d: Vector3<f64>, count: usize) -> Vec<(f64, Vector3<f64>)> {
    let power = |k: usize, e: i32| if e < 0 { 0.0 } else { d[k].powi(e) };
    let table = TABLE.iter().take(count);
    table
        .map(|(square, monomials)| {
            let constant = (square / PI).sqrt();
            let mut value = 0.0;
            let mut gradient = Vector3::zeros();
            for (factor, e) in *monomials {
                let factor = constant * factor;
                value += factor * (0..3).map(|k| power(k, e[k])).product::<f64>();
                for by in 0..3 {
                    let term = |k: usize| match k == by {
                        true => f64::from(e[k]) * power(k, e[k] - 1),
                        false => power(k, e[k]),
                    };
                    gradient[by] += factor * (0..3).map(term).product::<f64>();
                }
            }
            (value, gradient)
        })
        .collect()
}
