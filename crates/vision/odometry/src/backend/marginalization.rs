//! Marginalization of a frame of the window.
//!
//! The information of the frame and of the landmarks that it hosts becomes a quadratic prior on the
//! errors of the remaining frames (Schur complement). Its observations of landmarks with other
//! hosts are dropped: they would connect landmarks to the prior. Unobservable directions of the
//! frame contribute nothing.

use nalgebra::{DMatrix, DVector, SMatrix, SymmetricEigen};

use crate::backend::solver::linearize;
use crate::backend::state::STATE_DIM;
use crate::backend::window::{Landmark, Prior, Window};

/// Fraction of the largest eigenvalue below which a direction is unobservable.
const MIN_EIGENVALUE_RATIO: f64 = 1e-14;

/// Marginalizes the frame with this index.
pub(crate) fn marginalize(window: &mut Window, leaving: usize) {
    let number = window.frames[leaving].number;
    let hosted: Vec<&Landmark> = window
        .landmarks
        .values()
        .filter(|l| l.observations[0].0 == number)
        .collect();
    let near = |motion: usize| motion == leaving || motion == leaving + 1;
    let linear = linearize(window, &hosted, near, 0.0);
    let rest: Vec<usize> = (0..window.frames.len()).filter(|k| *k != leaving).collect();
    let at = leaving * STATE_DIM;
    let own: SMatrix<f64, STATE_DIM, STATE_DIM> = linear
        .information
        .fixed_view::<STATE_DIM, STATE_DIM>(at, at)
        .into_owned();
    // Components of a state differ in scale by many powers of ten: they are normalized before
    // eigenvalues are compared.
    let scale = own
        .diagonal()
        .map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 1.0 });
    let scaled = SMatrix::from_diagonal(&scale) * own * SMatrix::from_diagonal(&scale);
    let eigen = SymmetricEigen::new(scaled);
    let min_eigenvalue = MIN_EIGENVALUE_RATIO * eigen.eigenvalues.amax();
    let inverse = eigen
        .eigenvalues
        .map(|e| if e > min_eigenvalue { 1.0 / e } else { 0.0 });
    let inverse = SMatrix::from_diagonal(&scale)
        * (eigen.eigenvectors * SMatrix::from_diagonal(&inverse) * eigen.eigenvectors.transpose())
        * SMatrix::from_diagonal(&scale);
    let size = rest.len() * STATE_DIM;
    let mut across = DMatrix::zeros(size, STATE_DIM);
    let mut information = DMatrix::zeros(size, size);
    let mut gradient = DVector::zeros(size);
    for (a, frame_a) in rest.iter().enumerate() {
        let block = linear
            .information
            .view((frame_a * STATE_DIM, at), (STATE_DIM, STATE_DIM));
        across
            .view_mut((a * STATE_DIM, 0), (STATE_DIM, STATE_DIM))
            .copy_from(&block);
        let rows = linear.gradient.rows(frame_a * STATE_DIM, STATE_DIM);
        gradient.rows_mut(a * STATE_DIM, STATE_DIM).copy_from(&rows);
        for (b, frame_b) in rest.iter().enumerate() {
            let block = linear.information.view(
                (frame_a * STATE_DIM, frame_b * STATE_DIM),
                (STATE_DIM, STATE_DIM),
            );
            information
                .view_mut((a * STATE_DIM, b * STATE_DIM), (STATE_DIM, STATE_DIM))
                .copy_from(&block);
        }
    }
    let weighted = &across * inverse;
    information -= &weighted * across.transpose();
    gradient -= &weighted * linear.gradient.rows(at, STATE_DIM);
    // Frames without a connection to the marginalized one are not part of the prior.
    let connected: Vec<usize> = (0..rest.len())
        .filter(|a| information.rows(a * STATE_DIM, STATE_DIM).amax() > 0.0)
        .collect();
    let pick = |k: usize| connected[k / STATE_DIM] * STATE_DIM + k % STATE_DIM;
    let count = connected.len() * STATE_DIM;
    window.prior = Prior {
        at: connected
            .iter()
            .map(|a| {
                let frame = &window.frames[rest[*a]];
                (frame.number, frame.state)
            })
            .collect(),
        information: DMatrix::from_fn(count, count, |i, j| {
            0.5 * (information[(pick(i), pick(j))] + information[(pick(j), pick(i))])
        }),
        gradient: DVector::from_fn(count, |i, _| gradient[pick(i)]),
    };
    window.landmarks.retain(|_, landmark| {
        let hosted = landmark.observations[0].0 == number;
        landmark.observations.retain(|(n, _)| *n != number);
        !hosted
    });
    window.frames.remove(leaving);
    if let Some(next) = window.frames.get_mut(leaving) {
        next.motion = None;
    }
}
