//! Gaussians as small images need them: eight neighbors together, with exponentials and rotations
//! evaluated once for all cameras.

use crate::lanes::{LANES, Lanes};
use crate::scene::{Plane, Splats, coefficients};

/// Values of eight neighbors.
pub(super) type Row = [f32; LANES];

/// Rows of a block: position in the world, m.
pub(super) const POSITION: usize = 0;
/// Square of the largest scale, m².
pub(super) const LARGEST: usize = 3;
/// Opacity, 0 where a block has fewer than eight Gaussians.
pub(super) const OPACITY: usize = 4;
/// Twice its natural logarithm.
pub(super) const LOG_OPACITY: usize = 5;
/// Axes times scales, row by row, m: the root of the covariance in the world.
pub(super) const ROOT: usize = 6;
/// Harmonics, coefficient by coefficient.
pub(super) const HARMONICS: usize = 15;

/// Twice the logarithm of an opacity of 0, for sums that remain finite.
const LOG_OF_NONE: f32 = -1e30;

/// Blocks of eight Gaussians, one after the other.
#[derive(Clone, Debug)]
pub(super) struct BakedBlocks {
    rows: Vec<Row>,
    /// Rows of a block.
    stride: usize,
    degree: usize,
}

impl BakedBlocks {
    pub(super) fn new(degree: usize) -> Self {
        Self {
            rows: Vec::new(),
            stride: HARMONICS + 3 * coefficients(degree),
            degree,
        }
    }

    pub(super) fn blocks(&self) -> usize {
        self.rows.len() / self.stride
    }

    pub(super) fn degree(&self) -> usize {
        self.degree
    }

    /// Appends Gaussians as blocks of their own.
    pub(super) fn extend(&mut self, splats: &Splats) {
        for start in (0..splats.len()).step_by(LANES) {
            let first = self.rows.len();
            self.rows.resize(first + self.stride, [0.0; LANES]);
            let block = &mut self.rows[first..];
            block[LOG_OPACITY] = [LOG_OF_NONE; LANES];
            for lane in 0..LANES.min(splats.len() - start) {
                bake(splats, start + lane, lane, block);
            }
        }
    }

    /// The rows of a block.
    #[inline(always)]
    pub(super) fn block(&self, block: usize) -> &[Row] {
        &self.rows[block * self.stride..(block + 1) * self.stride]
    }
}

fn bake(splats: &Splats, index: usize, lane: usize, block: &mut [Row]) {
    let planes = splats.planes();
    let three = |first: usize| std::array::from_fn::<f32, 3, _>(|k| planes[first + k][index]);
    for (k, value) in three(Plane::POSITION).into_iter().enumerate() {
        block[POSITION + k][lane] = value;
    }
    let scale = three(Plane::SCALE).map(libm::expf);
    let largest = scale.into_iter().fold(0.0, f32::max);
    block[LARGEST][lane] = largest * largest;
    let logit = planes[Plane::OPACITY][index];
    let opacity = 1.0 / (1.0 + libm::expf(-logit));
    block[OPACITY][lane] = opacity;
    block[LOG_OPACITY][lane] = (2.0 * libm::logf(opacity)).max(LOG_OF_NONE);
    let quaternion = std::array::from_fn(|k| planes[Plane::ROTATION + k][index]);
    for (row, axis) in axes(quaternion).into_iter().enumerate() {
        for k in 0..3 {
            block[ROOT + 3 * row + k][lane] = axis[k] * scale[k];
        }
    }
    for k in 0..3 * coefficients(splats.degree()) {
        block[HARMONICS + k][lane] = planes[Plane::HARMONICS + k][index];
    }
}

/// Rotation matrix of a quaternion of any length, rows.
fn axes([w, x, y, z]: [f32; 4]) -> [[f32; 3]; 3] {
    let two = 2.0 / (w * w + x * x + y * y + z * z);
    [
        [
            1.0 - two * (y * y + z * z),
            two * (x * y - w * z),
            two * (x * z + w * y),
        ],
        [
            two * (x * y + w * z),
            1.0 - two * (x * x + z * z),
            two * (y * z - w * x),
        ],
        [
            two * (x * z - w * y),
            two * (y * z + w * x),
            1.0 - two * (x * x + y * y),
        ],
    ]
}

/// Three rows from one on.
#[inline(always)]
pub(super) fn load3<V: Lanes>(block: &[Row], first: usize) -> [V; 3] {
    [
        V::load(&block[first]),
        V::load(&block[first + 1]),
        V::load(&block[first + 2]),
    ]
}
