//! A frame leaves the window; what it told stays.
//!
//! Everything that is known through the frame and the landmarks that it hosts becomes a quadratic in the errors of the frames
//! that remain (Schur complement). What the frame saw of landmarks with other hosts is given up: it would tie landmarks to the
//! prior. Directions of the leaving frame about which nothing is known take nothing with them.

use nalgebra::{DMatrix, DVector, SMatrix, SymmetricEigen};

use crate::solve::linearise;
use crate::state::SIZE;
use crate::window::{Landmark, Prior, Window};

/// Share of the largest eigenvalue below which nothing is known.
const NOTHING: f64 = 1e-14;

/// Takes the frame at this place out of the window.
pub(crate) fn marginalise(window: &mut Window, leaving: usize) {
    let number = window.frames[leaving].number;
    let hosted: Vec<&Landmark> = window
        .landmarks
        .values()
        .filter(|l| l.sights[0].0 == number)
        .collect();
    let near = |motion: usize| motion == leaving || motion == leaving + 1;
    let linear = linearise(window, &hosted, near, 0.0);
    let rest: Vec<usize> = (0..window.frames.len()).filter(|k| *k != leaving).collect();
    let at = leaving * SIZE;
    let own: SMatrix<f64, SIZE, SIZE> = linear
        .information
        .fixed_view::<SIZE, SIZE>(at, at)
        .into_owned();
    // Numbers of a state differ in unit by many powers of ten: brought to one size before anything is called nothing.
    let scale = own
        .diagonal()
        .map(|d| if d > 0.0 { 1.0 / d.sqrt() } else { 1.0 });
    let scaled = SMatrix::from_diagonal(&scale) * own * SMatrix::from_diagonal(&scale);
    let eigen = SymmetricEigen::new(scaled);
    let least = NOTHING * eigen.eigenvalues.amax();
    let inverse = eigen
        .eigenvalues
        .map(|e| if e > least { 1.0 / e } else { 0.0 });
    let inverse = SMatrix::from_diagonal(&scale)
        * (eigen.eigenvectors * SMatrix::from_diagonal(&inverse) * eigen.eigenvectors.transpose())
        * SMatrix::from_diagonal(&scale);
    let size = rest.len() * SIZE;
    let mut across = DMatrix::zeros(size, SIZE);
    let mut information = DMatrix::zeros(size, size);
    let mut gradient = DVector::zeros(size);
    for (a, frame_a) in rest.iter().enumerate() {
        let block = linear.information.view((frame_a * SIZE, at), (SIZE, SIZE));
        across
            .view_mut((a * SIZE, 0), (SIZE, SIZE))
            .copy_from(&block);
        let rows = linear.gradient.rows(frame_a * SIZE, SIZE);
        gradient.rows_mut(a * SIZE, SIZE).copy_from(&rows);
        for (b, frame_b) in rest.iter().enumerate() {
            let block = linear
                .information
                .view((frame_a * SIZE, frame_b * SIZE), (SIZE, SIZE));
            information
                .view_mut((a * SIZE, b * SIZE), (SIZE, SIZE))
                .copy_from(&block);
        }
    }
    let weighted = &across * inverse;
    information -= &weighted * across.transpose();
    gradient -= &weighted * linear.gradient.rows(at, SIZE);
    // Frames that nothing ties to the one that left stay out of the prior.
    let tied: Vec<usize> = (0..rest.len())
        .filter(|a| information.rows(a * SIZE, SIZE).amax() > 0.0)
        .collect();
    let pick = |k: usize| tied[k / SIZE] * SIZE + k % SIZE;
    let count = tied.len() * SIZE;
    window.prior = Prior {
        at: tied
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
        let hosted = landmark.sights[0].0 == number;
        landmark.sights.retain(|(n, _)| *n != number);
        !hosted
    });
    window.frames.remove(leaving);
    if let Some(next) = window.frames.get_mut(leaving) {
        next.motion = None;
    }
}
