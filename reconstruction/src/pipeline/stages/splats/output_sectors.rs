//! Sectors that the bundle has: those with Gaussians, and their boxes.

use splats::{CellBox, Cells, Part, Plane, Splats};

use super::sector_result::SectorResult;

/// A sector with Gaussians.
pub(super) struct OutputSector<'a> {
    /// Number of its cell.
    pub(super) cell: usize,
    pub(super) part: &'a Part,
    /// Numbers of the views that trained it.
    pub(super) training: &'a [usize],
    /// Its cell within the box of all Gaussians; along z that of its own.
    pub(super) bounds: SectorBox,
}

/// A box in the world, m; its corners belong to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct SectorBox {
    pub(super) min_m: [f64; 3],
    pub(super) max_m: [f64; 3],
}

/// Sectors with Gaussians, in order of their cells.
pub(super) fn output_sectors<'a>(
    cells: &Cells,
    sectors: &'a [SectorResult],
) -> Vec<OutputSector<'a>> {
    let trained = sectors.iter().enumerate().filter_map(|(cell, sector)| {
        let part = sector.part.as_ref()?;
        Some(OutputSector {
            cell,
            part,
            training: &sector.found.training,
            bounds: SectorBox::of(&part.splats),
        })
    });
    let mut kept: Vec<OutputSector<'a>> = trained.collect();
    if let Some(all) = SectorBox::around(&kept) {
        for of in &mut kept {
            let cell = cells.bounds(of.cell);
            for k in 0..2 {
                of.bounds.min_m[k] = cell.min_m[k].max(all.min_m[k]);
                of.bounds.max_m[k] = cell.max_m[k].min(all.max_m[k]);
            }
        }
    }
    kept
}

impl SectorBox {
    /// Around the means of Gaussians.
    fn of(splats: &Splats) -> Self {
        let along = |of: fn(f32, f32) -> f32| {
            [0, 1, 2].map(|k| {
                let means = splats.planes()[Plane::POSITION + k].iter().copied();
                f64::from(means.reduce(of).unwrap_or(0.0))
            })
        };
        Self {
            min_m: along(f32::min),
            max_m: along(f32::max),
        }
    }

    /// The part of the world above a cell, at the heights of this box.
    pub(super) fn above(&self, cell: CellBox) -> Self {
        let [min_m, max_m] = [(cell.min_m, self.min_m), (cell.max_m, self.max_m)]
            .map(|([x, y], [_, _, z])| [x, y, z]);
        Self { min_m, max_m }
    }

    /// Around the boxes of all sectors; `None` without any.
    pub(super) fn around(kept: &[OutputSector<'_>]) -> Option<Self> {
        let boxes = kept.iter().map(|of| of.bounds);
        boxes.reduce(|a, b| Self {
            min_m: [0, 1, 2].map(|k| a.min_m[k].min(b.min_m[k])),
            max_m: [0, 1, 2].map(|k| a.max_m[k].max(b.max_m[k])),
        })
    }

    /// Larger by a distance on all sides, m.
    pub(super) fn widened(&self, by_m: f64) -> Self {
        Self {
            min_m: self.min_m.map(|v| v - by_m),
            max_m: self.max_m.map(|v| v + by_m),
        }
    }

    /// Whether two boxes touch on the ground.
    pub(super) fn touches(&self, other: &Self) -> bool {
        (0..2).all(|k| self.min_m[k] <= other.max_m[k] && other.min_m[k] <= self.max_m[k])
    }

    /// Indices of the Gaussians whose means are in the box.
    pub(super) fn indices(&self, splats: &Splats) -> Vec<usize> {
        let means = &splats.planes()[Plane::POSITION..];
        let is_inside = |index: &usize| {
            let along = |k: usize| self.min_m[k]..=self.max_m[k];
            (0..3).all(|k| along(k).contains(&f64::from(means[k][*index])))
        };
        (0..splats.len()).filter(is_inside).collect()
    }
}
