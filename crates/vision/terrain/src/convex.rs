//! Convex parts for physics: prisms of planes, and a height layer for ground that is not plane.
//!
//! Contract: the surface of a prism is its plane, exact in height, with borders on the edges of the
//! plane. The height layer is lower than the prisms wherever one covers it, and steps beside them
//! do not smear into it. Where nothing was seen there is neither. The collision surface at a place
//! is the higher one. [`CollisionReport`] compares it with the maps. Things that are not plane and
//! not ground have parts with the feature `obstacles` only.

use std::collections::BTreeMap;

use crate::config::ConvexConfig;
use crate::edges::Edge;
use crate::evaluate::ErrorQuantiles;
use crate::maps::{FREE, Level};
use crate::planes::Planes;

mod hull;
mod layer;
#[cfg(feature = "obstacles")]
mod obstacles;
mod pieces;
mod prism;

pub use layer::HeightLayer;
#[cfg(feature = "obstacles")]
pub use obstacles::{Obstacle, obstacle_parts};
pub use prism::ConvexPart;

/// Edge of a cell of the table of parts, m.
const CELL_M: f64 = 0.25;
/// Parts farther from the ground of a level belong to another one, m.
const OTHER_LEVEL_M: f64 = 0.4;

/// What parts cost and how well they stand for the ground.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CollisionReport {
    /// Number of parts; each height layer is one.
    pub parts: usize,
    /// Parts per 100 m2 of ground.
    pub parts_per_100_m2: f64,
    /// Heights of the collision surface above the maps, in free cells.
    pub height_errors: ErrorQuantiles,
    /// Volume of the collision surface above the maps, m3.
    pub volume_added_m3: f64,
    /// Volume that the collision surface lacks, m3.
    pub volume_missing_m3: f64,
}

/// Parts for physics.
#[derive(Clone, Debug, PartialEq)]
pub struct Collision {
    /// Prisms of planes.
    pub parts: Vec<ConvexPart>,
    /// One layer per level.
    pub layers: Vec<HeightLayer>,
    /// See [`CollisionReport`].
    pub report: CollisionReport,
}

/// Parts of planes and levels.
pub fn collision_parts(
    planes: &Planes,
    edges: &[Edge],
    levels: &[Level],
    config: &ConvexConfig,
) -> Collision {
    let mut parts = Vec::new();
    for (number, plane) in planes.planes.iter().enumerate() {
        let of_plane: Vec<&Edge> = edges
            .iter()
            .filter(|edge| edge.plane_numbers().any(|own| own == number))
            .collect();
        if of_plane.is_empty() && plane.area_m2 < config.min_plane_m2 {
            continue;
        }
        for piece in pieces::pieces(plane, config) {
            parts.extend(prism::prism(number, plane, &piece, &of_plane, config));
        }
    }
    let table = Table::new(&parts);
    let layers: Vec<HeightLayer> = levels
        .iter()
        .map(|level| height_layer(planes, &parts, &table, level, config))
        .collect();
    let report = report(planes, &parts, &table, levels, &layers);
    Collision {
        parts,
        layers,
        report,
    }
}

/// Parts by the columns that their surfaces touch.
struct Table(BTreeMap<(i32, i32), Vec<u32>>);

impl Table {
    fn new(parts: &[ConvexPart]) -> Self {
        let mut table: BTreeMap<(i32, i32), Vec<u32>> = BTreeMap::new();
        for (number, part) in parts.iter().enumerate() {
            let surface = &part.vertices[..part.outline.len()];
            let range = |k: usize| {
                let low = surface.iter().map(|x| x[k]).fold(f64::INFINITY, f64::min);
                let high = surface
                    .iter()
                    .map(|x| x[k])
                    .fold(f64::NEG_INFINITY, f64::max);
                (low / CELL_M).floor() as i32..=(high / CELL_M).floor() as i32
            };
            for row in range(1) {
                for column in range(0) {
                    table.entry((row, column)).or_default().push(number as u32);
                }
            }
        }
        Self(table)
    }

    /// Heights of the surfaces of ground at a place, with their parts.
    fn heights<'a>(
        &'a self,
        planes: &'a Planes,
        parts: &'a [ConvexPart],
        [x, y]: [f64; 2],
    ) -> impl Iterator<Item = f64> + 'a {
        let [column, row] = [x, y].map(|v| (v / CELL_M).floor() as i32);
        let near = self.0.get(&(row, column)).map_or(&[][..], Vec::as_slice);
        near.iter().filter_map(move |number| {
            let part = &parts[*number as usize];
            let plane = &planes.planes[part.plane as usize];
            if plane.frame.normal.z <= 0.1 {
                return None;
            }
            part.height_at(plane, x, y)
        })
    }
}

fn height_layer(
    planes: &Planes,
    parts: &[ConvexPart],
    table: &Table,
    level: &Level,
    config: &ConvexConfig,
) -> HeightLayer {
    let mut heights = level.elevation.clone();
    for (index, layer_height) in heights.iter_mut().enumerate() {
        if !level.has_height(index) {
            continue;
        }
        let elevation = f64::from(level.elevation[index]);
        let is_covered = table
            .heights(planes, parts, level.center(index))
            .any(|height| (height - elevation).abs() <= config.max_plane_distance_m);
        if is_covered {
            // Below the lowest ground around, so that the slope to it is below a tread.
            let around = level
                .near(index, 1.5 * level.cell_m)
                .map(|(other, _)| level.lower[other]);
            let lowest = around.fold(level.lower[index], f32::min);
            *layer_height = lowest - config.layer_gap_m as f32;
        }
    }
    HeightLayer {
        cell_m: level.cell_m,
        origin: level.origin,
        size: level.size,
        heights,
    }
}

fn report(
    planes: &Planes,
    parts: &[ConvexPart],
    table: &Table,
    levels: &[Level],
    layers: &[HeightLayer],
) -> CollisionReport {
    let mut report = CollisionReport {
        parts: parts.len() + layers.len(),
        ..CollisionReport::default()
    };
    let (mut errors, mut area) = (Vec::new(), 0.0);
    for (level, layer) in levels.iter().zip(layers) {
        let cell_m2 = level.cell_m * level.cell_m;
        for index in 0..layer.heights.len() {
            if level.occupancy[index] != FREE {
                continue;
            }
            let elevation = f64::from(level.elevation[index]);
            let of_parts = table
                .heights(planes, parts, level.center(index))
                .filter(|height| (height - elevation).abs() < OTHER_LEVEL_M)
                .fold(f64::NEG_INFINITY, f64::max);
            let error = of_parts.max(f64::from(layer.heights[index])) - elevation;
            errors.push(error);
            area += cell_m2;
            match error > 0.0 {
                true => report.volume_added_m3 += error * cell_m2,
                false => report.volume_missing_m3 -= error * cell_m2,
            }
        }
    }
    report.parts_per_100_m2 = 100.0 * report.parts as f64 / area.max(1e-9);
    report.height_errors = ErrorQuantiles::of(errors);
    report
}
