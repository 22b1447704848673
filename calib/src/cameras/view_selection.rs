//! Which instants are worth using.
//!
//! Contract: of the instants at which the rig was still, those are taken one after the other that tell
//! most that is not known yet: each raises the determinant of the information of what is to be found by
//! the most (greedy D-optimality; what an instant adds only shrinks as others are taken, so that stale
//! gains are bounds and most need not be computed anew, Minoux 1978). Views that show the border of the
//! picture, tilted boards and other distances come first by themselves, blurred ones last.

use nalgebra::DMatrix;

use crate::adjust::{Problem, reduced_equations};

/// Instants in the order in which they are worth taking, at most `most`. `prior` is the information
/// that is there before, in the order of the problem's parameters.
pub(super) fn select_greedy(problem: &Problem, prior: &DMatrix<f64>, most: usize) -> Vec<usize> {
    let n = prior.nrows();
    let candidates: Vec<DMatrix<f64>> = reduced_equations(problem, 1.0)
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

/// The candidate that adds most, and how much. Those taken have a bound below everything.
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
