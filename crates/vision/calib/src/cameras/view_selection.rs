//! Selection of informative views.
//!
//! Contract: of the static instants, the one that raises the determinant of the information matrix
//! most is taken repeatedly (greedy D-optimality). The gain of an instant only shrinks as others
//! are taken, so that earlier gains are upper bounds and most need not be recomputed (Minoux 1978).
//! Views near the image border, tilted boards and other distances therefore come first, blurred
//! ones last.

use nalgebra::DMatrix;

use crate::adjust::{Config, Problem, reduced_equations};

/// Instants in the order of their gain, at most `most`. `prior` is the prior information matrix, in
/// the order of the problem's parameters.
pub(super) fn select_greedy(
    problem: &Problem,
    prior: &DMatrix<f64>,
    most: usize,
    config: &Config,
) -> Vec<usize> {
    let n = prior.nrows();
    let candidates: Vec<DMatrix<f64>> = reduced_equations(problem, 1.0, config)
        .into_iter()
        .map(|instant| {
            let mut all = DMatrix::zeros(n, n);
            for (i, &ci) in instant.columns.iter().enumerate() {
                for (j, &cj) in instant.columns.iter().enumerate() {
                    all[(ci, cj)] = instant.information[(i, j)];
                }
            }
            all
        })
        .collect();
    let mut known = prior.clone();
    let mut present = log_determinant(&known);
    let mut bounds = vec![f64::INFINITY; candidates.len()];
    let mut taken = Vec::new();
    while taken.len() < most.min(candidates.len()) {
        let Some((next, gain)) = most_informative(&candidates, &known, present, &mut bounds) else {
            break;
        };
        known += &candidates[next];
        present += gain;
        bounds[next] = f64::NEG_INFINITY;
        taken.push(next);
    }
    taken
}

/// The candidate with the largest gain, and its gain. Candidates already taken have a bound of -∞.
fn most_informative(
    candidates: &[DMatrix<f64>],
    known: &DMatrix<f64>,
    present: f64,
    bounds: &mut [f64],
) -> Option<(usize, f64)> {
    let mut fresh = vec![false; bounds.len()];
    loop {
        let next =
            (0..bounds.len()).max_by(|&a, &b| bounds[a].total_cmp(&bounds[b]).then(b.cmp(&a)))?;
        if bounds[next] == f64::NEG_INFINITY {
            return None;
        }
        if fresh[next] {
            return Some((next, bounds[next]));
        }
        bounds[next] = log_determinant(&(known + &candidates[next])) - present;
        fresh[next] = true;
    }
}

fn log_determinant(matrix: &DMatrix<f64>) -> f64 {
    let Some(cholesky) = matrix.clone().cholesky() else {
        return f64::NEG_INFINITY;
    };
    2.0 * cholesky.l().diagonal().iter().map(|d| d.ln()).sum::<f64>()
}
