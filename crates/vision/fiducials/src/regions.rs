//! Connected dark regions of a locally thresholded image.

use estimator_config::config;
use imaging::ImageView;

config! {
    /// Dark regions.
    pub struct RegionConfig {
        /// Side of the tiles of which minimum and maximum decide the threshold, px.
        pub tile_px: usize = 4,
        /// Minimum difference of the maximum and the minimum around a tile, gray levels.
        pub min_contrast: u8 = 12,
        /// Minimum and maximum extent of a region along either axis, px.
        pub min_extent_px: usize = 8,
        /// See `min_extent_px`.
        pub max_extent_px: usize = 400,
    }
}

/// Outermost pixels of a dark region.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Region {
    /// First row.
    pub(crate) top: usize,
    /// First and last dark column of each row.
    pub(crate) rows: Vec<[usize; 2]>,
    /// First column.
    pub(crate) left: usize,
    /// First and last dark row of each column.
    pub(crate) columns: Vec<[usize; 2]>,
    /// Number of dark pixels.
    pub(crate) area: usize,
}

/// A horizontal run of dark pixels.
#[derive(Clone, Copy, Debug)]
struct Run {
    row: u32,
    from: u32,
    to: u32,
}

/// All dark regions of suitable extent.
pub(crate) fn dark(image: &ImageView<'_>, config: &RegionConfig) -> Vec<Region> {
    let threshold = Threshold::new(image, config);
    let mut runs: Vec<Run> = Vec::new();
    // Of each run one before it that it touches, or itself: the first one of a region is its root.
    let mut parents: Vec<u32> = Vec::new();
    let mut levels = vec![0; image.width()];
    let mut above = 0..0;
    for row in 0..image.height() {
        let first = runs.len();
        if row % threshold.tile == 0 {
            threshold.spread(row / threshold.tile, &mut levels);
        }
        dark_runs(image.row(row), &levels, |from, to| {
            runs.push(Run {
                row: row as u32,
                from: from as u32,
                to: to as u32,
            });
        });
        parents.extend(first as u32..runs.len() as u32);
        // Runs that touch, diagonally too, belong together.
        let mut other = above.start;
        for current in first..runs.len() {
            let run = runs[current];
            while other < above.end && runs[other].to + 1 < run.from {
                other += 1;
            }
            let mut touching = other;
            while touching < above.end && runs[touching].from <= run.to + 1 {
                join(&mut parents, touching as u32, current as u32);
                touching += 1;
            }
        }
        above = first..runs.len();
    }
    regions_of(&runs, parents, config)
}

fn root(parents: &mut [u32], mut of: u32) -> u32 {
    while parents[of as usize] != of {
        parents[of as usize] = parents[parents[of as usize] as usize];
        of = parents[of as usize];
    }
    of
}

fn join(parents: &mut [u32], a: u32, b: u32) {
    let (a, b) = (root(parents, a), root(parents, b));
    parents[a.max(b) as usize] = a.min(b);
}

/// What the runs of a region extend over.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    top: u32,
    bottom: u32,
    from: u32,
    to: u32,
    /// Number of pixels.
    area: u32,
}

/// Groups runs by region, in the order of their first runs.
fn regions_of(runs: &[Run], mut parents: Vec<u32>, config: &RegionConfig) -> Vec<Region> {
    // Roots come before the runs that lead to them, so their numbers are known by then: from here
    // on parents are numbers of regions.
    let mut bounds: Vec<Bounds> = Vec::new();
    for (i, run) in runs.iter().enumerate() {
        let parent = parents[i] as usize;
        if parent == i {
            parents[i] = bounds.len() as u32;
            bounds.push(Bounds {
                top: run.row,
                bottom: run.row,
                from: run.from,
                to: run.to,
                area: run.to + 1 - run.from,
            });
            continue;
        }
        parents[i] = parents[parent];
        let own = &mut bounds[parents[i] as usize];
        own.bottom = run.row;
        own.from = own.from.min(run.from);
        own.to = own.to.max(run.to);
        own.area += run.to + 1 - run.from;
    }
    let extent = config.min_extent_px..=config.max_extent_px;
    let mut regions: Vec<Region> = Vec::new();
    // Index of each region among those of suitable extent.
    let suitable: Vec<Option<u32>> = bounds
        .iter()
        .map(|own| {
            let size = [own.to + 1 - own.from, own.bottom + 1 - own.top].map(|v| v as usize);
            if !size.iter().all(|size| extent.contains(size)) {
                return None;
            }
            regions.push(Region {
                top: own.top as usize,
                rows: vec![[usize::MAX, 0]; size[1]],
                left: own.from as usize,
                columns: vec![[usize::MAX, 0]; size[0]],
                area: own.area as usize,
            });
            Some(regions.len() as u32 - 1)
        })
        .collect();
    for (run, number) in runs.iter().zip(&parents) {
        let Some(index) = suitable[*number as usize] else {
            continue;
        };
        let region = &mut regions[index as usize];
        let [row, from, to] = [run.row, run.from, run.to].map(|v| v as usize);
        let ends = &mut region.rows[row - region.top];
        *ends = [ends[0].min(from), ends[1].max(to)];
        for ends in &mut region.columns[from - region.left..=to - region.left] {
            *ends = [ends[0].min(row), ends[1].max(row)];
        }
    }
    regions
}

/// Thresholds of tiles.
struct Threshold {
    tile: usize,
    across: usize,
    /// Half of minimum and maximum around a tile; 0 where these hardly differ.
    levels: Vec<u8>,
}

impl Threshold {
    fn new(image: &ImageView<'_>, config: &RegionConfig) -> Self {
        let tile = config.tile_px.max(1);
        let across = image.width().div_ceil(tile);
        let down = image.height().div_ceil(tile);
        // Minimum and maximum of each tile: down its columns of pixels, then across.
        let (mut lows, mut highs) = (vec![u8::MAX; across * down], vec![0; across * down]);
        let (mut low, mut high) = (vec![0; image.width()], vec![0; image.width()]);
        for j in 0..down {
            low.copy_from_slice(image.row(j * tile));
            high.copy_from_slice(image.row(j * tile));
            for row in j * tile + 1..((j + 1) * tile).min(image.height()) {
                take_extremes(&mut low, &mut high, image.row(row), image.row(row));
            }
            let tiles = j * across..(j + 1) * across;
            for (own, pixels) in lows[tiles.clone()].iter_mut().zip(low.chunks(tile)) {
                *own = pixels.iter().copied().fold(u8::MAX, u8::min);
            }
            for (own, pixels) in highs[tiles].iter_mut().zip(high.chunks(tile)) {
                *own = pixels.iter().copied().fold(0, u8::max);
            }
        }
        let mut levels = Vec::with_capacity(across * down);
        let (mut low, mut high) = (vec![0; across], vec![0; across]);
        for j in 0..down {
            let row = |j: usize| j * across..(j + 1) * across;
            low.copy_from_slice(&lows[row(j)]);
            high.copy_from_slice(&highs[row(j)]);
            for other in [j.saturating_sub(1), (j + 1).min(down - 1)] {
                take_extremes(&mut low, &mut high, &lows[row(other)], &highs[row(other)]);
            }
            levels.extend((0..across).map(|i| {
                let near = i.saturating_sub(1)..(i + 2).min(across);
                let low = low[near.clone()].iter().copied().fold(u8::MAX, u8::min);
                let high = high[near].iter().copied().fold(0, u8::max);
                match high - low >= config.min_contrast {
                    true => low + (high - low) / 2,
                    false => 0,
                }
            }));
        }
        Self {
            tile,
            across,
            levels,
        }
    }

    /// Thresholds of the pixels of a row, of the tiles in a row of them.
    fn spread(&self, row: usize, pixels: &mut [u8]) {
        let levels = &self.levels[row * self.across..];
        for (pixels, level) in pixels.chunks_mut(self.tile).zip(levels) {
            pixels.fill(*level);
        }
    }
}

/// Lowers minima and raises maxima by those of other values.
fn take_extremes(low: &mut [u8], high: &mut [u8], lows: &[u8], highs: &[u8]) {
    for (low, other) in low.iter_mut().zip(lows) {
        *low = (*low).min(*other);
    }
    for (high, other) in high.iter_mut().zip(highs) {
        *high = (*high).max(*other);
    }
}

/// Calls `each` with the first and the last column of every run of pixels below their levels.
fn dark_runs(pixels: &[u8], levels: &[u8], mut each: impl FnMut(usize, usize)) {
    /// Pixels that are compared at a time: the bits of a word.
    const BLOCK: usize = 64;
    let mut from = 0;
    let mut was_dark = 0;
    let blocks = pixels.chunks(BLOCK).zip(levels.chunks(BLOCK));
    for (number, (pixels, levels)) in blocks.enumerate() {
        let mut is_dark = [0; BLOCK];
        for (own, (pixel, level)) in is_dark.iter_mut().zip(pixels.iter().zip(levels)) {
            *own = u8::from(pixel < level);
        }
        let dark = bits(&is_dark);
        // Where runs begin and where they have ended, in turns.
        let mut changes = dark ^ (dark << 1 | was_dark);
        was_dark = dark >> (BLOCK - 1);
        let begins = dark & changes;
        while changes != 0 {
            let bit = changes & changes.wrapping_neg();
            let column = number * BLOCK + bit.trailing_zeros() as usize;
            match begins & bit != 0 {
                true => from = column,
                false => each(from, column - 1),
            }
            changes &= !bit;
        }
    }
    // Beyond the last pixel of a block that is not full nothing is dark.
    if was_dark == 1 {
        each(from, pixels.len() - 1);
    }
}

/// Bytes of 0 and 1 as bits, the first one lowest.
fn bits(bytes: &[u8; 64]) -> u64 {
    /// Brings bit 0 of each byte into the highest byte, in their order.
    const GATHER: u64 = 0x0102_0408_1020_4080;
    let (groups, _) = bytes.as_chunks::<8>();
    let groups = groups.iter().enumerate();
    groups.fold(0, |bits, (n, group)| {
        bits | (u64::from_le_bytes(*group).wrapping_mul(GATHER) >> 56) << (8 * n)
    })
}

#[cfg(test)]
mod tests;
