//! Stereo matcher that restricts the disparity search to a planned band.
//!
//! Contract: each pair is matched within a band that is planned from coarse matching of the pair,
//! from the previous map and, if given, from the ground plane ([`crate::band::plan`]). If many
//! pixels of a block of rows have a disparity at an end of the band that is not an end of the full
//! range, the band is widened there and the pair is matched again. An object that the full range
//! would show is therefore lost only if it is too small for coarse matching, absent from the
//! previous map, and away from the ends of the band; `docs/reference/depth.md` gives the measured
//! loss.

use crate::band::Band;
use crate::band::plan::{Plan, Plane, Probe};
use crate::config::Config;
use crate::error::DepthError;
use crate::map::{DisparityMap, Geometry};
use crate::matcher::Matcher;
use imaging::ImageView;

/// Matches consecutive pairs.
///
/// A wall needs a small part of the range:
///
/// ```
/// use depth::{Band, BandedMatcher, ImageView, Config, Preset};
///
/// # // A random texture of 3 x 3 patches; the right image shows it `shift` columns further to the left.
/// # fn pair(width: usize, height: usize, shift: usize) -> [Vec<u8>; 2] {
/// #     let gray = |x: usize, y: usize| {
/// #         let hash = (x / 3 * 1009 + y / 3 + 1) as u64;
/// #         40 + (hash.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 57) as u8
/// #     };
/// #     [0, shift].map(|from| (0..width * height).map(|i| gray(i % width + from, i / width)).collect())
/// # }
/// # let [left, right] = pair(240, 96, 20);
/// let config = Config::preset(Preset::Fast);
/// let mut matcher = BandedMatcher::new(config, 240, Band::full(0, 128, 96)?)?;
/// let images = [ImageView::packed(240, 96, &left)?, ImageView::packed(240, 96, &right)?];
/// let (map, stats) = matcher.run(&images[0], &images[1], None)?;
/// assert!((map.disparity[48 * 240 + 150] - 20.0).abs() < 0.5);
/// assert!(stats.searched_ratio < 0.5, "{stats:?}");
/// assert_eq!(stats.reruns, 0);
/// # Ok::<(), depth::DepthError>(())
/// ```
#[derive(Debug)]
pub struct BandedMatcher {
    matcher: Matcher,
    full: Band,
    probe: Option<Probe>,
    has_last: bool,
    last: DisparityMap,
}

/// Search effort of a banded run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BandStats {
    /// Searched disparities as a fraction of the full range, summed over all runs.
    pub searched_ratio: f64,
    /// Number of additional runs with a widened band.
    pub reruns: u32,
}

/// Height of the blocks in which pixels at the ends of the band are counted, rows.
const BLOCK_ROWS: usize = 8;

impl BandedMatcher {
    /// For images of `width` columns with the rows of `full`, which is the full search range.
    ///
    /// # Errors
    /// [`DepthError::Config`].
    pub fn new(config: Config, width: usize, full: Band) -> Result<Self, DepthError> {
        Ok(Self {
            matcher: Matcher::new(config, width, full.height())?,
            probe: Probe::new(&full, width)?,
            full,
            has_last: false,
            last: DisparityMap::default(),
        })
    }

    /// Discards the previous map, if the next pair does not continue the sequence.
    pub fn reset(&mut self) {
        self.has_last = false;
    }

    /// The underlying matcher.
    pub fn matcher(&self) -> &Matcher {
        &self.matcher
    }

    /// Matches a pair. `ground` is the ground plane, if known.
    ///
    /// # Errors
    /// Those of [`Matcher::run`].
    pub fn run(
        &mut self,
        left: &ImageView<'_>,
        right: &ImageView<'_>,
        ground: Option<(&Geometry, &Plane)>,
    ) -> Result<(&DisparityMap, BandStats), DepthError> {
        let mut plan = Plan::new(&self.full);
        match &mut self.probe {
            Some(probe) => probe.search(left, right, &mut plan)?,
            // Too small for a plan.
            None => self.has_last = false,
        }
        if self.has_last {
            plan.add_map(&self.last);
        }
        if let Some((geometry, plane)) = ground {
            plan.add_plane(geometry, left.width(), plane);
        }
        let band = plan.finish(&self.matcher.config().band.margin)?;
        self.run_from(band, left, right)
    }

    /// Matches within a band, and repeats with wider ones while the band clips disparities.
    fn run_from(
        &mut self,
        mut band: Band,
        left: &ImageView<'_>,
        right: &ImageView<'_>,
    ) -> Result<(&DisparityMap, BandStats), DepthError> {
        let mut stats = BandStats::default();
        loop {
            self.matcher.run(left, right, &band)?;
            stats.searched_ratio += band.searched_ratio(self.full.count());
            let max_reruns = self.matcher.config().band.max_reruns;
            let wider = if stats.reruns + 1 == max_reruns {
                self.full.clone()
            } else {
                self.widened(&band, left.width())?
            };
            if stats.reruns == max_reruns || wider == band || !self.is_clipped(&band, left.width())
            {
                break;
            }
            band = wider;
            stats.reruns += 1;
        }
        self.last.clone_from(self.matcher.map());
        self.has_last = true;
        Ok((&self.last, stats))
    }

    /// Whether a block is clipped at the lower and at the upper end: many of its pixels are at an
    /// end of the band that is not an end of the full range.
    fn clipped(&self, band: &Band, width: usize, block: usize) -> [bool; 2] {
        let rows = block..(block + BLOCK_ROWS).min(band.height());
        let min_clipped =
            self.matcher.config().band.min_clipped_ratio * (width * rows.len()) as f64;
        [0, 1].map(|end| {
            let clipped = rows
                .clone()
                .filter(|y| band.row(*y)[end] != self.full.row(*y)[end]);
            let at_end = clipped
                .map(|y| self.matcher.stats().at_end[y][end])
                .sum::<u32>();
            f64::from(at_end) > min_clipped
        })
    }

    fn is_clipped(&self, band: &Band, width: usize) -> bool {
        let mut blocks = (0..band.height()).step_by(BLOCK_ROWS);
        blocks.any(|block| self.clipped(band, width, block) != [false; 2])
    }

    /// The band, widened where it clipped disparities.
    fn widened(&self, band: &Band, width: usize) -> Result<Band, DepthError> {
        let widen_px = self.matcher.config().band.widen_px;
        let mut rows: Vec<[i32; 2]> = (0..band.height()).map(|y| band.row(y)).collect();
        for block in (0..band.height()).step_by(BLOCK_ROWS) {
            let [low, high] = self.clipped(band, width, block);
            // A clipped object may extend to the blocks above and below.
            let near = block.saturating_sub(BLOCK_ROWS)..(block + 2 * BLOCK_ROWS).min(rows.len());
            for y in near {
                let full = self.full.row(y);
                if low {
                    rows[y][0] = rows[y][0].min(band.row(y)[0] - widen_px).max(full[0]);
                }
                if high {
                    rows[y][1] = rows[y][1].max(band.row(y)[1] + widen_px).min(full[1]);
                }
            }
        }
        Band::rows(&rows)
    }
}

#[cfg(test)]
mod tests;
