//! A matcher that looks for no more than a scene needs.
//!
//! Contract: each pair is matched within a band that is planned from a coarse look at it, from the map before and, where it is told, from
//! the ground ([`crate::band::plan`]). Where many pixels of some rows end up at an end of the band that is not one of
//! all there can be, the band is widened there and the pair matched again. So what a map of all disparities
//! would show is lost only where it is too small for the coarse look, new, and away from the ends of the band;
//! `docs/depth.md` says how much that is.

use crate::band::Band;
use crate::band::plan::{Margin, Plan, Plane, Probe};
use crate::error::DepthError;
use crate::image::ImageView;
use crate::map::{DisparityMap, Geometry};
use crate::matcher::Matcher;
use crate::settings::Settings;

/// Matches pairs that follow each other.
#[derive(Debug)]
pub struct BandedMatcher {
    matcher: Matcher,
    full: Band,
    probe: Option<Probe>,
    has_last: bool,
    last: DisparityMap,
}

/// What a band has spared.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BandStats {
    /// Disparities that were looked for, as a share of all; those of further runs are added.
    pub searched_ratio: f64,
    /// Runs after the first one, since the band had to be widened.
    pub reruns: u32,
}

/// Rows that are looked at together for pixels at an end of their band.
const BLOCK_ROWS: usize = 8;
/// Share of a block's pixels at an end from which on it is widened.
const MIN_CLIPPED_RATIO: f64 = 0.02;
/// By how much, px.
const WIDEN_PX: i32 = 16;
/// Runs after the first; the last of them looks for everything.
const MAX_RERUNS: u32 = 3;

impl BandedMatcher {
    /// For pictures of `width` columns, and the rows of `full`, which holds all disparities that may be looked for.
    ///
    /// # Errors
    /// [`DepthError::Settings`].
    pub fn new(settings: Settings, width: usize, full: Band) -> Result<Self, DepthError> {
        Ok(Self {
            matcher: Matcher::new(settings, width, full.height())?,
            probe: Probe::new(&full, width)?,
            full,
            has_last: false,
            last: DisparityMap::default(),
        })
    }

    /// What follows has nothing to do with what was.
    pub fn reset(&mut self) {
        self.has_last = false;
    }

    /// The matcher.
    pub fn matcher(&self) -> &Matcher {
        &self.matcher
    }

    /// Matches a pair.
    ///
    /// # Errors
    /// As [`Matcher::run`].
    pub fn run(
        &mut self,
        left: &ImageView<'_>,
        right: &ImageView<'_>,
        ground: Option<(&Geometry, &Plane)>,
    ) -> Result<(&DisparityMap, BandStats), DepthError> {
        let mut plan = Plan::new(&self.full);
        match &mut self.probe {
            Some(probe) => probe.search(left, right, &mut plan)?,
            // Too small to be worth a plan.
            None => self.has_last = false,
        }
        if self.has_last {
            plan.add_map(&self.last);
        }
        if let Some((geometry, plane)) = ground {
            plan.add_plane(geometry, left.width(), plane);
        }
        let band = plan.finish(&Margin::WALK)?;
        self.run_from(band, left, right)
    }

    /// Matches in a band, and again in wider ones as long as it cuts something off.
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
            let wider = match stats.reruns + 1 {
                MAX_RERUNS => self.full.clone(),
                _ => self.widened(&band, left.width())?,
            };
            if stats.reruns == MAX_RERUNS || wider == band || !self.is_clipped(&band, left.width())
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

    /// Whether many pixels of a block are at an end of their band that is not the end of all, for either end.
    fn clipped(&self, band: &Band, width: usize, block: usize) -> [bool; 2] {
        let rows = block..(block + BLOCK_ROWS).min(band.height());
        let min_clipped = MIN_CLIPPED_RATIO * (width * rows.len()) as f64;
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

    /// The band, wider where it cut something off.
    fn widened(&self, band: &Band, width: usize) -> Result<Band, DepthError> {
        let mut rows: Vec<[i32; 2]> = (0..band.height()).map(|y| band.row(y)).collect();
        for block in (0..band.height()).step_by(BLOCK_ROWS) {
            let [low, high] = self.clipped(band, width, block);
            // What is cut off here goes on above and below.
            let near = block.saturating_sub(BLOCK_ROWS)..(block + 2 * BLOCK_ROWS).min(rows.len());
            for y in near {
                let full = self.full.row(y);
                if low {
                    rows[y][0] = rows[y][0].min(band.row(y)[0] - WIDEN_PX).max(full[0]);
                }
                if high {
                    rows[y][1] = rows[y][1].max(band.row(y)[1] + WIDEN_PX).min(full[1]);
                }
            }
        }
        Band::rows(&rows)
    }
}

#[cfg(test)]
mod tests;
