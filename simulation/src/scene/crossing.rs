//! Which sector owns a place, and how a pose gets over an edge.
//!
//! The owner is a function of the owner before and the position alone: never of what is in memory.
//! Two sectors meet where both depths ([`Area::depth_m`](super::Area)) are equal: on the common
//! side of areas that touch, in the middle of areas that overlap. The owner changes when the place
//! is the hysteresis beyond that, so that an agent on the border does not flicker between frames.

pub(super) mod config;

use cad_transforms::RigidTransform;

use super::data::SceneData;
use super::sector::{Sector, SectorEdge};

/// A pose in a sector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    /// Index of the sector that owns it.
    pub sector: usize,
    /// The pose in the frame of that sector.
    pub sector_from_body: RigidTransform,
}

impl SceneData {
    /// The edge over which a position leaves its sector, if it does. Positions are in the frame of
    /// the sector, m.
    ///
    /// # Panics
    /// For a sector that does not exist.
    pub fn leaves(&self, sector: usize, at_m: [f64; 3]) -> Option<&SectorEdge> {
        let here = &self.sectors[sector];
        let (edge, margin_m) = self.nearest(here, at_m)?;
        (margin_m > self.crossing.hysteresis_m).then_some(edge)
    }

    /// Whether a position left its sector by more than a distance, m.
    pub(crate) fn is_left(&self, sector: usize, at_m: [f64; 3], beyond_m: f64) -> bool {
        let nearest = self.nearest(&self.sectors[sector], at_m);
        nearest.is_some_and(|(_, margin_m)| margin_m > self.crossing.hysteresis_m + beyond_m)
    }

    /// The place after all edges that it leads over.
    ///
    /// # Panics
    /// For a sector that does not exist.
    #[must_use]
    pub fn cross(&self, place: &Place) -> Place {
        self.cross_by(place, |_| ())
    }

    /// The place after all edges that it leads over, each of which is visited.
    ///
    /// # Panics
    /// For a sector that does not exist.
    pub(crate) fn cross_by(&self, place: &Place, mut visit: impl FnMut(&SectorEdge)) -> Place {
        let mut place = *place;
        // A fast agent may pass through a small sector in one step.
        for _ in 0..self.sectors.len() {
            let at_m = place.sector_from_body.translation_m();
            let Some(edge) = self.leaves(place.sector, at_m) else {
                break;
            };
            visit(edge);
            place = Place {
                sector: edge.to,
                sector_from_body: edge.to_from_here.carry(&place.sector_from_body),
            };
        }
        place
    }

    /// The edge over which images are cross-faded at a position, and the weight of the other
    /// sector: a smoothstep of the signed distance to the border, 0.5 on it, the same from both
    /// sides. `None` inside of recordings and beyond the band.
    ///
    /// # Panics
    /// For a sector that does not exist.
    pub fn fade(&self, sector: usize, at_m: [f64; 3]) -> Option<(&SectorEdge, f64)> {
        let here = &self.sectors[sector];
        let (edge, margin_m) = self.nearest(here, at_m)?;
        let x = 0.5 + 0.5 * margin_m / self.crossing.fade_m;
        let is_inside = edge.is_imported && x > 0.0;
        let x = x.clamp(0.0, 1.0);
        is_inside.then_some((edge, x * x * (3.0 - 2.0 * x)))
    }

    /// Sectors at the other end of all edges of a sector, and the distance from a position to
    /// where each would own it, m; 0 beyond the border.
    pub(super) fn borders(
        &self,
        sector: usize,
        at_m: [f64; 3],
    ) -> impl Iterator<Item = (usize, f64)> {
        let edges = self.sectors[sector].edges.iter();
        edges.map(move |edge| {
            let there = &self.sectors[edge.to].area;
            let depth_m = there.depth_m(edge.to_from_here.apply(at_m));
            (edge.to, (-depth_m).max(0.0))
        })
    }

    /// The edge whose sector has a position deepest inside, and how far beyond the common border
    /// the position is, m; negative on this side. The first one of several.
    fn nearest<'a>(&'a self, here: &'a Sector, at_m: [f64; 3]) -> Option<(&'a SectorEdge, f64)> {
        let depth_m = here.area.depth_m(at_m);
        let mut best: Option<(&SectorEdge, f64)> = None;
        for edge in &here.edges {
            let there = self.sectors[edge.to].area;
            let depth_there_m = there.depth_m(edge.to_from_here.apply(at_m));
            let margin_m = 0.5 * (depth_there_m - depth_m);
            // Outside of both there is no border to cross.
            let is_usable = depth_there_m >= 0.0 || depth_m >= 0.0;
            if is_usable && best.is_none_or(|(_, of_best)| margin_m > of_best) {
                best = Some((edge, margin_m));
            }
        }
        best
    }
}

#[cfg(test)]
mod tests;
