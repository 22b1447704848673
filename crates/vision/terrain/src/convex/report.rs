//! How well the collision surface stands for the ground.

use rayon::prelude::*;

use super::faces::Faces;
use super::layer::{HeightLayer, corners, weighted};
use crate::evaluate::ErrorQuantiles;
use crate::maps::{FREE, Level};

/// Places along an edge of a cell at which the surface is compared; the middle one is its center.
const ACROSS: usize = 3;
/// Places of a cell.
const PLACES: usize = ACROSS * ACROSS;

/// What parts cost and how well they stand for the ground.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CollisionReport {
    /// Number of parts; each height layer is one.
    pub parts: usize,
    /// Parts per 100 m2 of ground.
    pub parts_per_100_m2: f64,
    /// Heights of the collision surface above the maps, at nine places of each free cell. Between
    /// samples of a step the height of the ground is anything from the lower to the upper one.
    pub height_errors: ErrorQuantiles,
    /// Volume of the collision surface above the maps, m3.
    pub volume_added_m3: f64,
    /// Volume that the collision surface lacks, m3.
    pub volume_missing_m3: f64,
}

/// The report of a number of parts, whose faces and layers are compared with levels.
pub(super) fn report(
    parts: usize,
    faces: &Faces,
    levels: &[Level],
    layers: &[HeightLayer],
) -> CollisionReport {
    let mut report = CollisionReport {
        parts: parts + layers.len(),
        ..CollisionReport::default()
    };
    let (mut errors, mut area) = (Vec::new(), 0.0);
    for (level, layer) in levels.iter().zip(layers) {
        let cell_m2 = level.cell_m * level.cell_m;
        let spacing = level.cell_m / ACROSS as f64;
        let of_cell = |index: &usize| {
            places(level.center(*index), spacing).map(|at| error(faces, level, layer, at))
        };
        let free = (0..layer.heights.len()).filter(|index| level.occupancy[*index] == FREE);
        let free: Vec<usize> = free.collect();
        area += cell_m2 * free.len() as f64;
        let of_cells: Vec<[Option<f64>; PLACES]> = free.par_iter().map(of_cell).collect();
        for error in of_cells.iter().flatten().flatten() {
            let volume = error * cell_m2 / PLACES as f64;
            errors.push(*error);
            report.volume_added_m3 += volume.max(0.0);
            report.volume_missing_m3 += (-volume).max(0.0);
        }
    }
    report.parts_per_100_m2 = 100.0 * report.parts as f64 / area.max(1e-9);
    report.height_errors = ErrorQuantiles::of(errors);
    report
}

fn places(center: [f64; 2], spacing: f64) -> [[f64; 2]; PLACES] {
    let half = (ACROSS / 2) as f64;
    std::array::from_fn(|place| {
        let step = [place % ACROSS, place / ACROSS];
        [0, 1].map(|k| center[k] + (step[k] as f64 - half) * spacing)
    })
}

/// Height of the collision surface above the ground of a level; `None` where that is not known, or
/// where there is no surface.
fn error(faces: &Faces, level: &Level, layer: &HeightLayer, at: [f64; 2]) -> Option<f64> {
    let corners = corners(level.cell_m, level.origin, level.size, at)?;
    let elevation = |index: usize| f64::from(level.elevation[index]);
    let ground = weighted(&corners, elevation);
    if ground.is_nan() {
        return None;
    }
    let of_layer = layer.height_at(at[0], at[1]);
    let surface = match (faces.top(at, ground), of_layer) {
        (Some(face), Some(layer)) => face.max(layer),
        (face, layer) => face.or(layer)?,
    };
    let known = corners.iter().map(|(index, _)| elevation(*index));
    let known = known.filter(|height| height.is_finite());
    let low = known.clone().fold(f64::INFINITY, f64::min);
    let high = known.fold(f64::NEG_INFINITY, f64::max);
    // Steeper than 45 degrees. Where between its samples a step is, the map does not know.
    let is_step = high - low > level.cell_m;
    Some(match is_step {
        true => surface - surface.clamp(low, high),
        false => surface - ground,
    })
}
