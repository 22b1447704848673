//! Texture of the wall in front of the synthetic camera.
//!
//! Contract: a tile of 1/f noise that is continuous across its edges, generated once from integers
//! only; rendering only copies rows of it. Values avoid black and white.

use counter_random as random;

use super::streams;

/// Rows and columns of the luma tile. Chroma has half of that.
const TILE: usize = 512;
/// Cell sizes of the noise in luma pixels and their fraction of the contrast: near 1/f, with enough
/// in the finest for block matching.
const LUMA: [(usize, u32); 8] = [
    (128, 40),
    (64, 32),
    (32, 26),
    (16, 22),
    (8, 18),
    (4, 14),
    (2, 10),
    (1, 4),
];
const CHROMA: [(usize, u32); 3] = [(64, 3), (32, 2), (16, 1)];

pub(super) struct Wall {
    width: usize,
    height: usize,
    luma: Vec<u8>,
    cb: Vec<u8>,
    cr: Vec<u8>,
}

impl Wall {
    /// For stereo frames of `width` x `height`.
    pub(super) fn new(seed: u64, width: u32, height: u32) -> Self {
        let chroma = |which: u64| {
            noise(
                seed,
                streams::TEXTURE + 16 * which,
                TILE / 2,
                &CHROMA,
                96,
                160,
            )
        };
        Self {
            width: width as usize,
            height: height as usize,
            luma: noise(seed, streams::TEXTURE, TILE, &LUMA, 32, 224),
            cb: chroma(1),
            cr: chroma(2),
        }
    }

    /// Disparity of the wall in the right image, pixels: an even number.
    pub(super) fn disparity_px(&self) -> usize {
        (self.width / 80).max(2) & !1
    }

    /// I420 bytes of the stereo frame whose left image has pixel (x, y) of the tile in its corner.
    pub(super) fn draw(&self, x: i64, y: i64) -> Vec<u8> {
        let mut data = Vec::with_capacity(self.width * self.height * 3 / 2);
        let planes = [(&self.luma, 1), (&self.cb, 2), (&self.cr, 2)];
        for (tile, divisor) in planes {
            let size = TILE / divisor as usize;
            let wrap = |v: i64| v.div_euclid(divisor).rem_euclid(size as i64) as usize;
            let (left, top) = (wrap(x), wrap(y));
            let right = left + self.disparity_px() / divisor as usize;
            let eye = self.width / 2 / divisor as usize;
            for row in top..top + self.height / divisor as usize {
                let row = &tile[row % size * size..][..size];
                extend_wrapped(&mut data, row, left, eye);
                extend_wrapped(&mut data, row, right % size, eye);
            }
        }
        data
    }
}

/// Appends `count` bytes of an endlessly repeated `row`, from `start`.
fn extend_wrapped(data: &mut Vec<u8>, row: &[u8], start: usize, count: usize) {
    let first = &row[start..];
    let first = &first[..first.len().min(count)];
    data.extend_from_slice(first);
    let mut left = count - first.len();
    while left > 0 {
        let part = &row[..row.len().min(left)];
        data.extend_from_slice(part);
        left -= part.len();
    }
}

/// A `size` x `size` tile of value noise: random values at the corners of cells, smoothly
/// interpolated, summed over cell sizes and spread over `low..=high`.
fn noise(
    seed: u64,
    stream: u64,
    size: usize,
    octaves: &[(usize, u32)],
    low: u32,
    high: u32,
) -> Vec<u8> {
    let mut sum = vec![0_u32; size * size];
    for (&(cell, share), octave) in octaves.iter().zip(0..) {
        let cells = size / cell;
        // 12-bit values, 8-bit weights: everything fits in 32 bits.
        let corners: Vec<u32> = (0..(cells * cells) as u64)
            .map(|index| (random::bits(seed, stream + octave, index) >> 52) as u32)
            .collect();
        // 3t² - 2t³ at the steps of a cell.
        let weights: Vec<u32> = (0..cell)
            .map(|step| (256 * step * step * (3 * cell - 2 * step) / (cell * cell * cell)) as u32)
            .collect();
        for (y, sums) in sum.chunks_exact_mut(size).enumerate() {
            let upper = &corners[y / cell * cells..][..cells];
            let lower = &corners[(y / cell + 1) % cells * cells..][..cells];
            let down = weights[y % cell];
            let column = |i: usize| (upper[i] * (256 - down) + lower[i] * down) >> 8;
            for (i, sums) in sums.chunks_exact_mut(cell).enumerate() {
                let (a, b) = (column(i), column((i + 1) % cells));
                for (sum, right) in sums.iter_mut().zip(&weights) {
                    *sum += share * ((a * (256 - right) + b * right) >> 8);
                }
            }
        }
    }
    let least = sum.iter().min().copied().unwrap_or(0);
    let span = sum.iter().max().map_or(1, |most| (most - least).max(1));
    sum.iter()
        .map(|value| (low + (value - least) * (high - low) / span) as u8)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tiles_join_and_use_their_range() {
        let tile = noise(1, 0, 128, &[(32, 3), (16, 2)], 32, 224);
        assert_eq!(
            (tile.iter().min(), tile.iter().max()),
            (Some(&32), Some(&224))
        );
        // Neighbors across the edge differ no more than neighbors within.
        let step = |a: u8, b: u8| a.abs_diff(b);
        let within = (0..128 * 127).map(|i| step(tile[i], tile[i + 128])).max();
        let across = (0..128).map(|i| step(tile[i], tile[127 * 128 + i])).max();
        assert!(across <= within, "{across:?} {within:?}");
    }

    #[test]
    fn right_image_is_the_left_one_with_constant_disparity() {
        let wall = Wall::new(3, 640, 240);
        let d = wall.disparity_px();
        assert_eq!(d, 8);
        let data = wall.draw(-700, 1300);
        assert_eq!(data.len(), 640 * 240 * 3 / 2);
        for row in data[..640 * 240].chunks_exact(640) {
            assert_eq!(row[d..320], row[320..640 - d]);
        }
        for row in data[640 * 240..].chunks_exact(320) {
            assert_eq!(row[d / 2..160], row[160..320 - d / 2]);
        }
    }

    #[test]
    fn wide_rows_wrap() {
        let mut data = Vec::new();
        extend_wrapped(&mut data, &[0, 1, 2, 3], 3, 7);
        assert_eq!(data, [3, 0, 1, 2, 3, 0, 1]);
    }
}
