//! What starts and goals are drawn from: cells of free ground, recorded views.

use cad_transforms::RigidTransform;

use crate::ground::Cover;
use crate::scene::Area;
use crate::world::terrain::Terrain;

/// A cell of ground on which an agent can stand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Cell {
    pub(crate) sector: u32,
    pub(crate) center_m: [f64; 2],
    pub(crate) edge_m: f64,
    pub(crate) height_m: f64,
}

/// A recorded camera with the sector that owns its position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct View {
    pub(crate) sector: u32,
    pub(crate) world_from_camera: RigidTransform,
}

/// Cells and views of all sectors, each of the one sector that owns it.
#[derive(Clone, Debug, Default)]
pub(crate) struct Candidates {
    pub(crate) cells: Vec<Cell>,
    pub(crate) views: Vec<View>,
}

impl Candidates {
    /// Free cells of the component of each sector whose centers have the clearance but for the
    /// half diagonal of a cell, so that no position with enough clearance is left out.
    pub(crate) fn new(terrains: &[Terrain], min_clearance_m: f64) -> Self {
        let mut candidates = Self::default();
        for sector in 0..terrains.len() {
            candidates.add_cells(terrains, sector, min_clearance_m);
            candidates.add_views(terrains, sector);
        }
        candidates
    }

    fn add_cells(&mut self, terrains: &[Terrain], sector: usize, min_clearance_m: f64) {
        let terrain = &terrains[sector];
        for (number, level) in terrain.ground.levels().iter().enumerate() {
            let least_m = min_clearance_m - std::f64::consts::FRAC_1_SQRT_2 * level.grid.cell_m;
            for cell in 0..level.grid.cells() {
                let height_m = f64::from(level.elevation[cell]);
                let center_m = level.grid.center_m(cell);
                let is_usable = height_m.is_finite()
                    && matches!(terrain.ground.cover(center_m, number), Cover::Free)
                    && terrain.component.is_some()
                    && terrain.ground.component(center_m, number) == terrain.component
                    && terrain.ground.clearance_m(center_m, number) >= least_m
                    && owns(terrains, sector, [center_m[0], center_m[1], height_m]);
                if is_usable {
                    self.cells.push(Cell {
                        sector: sector as u32,
                        center_m,
                        edge_m: level.grid.cell_m,
                        height_m,
                    });
                }
            }
        }
    }

    fn add_views(&mut self, terrains: &[Terrain], sector: usize) {
        let Some(references) = &terrains[sector].references else {
            return;
        };
        for world_from_camera in references.poses() {
            if owns(terrains, sector, world_from_camera.translation_m()) {
                self.views.push(View {
                    sector: sector as u32,
                    world_from_camera: *world_from_camera,
                });
            }
        }
    }
}

/// Whether of all sectors of the same recording this one has a position deepest inside of its
/// area; of equal ones the first.
fn owns(terrains: &[Terrain], sector: usize, at_m: [f64; 3]) -> bool {
    let here = &terrains[sector];
    let depth_m = |area: &Area| area.depth_m(at_m);
    let own_m = depth_m(&here.area);
    own_m >= 0.0
        && terrains.iter().enumerate().all(|(number, other)| {
            let is_same_frame = std::sync::Arc::ptr_eq(&other.ground, &here.ground);
            let other_m = match number != sector && is_same_frame {
                true => depth_m(&other.area),
                false => return true,
            };
            other_m < own_m || (other_m == own_m && number > sector)
        })
}
