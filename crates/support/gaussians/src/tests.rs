//! Gaussians for tests.

use crate::splats::Splats;

pub(crate) fn random_splats(seed: u64, count: usize, degree: usize) -> Splats {
    crate::random_splats(seed, count, degree, -2.6).unwrap()
}
