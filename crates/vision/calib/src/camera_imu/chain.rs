//! Least squares over a chain of states with shared parameters.
//!
//! The normal equations are block tridiagonal with a border: state `i` is connected with `i + 1`
//! and the `B` shared parameters, with nothing else. Block Cholesky eliminates the states in order;
//! what remains is the information matrix of the shared parameters. Time and memory grow linearly
//! with the number of states. Covariances of single states, of neighbours and of states with
//! parameters come from the factor by the recursion of Takahashi, Fagan and Chin (1973), in linear
//! time.

use nalgebra::{Cholesky, Const, SMatrix, SVector};

/// Normal equations `H x = -g` of `n` states of dimension `N` and `B` shared parameters.
#[derive(Clone, Debug)]
pub(super) struct Chain<const N: usize, const B: usize> {
    /// Diagonal blocks of the states.
    pub own: Vec<SMatrix<f64, N, N>>,
    /// Blocks of state `i` with `i + 1`; one fewer.
    pub next: Vec<SMatrix<f64, N, N>>,
    /// Blocks of the states with the shared parameters.
    pub border: Vec<SMatrix<f64, N, B>>,
    /// Block of the shared parameters.
    pub shared: SMatrix<f64, B, B>,
    /// Gradients with respect to the states.
    pub own_gradient: Vec<SVector<f64, N>>,
    /// Gradient with respect to the shared parameters.
    pub shared_gradient: SVector<f64, B>,
}

/// Step of each state and of the shared parameters.
pub(super) struct Step<const N: usize, const B: usize> {
    pub own: Vec<SVector<f64, N>>,
    pub shared: SVector<f64, B>,
}

/// Covariance blocks that the factors need.
pub(super) struct Covariance<const N: usize, const B: usize> {
    pub own: Vec<SMatrix<f64, N, N>>,
    /// State `i` with `i + 1`.
    pub next: Vec<SMatrix<f64, N, N>>,
    pub border: Vec<SMatrix<f64, N, B>>,
    pub shared: SMatrix<f64, B, B>,
}

/// Cholesky factor: rows `[C', U, V]` of each state and the remainder for the shared parameters.
pub(super) struct Factor<const N: usize, const B: usize> {
    own: Vec<Cholesky<f64, Const<N>>>,
    next: Vec<SMatrix<f64, N, N>>,
    border: Vec<SMatrix<f64, N, B>>,
    shared: Cholesky<f64, Const<B>>,
    own_right: Vec<SVector<f64, N>>,
    shared_right: SVector<f64, B>,
}

impl<const N: usize, const B: usize> Chain<N, B> {
    pub(super) fn new(states: usize) -> Self {
        Self {
            own: vec![SMatrix::zeros(); states],
            next: vec![SMatrix::zeros(); states.saturating_sub(1)],
            border: vec![SMatrix::zeros(); states],
            shared: SMatrix::zeros(),
            own_gradient: vec![SVector::zeros(); states],
            shared_gradient: SVector::zeros(),
        }
    }

    /// Adds a whitened residual of dimension `M` with its Jacobians with respect to state `i`,
    /// state `i + 1` if there is one, and the shared parameters.
    pub(super) fn add<const M: usize>(
        &mut self,
        i: usize,
        residual: &SVector<f64, M>,
        by_own: &SMatrix<f64, M, N>,
        by_next: Option<&SMatrix<f64, M, N>>,
        by_shared: &SMatrix<f64, M, B>,
    ) {
        let own = by_own.transpose();
        self.own[i] += own * by_own;
        self.border[i] += own * by_shared;
        self.own_gradient[i] += own * residual;
        if let Some(by_next) = by_next {
            let next = by_next.transpose();
            self.next[i] += own * by_next;
            self.own[i + 1] += next * by_next;
            self.border[i + 1] += next * by_shared;
            self.own_gradient[i + 1] += next * residual;
        }
        let shared = by_shared.transpose();
        self.shared += shared * by_shared;
        self.shared_gradient += shared * residual;
    }

    /// Factorizes `H + damping diag(H)`; `None` if that is not positive definite.
    pub(super) fn factor(&self, damping: f64) -> Option<Factor<N, B>> {
        let n = self.own.len();
        let mut factor = Factor {
            own: Vec::with_capacity(n),
            next: Vec::with_capacity(n),
            border: Vec::with_capacity(n),
            shared: Cholesky::new(SMatrix::identity())?,
            own_right: Vec::with_capacity(n),
            shared_right: SVector::zeros(),
        };
        let mut shared = damped(&self.shared, damping);
        let mut shared_right = -self.shared_gradient;
        for i in 0..n {
            let mut own = damped(&self.own[i], damping);
            let mut border = self.border[i];
            let mut right = -self.own_gradient[i];
            if i > 0 {
                let above: &SMatrix<f64, N, N> = &factor.next[i - 1];
                let above = above.transpose();
                own -= above * factor.next[i - 1];
                border -= above * factor.border[i - 1];
                right -= above * factor.own_right[i - 1];
            }
            let own = Cholesky::new(own)?;
            let lower = own.l_dirty();
            lower.solve_lower_triangular_mut(&mut border);
            lower.solve_lower_triangular_mut(&mut right);
            if i + 1 < n {
                let mut next = self.next[i];
                lower.solve_lower_triangular_mut(&mut next);
                factor.next.push(next);
            }
            let transposed = border.transpose();
            shared -= transposed * border;
            shared_right -= transposed * right;
            factor.own.push(own);
            factor.border.push(border);
            factor.own_right.push(right);
        }
        factor.shared = Cholesky::new(shared)?;
        factor.shared_right = shared_right;
        Some(factor)
    }
}

fn damped<const K: usize>(matrix: &SMatrix<f64, K, K>, damping: f64) -> SMatrix<f64, K, K> {
    let mut out = *matrix;
    for k in 0..K {
        out[(k, k)] *= 1.0 + damping;
    }
    out
}

impl<const N: usize, const B: usize> Factor<N, B> {
    /// Solution of the normal equations.
    pub(super) fn step(&self) -> Step<N, B> {
        let shared = self.shared.solve(&self.shared_right);
        let n = self.own.len();
        let mut own = vec![SVector::zeros(); n];
        for i in (0..n).rev() {
            let mut right = self.own_right[i] - self.border[i] * shared;
            if i + 1 < n {
                right -= self.next[i] * own[i + 1];
            }
            self.own[i]
                .l_dirty()
                .tr_solve_lower_triangular_mut(&mut right);
            own[i] = right;
        }
        Step { own, shared }
    }

    /// Covariance blocks.
    pub(super) fn covariance(&self) -> Covariance<N, B> {
        let n = self.own.len();
        let shared = self.shared.inverse();
        let mut own = vec![SMatrix::zeros(); n];
        let mut next = vec![SMatrix::zeros(); n.saturating_sub(1)];
        let mut border: Vec<SMatrix<f64, N, B>> = vec![SMatrix::zeros(); n];
        for i in (0..n).rev() {
            let lower = self.own[i].l_dirty();
            let mut to_shared = self.border[i];
            lower.tr_solve_lower_triangular_mut(&mut to_shared);
            border[i] = -to_shared * shared;
            own[i] = self.own[i].inverse();
            if i + 1 < n {
                let mut to_next = self.next[i];
                lower.tr_solve_lower_triangular_mut(&mut to_next);
                let beyond = border[i + 1];
                border[i] -= to_next * beyond;
                next[i] = -to_next * own[i + 1] - to_shared * beyond.transpose();
                own[i] -= next[i] * to_next.transpose();
            }
            let with_shared = border[i];
            own[i] -= with_shared * to_shared.transpose();
        }
        Covariance {
            own,
            next,
            border,
            shared,
        }
    }
}

impl<const N: usize, const B: usize> Covariance<N, B> {
    /// Leverage of a residual of dimension `M`: the trace of `J P J'`.
    pub(super) fn leverage<const M: usize>(
        &self,
        i: usize,
        by_own: &SMatrix<f64, M, N>,
        by_next: Option<&SMatrix<f64, M, N>>,
        by_shared: &SMatrix<f64, M, B>,
    ) -> [f64; M] {
        // J P, one block of columns at a time.
        let mut own = by_own * self.own[i] + by_shared * self.border[i].transpose();
        let mut shared = by_own * self.border[i] + by_shared * self.shared;
        let mut rest = [0.0; M];
        if let Some(by_next) = by_next {
            own += by_next * self.next[i].transpose();
            shared += by_next * self.border[i + 1];
            let next = by_own * self.next[i]
                + by_next * self.own[i + 1]
                + by_shared * self.border[i + 1].transpose();
            rest = std::array::from_fn(|m| next.row(m).dot(&by_next.row(m)));
        }
        std::array::from_fn(|m| {
            rest[m] + own.row(m).dot(&by_own.row(m)) + shared.row(m).dot(&by_shared.row(m))
        })
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::{DMatrix, DVector};

    use super::*;

    const N: usize = 3;
    const B: usize = 2;

    /// A chain of synthetic residuals, and the same as one dense matrix.
    fn example(states: usize) -> (Chain<N, B>, DMatrix<f64>, DVector<f64>) {
        let size = states * N + B;
        let mut chain = Chain::new(states);
        let mut dense = DMatrix::zeros(size, size);
        let mut gradient = DVector::zeros(size);
        let mut seed = 1_u32;
        let mut draw = || {
            seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(seed >> 8) / f64::from(1 << 24) - 0.5
        };
        for i in 0..states {
            let residual = SVector::<f64, 4>::from_fn(|_, _| draw());
            let own = SMatrix::<f64, 4, N>::from_fn(|_, _| draw());
            let next = SMatrix::<f64, 4, N>::from_fn(|_, _| draw());
            let shared = SMatrix::<f64, 4, B>::from_fn(|_, _| draw());
            let next = (i + 1 < states).then_some(&next);
            chain.add(i, &residual, &own, next, &shared);
            let mut row = DMatrix::zeros(4, size);
            row.view_mut((0, i * N), (4, N)).copy_from(&own);
            if let Some(next) = next {
                row.view_mut((0, (i + 1) * N), (4, N)).copy_from(next);
            }
            row.view_mut((0, states * N), (4, B)).copy_from(&shared);
            dense += row.transpose() * &row;
            gradient += row.transpose() * DVector::from_iterator(4, residual.iter().copied());
        }
        (chain, dense, gradient)
    }

    #[test]
    fn agrees_with_the_dense_solution() {
        let states = 7;
        let (chain, dense, gradient) = example(states);
        let factor = chain.factor(0.0).unwrap();
        let expected = dense.clone().cholesky().unwrap().solve(&-gradient);
        let step = factor.step();
        for i in 0..states {
            for k in 0..N {
                assert!((step.own[i][k] - expected[i * N + k]).abs() < 1e-8);
            }
        }
        for k in 0..B {
            assert!((step.shared[k] - expected[states * N + k]).abs() < 1e-8);
        }
        let inverse = dense.try_inverse().unwrap();
        let found = factor.covariance();
        let near = |found: DMatrix<f64>, row: usize, column: usize| {
            let expected = inverse.view((row, column), found.shape());
            assert!((expected - &found).amax() < 1e-7 * inverse.amax());
        };
        let dynamic =
            |m: &[f64], rows: usize, columns: usize| DMatrix::from_column_slice(rows, columns, m);
        for i in 0..states {
            near(dynamic(found.own[i].as_slice(), N, N), i * N, i * N);
            near(dynamic(found.border[i].as_slice(), N, B), i * N, states * N);
            if i + 1 < states {
                near(dynamic(found.next[i].as_slice(), N, N), i * N, (i + 1) * N);
            }
        }
        near(
            dynamic(found.shared.as_slice(), B, B),
            states * N,
            states * N,
        );
    }
}
