//! Solution of small linear systems.

/// Solves symmetric positive definite equations by elimination, for several right sides.
pub(crate) fn solve<const N: usize, const R: usize>(
    mut matrix: [[f64; N]; N],
    mut sides: [[f64; N]; R],
) -> [[f64; N]; R] {
    for k in 0..N {
        let pivot = matrix[k];
        for i in k + 1..N {
            let factor = matrix[i][k] / pivot[k];
            for (value, above) in matrix[i].iter_mut().zip(pivot) {
                *value -= factor * above;
            }
            for side in &mut sides {
                side[i] -= factor * side[k];
            }
        }
    }
    for side in &mut sides {
        for k in (0..N).rev() {
            let known: f64 = (k + 1..N).map(|j| matrix[k][j] * side[j]).sum();
            side[k] = (side[k] - known) / matrix[k][k];
        }
    }
    sides
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn solutions_fulfill_the_equations() {
        let matrix = [[4.0, 1.0, -0.5], [1.0, 3.0, 0.25], [-0.5, 0.25, 2.0]];
        let expected = [[1.0, -2.0, 0.5], [0.0, 3.0, -1.0]];
        let times = |x: [f64; 3]| matrix.map(|row| (0..3).map(|k| row[k] * x[k]).sum::<f64>());
        for (found, expected) in solve(matrix, expected.map(times)).iter().zip(expected) {
            for (a, b) in found.iter().zip(expected) {
                assert!((a - b).abs() < 1e-12, "{a} {b}");
            }
        }
    }
}
