//! Collision geometry of a scene as shapes of the engine that do not move.

use rapier3d::math::{Pose, Rotation, Vector};
use rapier3d::parry::shape::{HeightField, HeightFieldCellStatus, HeightFieldFlags};
use rapier3d::parry::utils::Array2;
use rapier3d::prelude::{Collider, ColliderBuilder, SharedShape};
use scene_bundle::outputs::collision::{Collision, ConvexPart, HeightLayer};

use super::config::BodiesConfig;
use super::single::vector;
use crate::error::SimulationError;

/// Cells of a height field, whose triangles have numbers of 32 bits.
const MAX_CELLS: usize = 1 << 30;
/// Volume below which a part is flat, m3; that of the exports.
const MIN_VOLUME_M3: f32 = 1e-9;

/// Shapes of the engine.
pub(super) struct Ground {
    pub(super) colliders: Vec<Collider>,
    /// Convex parts without volume.
    pub(super) parts_left_out: usize,
    /// Of the geometry and the configuration.
    pub(super) hash: blake3::Hash,
}

impl Ground {
    pub(super) fn new(
        collision: &Collision,
        config: &BodiesConfig,
    ) -> Result<Self, SimulationError> {
        let mut hasher = blake3::Hasher::new();
        // Numbers in their shortest form that gives the same bits.
        hasher.update(format!("{config:?}").as_bytes());
        for count in [collision.parts.len(), collision.layers.len()] {
            hasher.update(&(count as u64).to_le_bytes());
        }
        let mut colliders = Vec::new();
        for (number, part) in collision.parts.iter().enumerate() {
            hasher.update(&(part.vertices_m.len() as u64).to_le_bytes());
            for value in part.vertices_m.as_flattened() {
                if !value.is_finite() {
                    let place = format!("collision part {number}");
                    return Err(refused(
                        place,
                        format!("a vertex at {value}"),
                        "finite numbers",
                    ));
                }
                hasher.update(&value.to_le_bytes());
            }
            colliders.extend(convex_part(part));
        }
        let parts_left_out = collision.parts.len() - colliders.len();
        for (number, layer) in collision.layers.iter().enumerate() {
            check_layer(number, layer)?;
            let grid = &layer.grid;
            for value in [grid.cell_m, grid.origin_m[0], grid.origin_m[1]] {
                hasher.update(&value.to_le_bytes());
            }
            for count in [grid.columns, grid.rows] {
                hasher.update(&(count as u64).to_le_bytes());
            }
            for height in &layer.heights_m {
                hasher.update(&height.to_le_bytes());
            }
            colliders.extend(height_field(layer));
        }
        let friction = config.friction as f32;
        let colliders = colliders.into_iter().map(|own| own.friction(friction));
        Ok(Self {
            colliders: colliders.map(|own| own.build()).collect(),
            parts_left_out,
            hash: hasher.finalize(),
        })
    }
}

fn refused(place: String, found: String, expected: &str) -> SimulationError {
    SimulationError::Scene {
        place,
        found,
        expected: expected.to_owned(),
    }
}

fn check_layer(number: usize, layer: &HeightLayer) -> Result<(), SimulationError> {
    let (grid, place) = (&layer.grid, format!("collision layer {number}"));
    let is_finite = grid.origin_m.iter().all(|v| v.is_finite()) && grid.cell_m.is_finite();
    if !is_finite || grid.cell_m <= 0.0 {
        let found = format!("cells of {} m from {:?}", grid.cell_m, grid.origin_m);
        return Err(refused(place, found, "a size above 0 and a place"));
    }
    let cells = grid.columns.checked_mul(grid.rows);
    if cells.is_none_or(|cells| cells > MAX_CELLS) {
        let found = format!("{} by {} cells", grid.columns, grid.rows);
        return Err(refused(place, found, "at most 2^30 cells"));
    }
    if cells != Some(layer.heights_m.len()) {
        let found = format!("{} heights", layer.heights_m.len());
        return Err(refused(place, found, "one for each cell"));
    }
    match layer.heights_m.iter().find(|v| v.is_infinite()) {
        None => Ok(()),
        Some(height) => Err(refused(
            place,
            format!("a height of {height} m"),
            "finite numbers, or not-a-number where it is not known",
        )),
    }
}

/// The hull of a part, relative to its first vertex for the precision of its corners. `None`
/// without volume.
fn convex_part(part: &ConvexPart) -> Option<ColliderBuilder> {
    let origin = *part.vertices_m.first()?;
    let local = |vertex: &[f64; 3]| vector([0, 1, 2].map(|k| vertex[k] - origin[k]));
    let points: Vec<Vector> = part.vertices_m.iter().map(local).collect();
    let hull = ColliderBuilder::convex_hull(&points)?;
    // The hull of points of one plane has two faces and no volume.
    let volume_m3 = hull.shape.mass_properties(1.0).mass();
    (volume_m3 > MIN_VOLUME_M3).then(|| hull.translation(vector(origin)))
}

/// A layer as a height field, with the triangles that MuJoCo has: each cell between four samples is
/// cut from the sample of least x and y to that of greatest. `None` for a layer of one row or
/// column, or of which nothing is known.
fn height_field(layer: &HeightLayer) -> Option<ColliderBuilder> {
    let grid = &layer.grid;
    let (rows, columns) = (grid.rows, grid.columns);
    if rows < 2 || columns < 2 {
        return None;
    }
    let known = layer.heights_m.iter().copied().filter(|v| !v.is_nan());
    let lowest = known.reduce(f32::min)?;
    // The engine's height field has y up and its rows along z. It is rotated by 90 degrees about x,
    // so that its rows are ours from the last to the first. Column-major.
    let own = |i: usize, j: usize| layer.heights_m[(rows - 1 - i) * columns + j];
    let places = (0..columns).flat_map(|j| (0..rows).map(move |i| (i, j)));
    let heights = places.map(|(i, j)| match own(i, j) {
        height if height.is_nan() => lowest,
        height => height,
    });
    let heights = Array2::new(rows, columns, heights.collect());
    let extent = |count: usize| ((count - 1) as f64 * grid.cell_m) as f32;
    let scale = Vector::new(extent(columns), 1.0, extent(rows));
    // Bodies that slide over flat ground do not hit the edges between its triangles.
    let mut field = HeightField::with_flags(heights, scale, HeightFieldFlags::FIX_INTERNAL_EDGES);
    for i in 0..rows - 1 {
        for j in 0..columns - 1 {
            let is_unknown = |corners: [(usize, usize); 3]| {
                corners
                    .iter()
                    .any(|(down, right)| own(i + down, j + right).is_nan())
            };
            let mut status = HeightFieldCellStatus::default();
            status.set(
                HeightFieldCellStatus::LEFT_TRIANGLE_REMOVED,
                is_unknown([(0, 0), (1, 0), (0, 1)]),
            );
            status.set(
                HeightFieldCellStatus::RIGHT_TRIANGLE_REMOVED,
                is_unknown([(1, 0), (1, 1), (0, 1)]),
            );
            field.set_cell_status(i, j, status);
        }
    }
    let middle = |origin: f64, count: usize| origin + 0.5 * (count - 1) as f64 * grid.cell_m;
    let place = [
        middle(grid.origin_m[0], columns),
        middle(grid.origin_m[1], rows),
        0.0,
    ];
    let upright = Rotation::from_rotation_x(std::f32::consts::FRAC_PI_2);
    let pose = Pose::from_parts(vector(place), upright);
    Some(ColliderBuilder::new(SharedShape::new(field)).position(pose))
}
