//! Blending of a tile, front to back.
//!
//! A tile has 32 cells of 8x1 pixels, one vector each: cell `16 half + row`. Which cells an ellipse
//! reaches follows from the interval of x in each row, eight rows at a time.

use super::project::Footprint;
use super::view::{TILE, View};
use crate::config::RenderConfig;
use crate::lanes::{Kernel, LANES, Lanes};

/// Cells of a tile.
pub(super) const CELLS: usize = TILE * TILE / LANES;

/// Slack of the intervals for rounding: px and share.
const SLACK_PX: f32 = 0.02;
const SLACK_SHARE: f32 = 1e-4;

/// Values of a tile's pixels, by cell.
pub(super) type Cells = [[f32; LANES]; CELLS];

/// A blended tile.
#[derive(Clone, Debug)]
pub(super) struct TileImage {
    /// Transmittance behind all; negative where the pixel is complete.
    pub(super) transmittance: Cells,
    /// Without background and exposure.
    pub(super) rgb: [Cells; 3],
    /// Sum of weights times depths, m.
    pub(super) depth: Cells,
    /// m; 0 where there is none.
    pub(super) median: Cells,
}

/// Cell and lane of a pixel of a tile.
#[inline(always)]
pub(super) fn cell_of(row: usize, column: usize) -> (usize, usize) {
    (column / LANES * TILE + row, column % LANES)
}

/// Transmittance before the first Gaussian: 1 inside the image, -1 beyond it. With the bits of the
/// cells that have pixels.
pub(super) fn start(view: &View, tile: usize) -> (Cells, u32) {
    let mut transmittance = [[-1.0; LANES]; CELLS];
    let mut live = 0;
    let [x, y] = origin(view, tile);
    for row in 0..TILE.min(view.height - y) {
        for column in 0..TILE.min(view.width - x) {
            let (cell, lane) = cell_of(row, column);
            transmittance[cell][lane] = 1.0;
            live |= 1 << cell;
        }
    }
    (transmittance, live)
}

/// First pixel of a tile.
#[inline(always)]
pub(super) fn origin(view: &View, tile: usize) -> [usize; 2] {
    let columns = view.tile_columns();
    [tile % columns * TILE, tile / columns * TILE]
}

/// A Gaussian as seen from a tile.
pub(super) struct Local<V> {
    /// x of the pixels of both halves minus the mean.
    dx: [V; 2],
    /// y of the first row minus the mean.
    dy: f32,
    half_a: V,
    b: f32,
    half_c: f32,
    opacity: V,
    z: f32,
    slope: [f32; 2],
}

impl<V: Lanes> Local<V> {
    #[inline(always)]
    pub(super) fn new(f: &Footprint, [x, y]: [f32; 2]) -> Self {
        let ramp = V::load(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
        let from = x - f.mean[0];
        Self {
            dx: [ramp + V::splat(from), ramp + V::splat(from + LANES as f32)],
            dy: y - f.mean[1],
            half_a: V::splat(0.5 * f.conic[0]),
            b: f.conic[1],
            half_c: 0.5 * f.conic[2],
            opacity: V::splat(f.opacity),
            z: f.z,
            slope: f.slope,
        }
    }

    /// Pixels of a cell minus the mean.
    #[inline(always)]
    pub(super) fn offset(&self, cell: usize) -> (V, f32) {
        (self.dx[cell / TILE], self.dy + (cell % TILE) as f32)
    }

    /// Depth in a cell, m.
    #[inline(always)]
    pub(super) fn depth(&self, cell: usize) -> V {
        let (dx, dy) = self.offset(cell);
        dx.mul_add(
            V::splat(self.slope[0]),
            V::splat(self.z + self.slope[1] * dy),
        )
    }

    /// Opacity times `exp(-σ)` in a cell.
    #[inline(always)]
    pub(super) fn alpha(&self, cell: usize) -> V {
        let (dx, dy) = self.offset(cell);
        let across = self.half_a.mul_add(dx, V::splat(self.b * dy));
        let sigma = across.mul_add(dx, V::splat(self.half_c * dy * dy));
        self.opacity * (-sigma).exp()
    }
}

/// Bits of the cells that the ellipse of a Gaussian reaches.
#[inline(always)]
pub(super) fn cells<V: Lanes>(f: &Footprint, [x, y]: [f32; 2]) -> u32 {
    let s = V::splat;
    let [a, b, _] = f.conic;
    let inverse = 1.0 / a;
    let ramp = V::load(&[0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]);
    let from = x - f.mean[0];
    let full = f.reach * a * (1.0 + SLACK_SHARE);
    let mut bits = 0;
    for half in 0..2 {
        let dy = ramp + s(y - f.mean[1] + (half * LANES) as f32);
        let square = (dy * dy).mul_add(s(-f.determinant), s(full));
        let width = square
            .max(s(0.0))
            .sqrt()
            .mul_add(s(inverse * (1.0 + SLACK_SHARE)), s(SLACK_PX));
        let middle = dy * s(-b * inverse);
        let (low, high) = (middle - width, middle + width);
        let reached = (-square).less(s(0.0));
        let left = within(low, high, from).and(reached).bits();
        let right = within(low, high, from + LANES as f32).and(reached).bits();
        bits |= left << (half * LANES) | right << (half * LANES + TILE);
    }
    bits
}

/// Entries that are read ahead.
const BATCH: usize = 32;

/// The footprints of a tile, read ahead: their addresses are scattered, and the processor waits for
/// one at a time where branches follow each, but for many in a loop of copies.
pub(super) struct Batch<'a> {
    footprints: &'a [Footprint],
    entries: &'a [u32],
    ahead: [Footprint; BATCH],
    next: usize,
}

impl<'a> Batch<'a> {
    #[inline(always)]
    pub(super) fn new(footprints: &'a [Footprint], entries: &'a [u32]) -> Self {
        Self {
            footprints,
            entries,
            ahead: [Footprint::default(); BATCH],
            next: BATCH,
        }
    }

    #[inline(always)]
    pub(super) fn next(&mut self) -> Option<&Footprint> {
        if self.next == BATCH {
            if self.entries.is_empty() {
                return None;
            }
            let (now, later) = self.entries.split_at(BATCH.min(self.entries.len()));
            // The last batch ends where all do.
            self.next = BATCH - now.len();
            for (to, entry) in self.ahead[self.next..].iter_mut().zip(now) {
                *to = self.footprints[*entry as usize];
            }
            self.entries = later;
        }
        self.next += 1;
        self.ahead.get(self.next - 1)
    }
}

/// Whether an interval reaches the eight pixels from `from` on.
#[inline(always)]
fn within<V: Lanes>(low: V, high: V, from: f32) -> V {
    let last = V::splat(from + (LANES - 1) as f32);
    low.less(last).and(V::splat(from).less(high))
}

/// Adds `weight * value`.
#[inline(always)]
fn add<V: Lanes>(to: &mut [f32; LANES], weight: V, value: V) {
    weight.mul_add(value, V::load(to)).store(to);
}

/// Blends one tile.
pub(super) struct Blend<'a> {
    pub(super) footprints: &'a [Footprint],
    /// Indices of footprints, nearest first.
    pub(super) entries: &'a [u32],
    pub(super) view: &'a View,
    pub(super) tile: usize,
    pub(super) config: &'a RenderConfig,
}

impl Kernel for Blend<'_> {
    type Output = TileImage;

    #[inline(always)]
    fn run<V: Lanes>(self) -> TileImage {
        let (transmittance, mut live) = start(self.view, self.tile);
        let mut out = TileImage {
            transmittance,
            rgb: [[[0.0; LANES]; CELLS]; 3],
            depth: [[0.0; LANES]; CELLS],
            median: [[0.0; LANES]; CELLS],
        };
        let origin = origin(self.view, self.tile).map(|v| v as f32);
        let s = V::splat;
        let (max_alpha, min_alpha) = (s(self.config.max_alpha), s(self.config.min_alpha));
        let least = s(self.config.min_transmittance);
        let mut batch = Batch::new(self.footprints, self.entries);
        while let Some(f) = batch.next() {
            let mut bits = cells::<V>(f, origin) & live;
            let local = Local::<V>::new(f, origin);
            while bits != 0 {
                let cell = bits.trailing_zeros() as usize % CELLS;
                bits &= bits - 1;
                let alpha = local.alpha(cell).min(max_alpha);
                let skipped = alpha.less(min_alpha);
                if skipped.bits() == 0xff {
                    continue;
                }
                let before = V::load(&out.transmittance[cell]);
                let weight = before * alpha;
                let next = before - weight;
                let kept = least.less(next);
                let weight = weight.and(kept).and_not(skipped);
                add(&mut out.rgb[0][cell], weight, s(f.color[0]));
                add(&mut out.rgb[1][cell], weight, s(f.color[1]));
                add(&mut out.rgb[2][cell], weight, s(f.color[2]));
                let z = local.depth(cell);
                add(&mut out.depth[cell], weight, z);
                let after = skipped.select(before, kept.select(next, -before.abs()));
                let crossed = s(0.5).less(before).and_not(s(0.5).less(after)).and(kept);
                if crossed.bits() != 0 {
                    let median = &mut out.median[cell];
                    crossed.select(z, V::load(median)).store(median);
                }
                after.store(&mut out.transmittance[cell]);
                if s(0.0).less(after).bits() == 0 {
                    live &= !(1 << cell);
                }
            }
            if live == 0 {
                break;
            }
        }
        out
    }
}
