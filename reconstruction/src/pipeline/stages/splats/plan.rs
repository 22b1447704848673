//! Which keyframes train which sector.

use std::collections::BTreeSet;

use camera_models::Lens;
use rayon::prelude::*;
use splats::{CellVisibility, Cells};

use super::config::SplatsConfig;
use super::keyframes::{CameraKeyframes, ChosenKeyframe};
use super::views::{Inputs, ViewMaker};
use crate::pipeline::StageError;

/// Pixels between two measured points of a keyframe.
const POINT_STEP_PX: usize = 16;

/// Sectors of a walk.
pub(super) struct Plan {
    pub(super) cells: Cells,
    sectors: Vec<SectorKeyframes>,
}

/// Numbers of the keyframes of a sector.
struct SectorKeyframes {
    /// At positions in its cell, held-out ones too.
    inside: BTreeSet<usize>,
    /// Those of the training that see the cell from outside.
    beside: BTreeSet<usize>,
}

impl Plan {
    /// Divides keyframes by the positions of their left cameras. Depths are read where there are
    /// several cells.
    pub(super) fn new(
        inputs: &Inputs<'_>,
        cameras: &[CameraKeyframes<'_>],
    ) -> Result<Self, StageError> {
        let config = inputs.config;
        let chosen = || cameras.iter().flat_map(|of| &of.keyframes);
        let center = |chosen: &ChosenKeyframe| chosen.keyframe.world_from_left.translation_m();
        let positions: Vec<[f64; 3]> = chosen().map(center).collect();
        let most = most_keyframes(config);
        let cells = Cells::of_positions(&positions, most, &config.sectors);
        let count = cells.count();
        let seen = match count {
            1 => Vec::new(),
            _ => seen(inputs, cameras, &cells)?,
        };
        let held_out: Vec<bool> = chosen().map(|chosen| chosen.is_held_out).collect();
        let beside = (config.sectors.overlap * most as f64) as usize;
        let sectors = (0..count).map(|cell| {
            let is_inside = |number: usize| cells.cell_of(positions[number]) == cell;
            let left_out = |number: usize| held_out[number] || is_inside(number);
            let from_outside =
                CellVisibility::from_outside(&seen, cell, beside, &config.sectors, left_out);
            SectorKeyframes {
                inside: (0..positions.len()).filter(|k| is_inside(*k)).collect(),
                beside: from_outside.into_iter().collect(),
            }
        });
        Ok(Self {
            sectors: sectors.collect(),
            cells,
        })
    }

    /// Number of sectors, at least one.
    pub(super) fn len(&self) -> usize {
        self.sectors.len()
    }

    /// Whether a keyframe is inside of a sector, by its number.
    pub(super) fn is_inside(&self, sector: usize, keyframe: usize) -> bool {
        self.sectors[sector].inside.contains(&keyframe)
    }

    /// Keyframes of a sector. Where there are several, instants are counted in each of them.
    pub(super) fn keyframes<'a>(
        &self,
        sector: usize,
        cameras: &[CameraKeyframes<'a>],
    ) -> Vec<CameraKeyframes<'a>> {
        let SectorKeyframes { inside, beside } = &self.sectors[sector];
        let is_of = |k: &ChosenKeyframe| inside.contains(&k.number) || beside.contains(&k.number);
        let mut of_sector: Vec<_> = cameras.iter().map(|of| of.of(is_of)).collect();
        if self.len() > 1 {
            let all = of_sector.iter().flat_map(|of| &of.keyframes);
            let instants: BTreeSet<u32> = all.map(|chosen| chosen.instant).collect();
            let instants: Vec<u32> = instants.into_iter().collect();
            for chosen in of_sector.iter_mut().flat_map(|of| &mut of.keyframes) {
                chosen.instant = instants.partition_point(|k| *k < chosen.instant) as u32;
            }
        }
        of_sector
    }
}

/// Most keyframes inside of a sector: one has two views if right images are used.
fn most_keyframes(config: &SplatsConfig) -> usize {
    let views = if config.right_images { 2 } else { 1 };
    (config.sectors.views / views).max(1)
}

/// What keyframes see of the cells, by their numbers.
fn seen(
    inputs: &Inputs<'_>,
    cameras: &[CameraKeyframes<'_>],
    cells: &Cells,
) -> Result<Vec<CellVisibility>, StageError> {
    let mut all = Vec::new();
    for of in cameras {
        let (maker, lens) = (ViewMaker::new(inputs, of), Lens::new(&of.camera.left));
        let width = of.camera.left.width as usize;
        let points = |chosen: &ChosenKeyframe| {
            let depth_m = maker.depth_of(chosen)?.depth_m;
            let usable = (0..depth_m.len()).filter(|pixel| {
                let at = [pixel % width, pixel / width];
                at.iter().all(|v| v % POINT_STEP_PX == POINT_STEP_PX / 2) && depth_m[*pixel] > 0.0
            });
            let point = |pixel: usize| {
                let ray = lens.unproject([(pixel % width) as f64, (pixel / width) as f64])?;
                let scale = f64::from(depth_m[pixel]) / ray[2];
                Some(
                    chosen
                        .keyframe
                        .world_from_left
                        .apply(ray.map(|v| v * scale)),
                )
            };
            Ok(CellVisibility::of_points(cells, usable.filter_map(point)))
        };
        let of_camera = of.keyframes.par_iter().map(points);
        all.extend(of_camera.collect::<Result<Vec<CellVisibility>, StageError>>()?);
    }
    Ok(all)
}
