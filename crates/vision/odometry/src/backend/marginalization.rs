//! Marginalization of a frame of the window.
//!
//! The information of the frame and of the landmarks that it hosts becomes a quadratic prior on the
//! errors of the remaining frames (Schur complement). Its observations of landmarks with other
//! hosts are dropped: they would connect landmarks to the prior. Unobservable directions of the
//! frame contribute nothing.

use nalgebra::{DMatrix, DVector, MatrixXx3, SMatrix, SymmetricEigen};

use crate::backend::gyro_scale::{Border, GyroScale};
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
    // Rows that remain: those of the other frames, followed by those of calibrations.
    let rows: Vec<usize> = (0..linear.gradient.len())
        .filter(|row| *row < leaving * STATE_DIM || *row >= (leaving + 1) * STATE_DIM)
        .collect();
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
    let across = DMatrix::from_fn(rows.len(), STATE_DIM, |i, j| {
        linear.information[(rows[i], at + j)]
    });
    let mut information = DMatrix::from_fn(rows.len(), rows.len(), |i, j| {
        linear.information[(rows[i], rows[j])]
    });
    let mut gradient = DVector::from_fn(rows.len(), |i, _| linear.gradient[rows[i]]);
    let weighted = &across * inverse;
    information -= &weighted * across.transpose();
    let own_gradient = linear.gradient.rows(at, STATE_DIM);
    gradient -= &weighted * own_gradient;
    let mut border = linear.gyro_scale;
    let own_by = border.by.fixed_view::<STATE_DIM, 3>(at, 0).into_owned();
    let weighted_by = own_by.transpose() * inverse;
    border.information -= weighted_by * own_by;
    border.gradient -= weighted_by * own_gradient;
    border.by = border.by.select_rows(&rows) - &weighted * own_by;
    // Frames without a connection to the marginalized one are not part of the prior.
    let connected: Vec<usize> = (0..rest.len())
        .filter(|a| information.rows(a * STATE_DIM, STATE_DIM).amax() > 0.0)
        .collect();
    let frames = connected.len() * STATE_DIM;
    let calibrations_at = rest.len() * STATE_DIM;
    let pick = |k: usize| {
        if k < frames {
            connected[k / STATE_DIM] * STATE_DIM + k % STATE_DIM
        } else {
            calibrations_at + k - frames
        }
    };
    let count = frames + rows.len() - calibrations_at;
    let estimated = &window.cameras[..window.prior.stereo.len()];
    window.prior = Prior {
        at: connected
            .iter()
            .map(|a| {
                let frame = &window.frames[rest[*a]];
                (frame.number, frame.state)
            })
            .collect(),
        extrinsics: estimated.iter().map(|c| c.body_from_left).collect(),
        stereo: estimated.iter().map(|c| c.stereo.error).collect(),
        information: DMatrix::from_fn(count, count, |i, j| {
            0.5 * (information[(pick(i), pick(j))] + information[(pick(j), pick(i))])
        }),
        gradient: DVector::from_fn(count, |i, _| gradient[pick(i)]),
        gyro_scale: GyroScale {
            error: window.prior.gyro_scale.error,
            at: window.prior.gyro_scale.error,
            border: Border {
                by: MatrixXx3::from_fn(count, |i, j| border.by[(pick(i), j)]),
                ..border
            },
        },
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
