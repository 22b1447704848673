//! Pixels of a region, in blocks of eight by eight: a row of a block is one vector.

use std::ops::RangeInclusive;

use super::config::DetailConfig;
use crate::lanes::{LANES, Lanes};

/// Edge of a block, px.
pub(super) const BLOCK: usize = LANES;

/// Blocks that a region has at most along an edge.
pub(super) const MAX_BLOCKS: usize = 16;

/// Slack of the intervals for rounding: px and share.
const SLACK_PX: f32 = 0.02;
const SLACK_SHARE: f32 = 1e-4;

/// A Gaussian in a region.
#[repr(align(64))]
#[derive(Clone, Copy, Debug)]
pub(super) struct Sprite {
    /// px
    pub(super) mean: [f32; 2],
    /// Inverse covariance `a b; b c`, px⁻², and its determinant.
    pub(super) conic: [f32; 4],
    /// `dᵀ Q d` at which alpha falls to its minimum.
    pub(super) reach: f32,
    pub(super) opacity: f32,
    pub(super) color: [f32; 3],
    /// Depth of the mean, m.
    pub(super) z: f32,
    /// Change of depth along x and y, m/px.
    pub(super) slope: [f32; 2],
    pub(super) blocks: Blocks,
}

/// Blocks that a box reaches: bytes of first and last column, first and last row.
#[derive(Clone, Copy, Debug)]
pub(super) struct Blocks(pub(super) u32);

impl Blocks {
    #[inline(always)]
    pub(super) fn new(left: u32, right: u32, top: u32, bottom: u32) -> Self {
        Self(left | right << 8 | top << 16 | bottom << 24)
    }

    /// As bits.
    #[inline(always)]
    fn columns(self) -> u32 {
        (2 << (self.0 >> 8 & 31)) - (1 << (self.0 & 31))
    }

    #[inline(always)]
    fn rows(self) -> RangeInclusive<usize> {
        (self.0 >> 16 & 0xff) as usize..=(self.0 >> 24) as usize
    }
}

/// Number of the block of each coordinate, in the lowest bits; coordinates are taken into the
/// region, which has `size` pixels.
#[inline(always)]
pub(super) fn block_bits<V: Lanes>(at: V, size: usize) -> [u32; LANES] {
    let s = V::splat;
    // The last pixel may be the first one of a block: its center would be halfway between two.
    let inside = at.max(s(0.0)).min(s(size as f32 - 0.5));
    // Half a block less is rounded to the nearest: the added number leaves no bits for the
    // fraction.
    let blocks = inside.mul_add(s(1.0 / BLOCK as f32), s(-0.5)) + s(12_582_912.0);
    let mut values = [0.0; LANES];
    blocks.store(&mut values);
    values.map(f32::to_bits)
}

/// Eight pixels of a row.
#[derive(Clone, Copy, Debug)]
pub(super) struct Cell {
    /// Transmittance; negative where the pixel is complete.
    pub(super) transmittance: [f32; LANES],
    pub(super) rgb: [[f32; LANES]; 3],
    /// Sum of weights times depths, m.
    pub(super) depth: [f32; LANES],
    /// m; 0 where there is none.
    pub(super) median: [f32; LANES],
}

const EMPTY: Cell = Cell {
    transmittance: [1.0; LANES],
    rgb: [[0.0; LANES]; 3],
    depth: [0.0; LANES],
    median: [0.0; LANES],
};

/// The pixels of a region.
#[derive(Debug, Default)]
pub(super) struct Pixels {
    columns: usize,
    rows: usize,
    blocks: Vec<[Cell; BLOCK]>,
    /// Rows of each block that are not complete, as bits.
    open_rows: Vec<u32>,
    /// Blocks of each row of blocks that are not complete, as bits.
    open: [u32; MAX_BLOCKS],
}

impl Pixels {
    /// All pixels empty.
    pub(super) fn clear(&mut self, size: [usize; 2]) {
        [self.columns, self.rows] = size.map(|size| size.div_ceil(BLOCK));
        self.blocks.clear();
        self.blocks.resize(self.columns * self.rows, [EMPTY; BLOCK]);
        self.open_rows.clear();
        self.open_rows.resize(self.columns * self.rows, 0xff);
        self.open = [0; MAX_BLOCKS];
        self.open[..self.rows].fill((1 << self.columns) - 1);
        self.close_border(size);
    }

    /// Completes what is beyond the region in the last blocks.
    fn close_border(&mut self, size: [usize; 2]) {
        let [width, height] = size.map(|size| size % BLOCK);
        if width > 0 {
            for row in 0..self.rows {
                for cell in &mut self.blocks[(row + 1) * self.columns - 1] {
                    cell.transmittance[width..].fill(-1.0);
                }
            }
        }
        if height > 0 {
            let last = (self.rows - 1) * self.columns;
            for column in 0..self.columns {
                self.open_rows[last + column] = (1 << height) - 1;
            }
        }
    }

    /// The cell of eight pixels.
    pub(super) fn cell(&self, row: usize, column: usize) -> &Cell {
        &self.blocks[row / BLOCK * self.columns + column][row % BLOCK]
    }

    /// Whether all pixels are complete.
    #[inline(always)]
    pub(super) fn is_complete(&self) -> bool {
        self.open[..self.rows].iter().all(|open| *open == 0)
    }

    /// Whether blocks have a pixel that is not complete.
    #[inline(always)]
    pub(super) fn is_open(&self, blocks: Blocks) -> bool {
        let mut open = 0;
        for row in blocks.rows() {
            open |= self.open[row % MAX_BLOCKS];
        }
        open & blocks.columns() != 0
    }

    /// Blends a Gaussian behind what is there.
    #[inline(always)]
    pub(super) fn blend<V: Lanes>(
        &mut self,
        sprite: &Sprite,
        config: &DetailConfig,
        max_alpha: f32,
    ) {
        let columns = sprite.blocks.columns();
        let s = V::splat;
        let ramp = V::load(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        let [x, y] = sprite.mean;
        let [a, b, c, determinant] = sprite.conic;
        let [red, green, blue] = sprite.color.map(s);
        let [slope_x, slope_y] = sprite.slope;
        let inverse = 1.0 / a;
        let full = sprite.reach * a * (1.0 + SLACK_SHARE);
        // Exponents to the base of 2, negative.
        let by = -0.5 * std::f32::consts::LOG2_E;
        let (aa, bb, cc) = (s(by * a), 2.0 * by * b, by * c);
        let (max_alpha, min_alpha) = (s(max_alpha), s(config.min_alpha));
        let least = s(config.min_transmittance);
        let (opacity, zero) = (s(sprite.opacity), s(0.0));
        for row in sprite.blocks.rows() {
            let mut open = self.open[row] & columns;
            if open == 0 {
                continue;
            }
            // The interval of x in each of the eight rows.
            let from_y = (row * BLOCK) as f32 - y;
            let dy = ramp + s(from_y);
            let square = (dy * dy).mul_add(s(-determinant), s(full));
            let reached = zero.less(square);
            let width = square
                .max(zero)
                .sqrt()
                .mul_add(s(inverse * (1.0 + SLACK_SHARE)), s(SLACK_PX));
            let middle = dy * s(-b * inverse);
            let (low, high) = (middle - width, middle + width);
            while open != 0 {
                let column = open.trailing_zeros() as usize;
                open &= open - 1;
                let block = row * self.columns + column;
                let from = (column * BLOCK) as f32 - x;
                let last = s(from + (BLOCK - 1) as f32);
                let within = low.less(last).and(s(from).less(high)).and(reached);
                let mut bits = within.bits() & self.open_rows[block];
                if bits == 0 {
                    continue;
                }
                let dx = ramp + s(from);
                let squared = aa * dx * dx;
                let mut complete = 0;
                while bits != 0 {
                    let k = bits.trailing_zeros() as usize % BLOCK;
                    bits &= bits - 1;
                    let dy = from_y + k as f32;
                    let exponent = dx.mul_add(s(bb * dy), squared + s(cc * dy * dy));
                    let alpha = (opacity * exponential(exponent)).min(max_alpha);
                    let cell = &mut self.blocks[block][k];
                    let before = V::load(&cell.transmittance);
                    let weight = (before * alpha)
                        .and_not(alpha.less(min_alpha))
                        .and(zero.less(before));
                    let after = before - weight;
                    add(&mut cell.rgb[0], weight, red);
                    add(&mut cell.rgb[1], weight, green);
                    add(&mut cell.rgb[2], weight, blue);
                    let z = s(slope_x).mul_add(dx, s(sprite.z + slope_y * dy));
                    add(&mut cell.depth, weight, z);
                    let crossed = s(0.5).less(before).and_not(s(0.5).less(after));
                    if crossed.bits() != 0 {
                        crossed
                            .select(z, V::load(&cell.median))
                            .store(&mut cell.median);
                    }
                    let after = after.less(least).select(-after.abs(), after);
                    after.store(&mut cell.transmittance);
                    if after.bits() == 0xff {
                        complete |= 1 << k;
                    }
                }
                if complete != 0 {
                    self.open_rows[block] &= !complete;
                    if self.open_rows[block] == 0 {
                        self.open[row] &= !(1 << column);
                    }
                }
            }
        }
    }
}

/// Adds `weight * value`.
#[inline(always)]
fn add<V: Lanes>(to: &mut [f32; LANES], weight: V, value: V) {
    weight.mul_add(value, V::load(to)).store(to);
}

/// `2^x` for x at most 1, with a relative error below 4e-6; below -120 as at -120.
#[inline(always)]
fn exponential<V: Lanes>(x: V) -> V {
    let s = V::splat;
    let x = x.max(s(-120.0));
    // 2^x = 2^n 2^r, with n the nearest integer; the added number leaves no bits for the fraction.
    let shifted = x + s(12_582_912.0);
    let r = x - (shifted - s(12_582_912.0));
    // 2^r interpolated at the Chebyshev nodes of |r| <= 1/2.
    let p = s(9.666_368e-3)
        .mul_add(r, s(5.592_197_6e-2))
        .mul_add(r, s(2.402_235e-1))
        .mul_add(r, s(6.931_21e-1))
        .mul_add(r, s(1.0));
    p * shifted.power_of_two()
}
