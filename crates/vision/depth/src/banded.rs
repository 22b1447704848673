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
use crate::map::{DisparityMap, Geometry};
use crate::matcher::Matcher;
use crate::picture::Picture;
use crate::settings::Settings;

/// Matches pairs that follow each other.
#[derive(Debug)]
pub struct Banded {
    matcher: Matcher,
    full: Band,
    probe: Option<Probe>,
    has_last: bool,
    last: DisparityMap,
}

/// What a band has spared.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spared {
    /// Disparities that were looked for, as a share of all; those of further runs are added.
    pub share: f64,
    /// Runs after the first one, since the band had to be widened.
    pub runs_again: u32,
}

/// Rows that are looked at together for pixels at an end of their band.
const BLOCK: usize = 8;
/// Share of a block's pixels at an end from which on it is widened.
const MANY: f64 = 0.02;
/// By how much, px.
const WIDER: i32 = 16;
/// Runs after the first; the last of them looks for everything.
const MOST_RUNS: u32 = 3;

impl Banded {
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
    pub fn forget(&mut self) {
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
        left: &Picture<'_>,
        right: &Picture<'_>,
        ground: Option<(&Geometry, &Plane)>,
    ) -> Result<(&DisparityMap, Spared), DepthError> {
        let mut plan = Plan::new(&self.full);
        match &mut self.probe {
            Some(probe) => probe.look(left, right, &mut plan)?,
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
        left: &Picture<'_>,
        right: &Picture<'_>,
    ) -> Result<(&DisparityMap, Spared), DepthError> {
        let mut spared = Spared::default();
        loop {
            self.matcher.run(left, right, &band)?;
            spared.share += band.share_of(self.full.count());
            let wider = match spared.runs_again + 1 {
                MOST_RUNS => self.full.clone(),
                _ => self.wider(&band, left.width())?,
            };
            if spared.runs_again == MOST_RUNS || wider == band || !self.is_cut(&band, left.width())
            {
                break;
            }
            band = wider;
            spared.runs_again += 1;
        }
        self.last.clone_from(self.matcher.map());
        self.has_last = true;
        Ok((&self.last, spared))
    }

    /// Whether many pixels of a block are at an end of their band that is not the end of all, for either end.
    fn cut(&self, band: &Band, width: usize, block: usize) -> [bool; 2] {
        let rows = block..(block + BLOCK).min(band.height());
        let many = MANY * (width * rows.len()) as f64;
        [0, 1].map(|end| {
            let cut = rows
                .clone()
                .filter(|y| band.row(*y)[end] != self.full.row(*y)[end]);
            let at_end = cut.map(|y| self.matcher.seen().at_end[y][end]).sum::<u32>();
            f64::from(at_end) > many
        })
    }

    fn is_cut(&self, band: &Band, width: usize) -> bool {
        let mut blocks = (0..band.height()).step_by(BLOCK);
        blocks.any(|block| self.cut(band, width, block) != [false; 2])
    }

    /// The band, wider where it cut something off.
    fn wider(&self, band: &Band, width: usize) -> Result<Band, DepthError> {
        let mut rows: Vec<[i32; 2]> = (0..band.height()).map(|y| band.row(y)).collect();
        for block in (0..band.height()).step_by(BLOCK) {
            let [low, high] = self.cut(band, width, block);
            // What is cut off here goes on above and below.
            let near = block.saturating_sub(BLOCK)..(block + 2 * BLOCK).min(rows.len());
            for y in near {
                let full = self.full.row(y);
                if low {
                    rows[y][0] = rows[y][0].min(band.row(y)[0] - WIDER).max(full[0]);
                }
                if high {
                    rows[y][1] = rows[y][1].max(band.row(y)[1] + WIDER).min(full[1]);
                }
            }
        }
        Band::rows(&rows)
    }
}

#[cfg(test)]
mod tests;
