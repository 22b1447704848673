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
    row: usize,
    from: usize,
    to: usize,
}

/// All dark regions of suitable extent.
pub(crate) fn dark(image: &ImageView<'_>, config: &RegionConfig) -> Vec<Region> {
    let threshold = Threshold::new(image, config);
    let (mut runs, mut parents): (Vec<Run>, Vec<usize>) = (Vec::new(), Vec::new());
    let mut above = 0..0;
    for row in 0..image.height() {
        let first = runs.len();
        threshold.dark_runs(image, row, |from, to| {
            parents.push(runs.len());
            runs.push(Run { row, from, to });
        });
        // Runs that touch, diagonally too, belong together.
        let mut other = above.start;
        for current in first..runs.len() {
            let run = runs[current];
            while other < above.end && runs[other].to + 1 < run.from {
                other += 1;
            }
            let mut touching = other;
            while touching < above.end && runs[touching].from <= run.to + 1 {
                join(&mut parents, touching, current);
                touching += 1;
            }
        }
        above = first..runs.len();
    }
    regions_of(&runs, &mut parents, config)
}

fn root(parents: &mut [usize], mut of: usize) -> usize {
    while parents[of] != of {
        parents[of] = parents[parents[of]];
        of = parents[of];
    }
    of
}

fn join(parents: &mut [usize], a: usize, b: usize) {
    let (a, b) = (root(parents, a), root(parents, b));
    parents[a.max(b)] = a.min(b);
}

/// Groups runs by region, in the order of their first runs.
fn regions_of(runs: &[Run], parents: &mut [usize], config: &RegionConfig) -> Vec<Region> {
    /// Bounds: columns, last row, area.
    #[derive(Clone, Copy)]
    struct Bounds {
        from: usize,
        to: usize,
        bottom: usize,
        area: usize,
    }
    let mut bounds: Vec<Option<Bounds>> = vec![None; runs.len()];
    for (i, run) in runs.iter().enumerate() {
        let of = root(parents, i);
        let known = bounds[of].unwrap_or(Bounds {
            from: run.from,
            to: run.to,
            bottom: run.row,
            area: 0,
        });
        bounds[of] = Some(Bounds {
            from: known.from.min(run.from),
            to: known.to.max(run.to),
            bottom: run.row,
            area: known.area + run.to + 1 - run.from,
        });
    }
    let extent = config.min_extent_px..=config.max_extent_px;
    let mut numbers = vec![usize::MAX; runs.len()];
    let mut regions: Vec<Region> = Vec::new();
    for (i, run) in runs.iter().enumerate() {
        let of = root(parents, i);
        let Some(known) = bounds[of] else { continue };
        let top = runs[of].row;
        let size = [known.to + 1 - known.from, known.bottom + 1 - top];
        if !size.iter().all(|size| extent.contains(size)) {
            continue;
        }
        if numbers[of] == usize::MAX {
            numbers[of] = regions.len();
            regions.push(Region {
                top,
                rows: vec![[usize::MAX, 0]; size[1]],
                left: known.from,
                columns: vec![[usize::MAX, 0]; size[0]],
                area: known.area,
            });
        }
        let region = &mut regions[numbers[of]];
        let [from, to] = &mut region.rows[run.row - top];
        (*from, *to) = ((*from).min(run.from), (*to).max(run.to));
        for column in run.from..=run.to {
            let [from, to] = &mut region.columns[column - known.from];
            (*from, *to) = ((*from).min(run.row), (*to).max(run.row));
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
        let mut ranges = vec![[u8::MAX, 0]; across * down];
        for row in 0..image.height() {
            let ranges = &mut ranges[row / tile * across..][..across];
            for (pixels, [low, high]) in image.row(row).chunks(tile).zip(ranges) {
                for &pixel in pixels {
                    (*low, *high) = ((*low).min(pixel), (*high).max(pixel));
                }
            }
        }
        let levels = (0..across * down)
            .map(|i| {
                let (x, y) = (i % across, i / across);
                let (mut low, mut high) = (u8::MAX, 0);
                for j in y.saturating_sub(1)..=(y + 1).min(down - 1) {
                    for [l, h] in
                        &ranges[j * across..][x.saturating_sub(1)..=(x + 1).min(across - 1)]
                    {
                        (low, high) = (low.min(*l), high.max(*h));
                    }
                }
                match high - low >= config.min_contrast {
                    true => low + (high - low) / 2,
                    false => 0,
                }
            })
            .collect();
        Self {
            tile,
            across,
            levels,
        }
    }

    /// Calls `each` with the first and the last column of every run of dark pixels.
    fn dark_runs(&self, image: &ImageView<'_>, row: usize, mut each: impl FnMut(usize, usize)) {
        let levels = &self.levels[row / self.tile * self.across..][..self.across];
        let mut from = None;
        let pixels = image.row(row);
        for (column, &pixel) in pixels.iter().enumerate() {
            let is_dark = pixel < levels[column / self.tile];
            match (from, is_dark) {
                (None, true) => from = Some(column),
                (Some(first), false) => {
                    each(first, column - 1);
                    from = None;
                }
                _ => {}
            }
        }
        if let Some(first) = from {
            each(first, pixels.len() - 1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn touching_runs_are_one_region() {
        let mut pixels = vec![200_u8; 40 * 40];
        // A ring, and a bar that is too thin.
        for i in 10..30 {
            for j in 10..30 {
                let is_inside = (14..26).contains(&i) && (14..26).contains(&j);
                pixels[j * 40 + i] = if is_inside { 200 } else { 20 };
            }
        }
        for i in 2..38 {
            pixels[36 * 40 + i] = 20;
        }
        let image = ImageView::packed(40, 40, &pixels).expect("an image");
        let found = dark(&image, &RegionConfig::default());
        assert_eq!(found.len(), 1);
        let ring = &found[0];
        assert_eq!((ring.top, ring.left, ring.area), (10, 10, 400 - 144));
        assert_eq!(ring.rows.len(), 20);
        assert!(
            ring.rows
                .iter()
                .chain(&ring.columns)
                .all(|ends| *ends == [10, 29])
        );
    }
}
