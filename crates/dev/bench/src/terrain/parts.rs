//! Convex parts: foot-height error against their number.

use std::collections::HashMap;

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};
use terrain::ConvexConfig;
use terrain::convex::{Collision, HeightLayer, collision_parts};

use super::scores::Quantiles;
use super::surface::Surface;
use super::truth::Truth;
use crate::meter::timed;

/// Ratios to the default of the area that a part may cover beyond what was observed.
const RATIOS: [f64; 7] = [0.02, 0.04, 0.08, 0.2, 0.4, 1.0, 2.0];
/// Parts this far from a sole belong to another level, m.
const LEVEL_M: f64 = 0.4;
/// Edge of a cell of the table of parts, m.
const CELL_M: f64 = 0.5;

/// A point of the curve.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(crate) struct Row {
    /// Maximum area beyond what was observed, as a share of that of the part.
    pub(crate) uncovered_share: f64,
    pub(crate) parts: usize,
    pub(crate) parts_per_100_m2: f64,
    /// Collision surface above the true ground under soles.
    pub(crate) sole_height: Quantiles,
    /// Collision surface above the maps.
    pub(crate) map_p95_mm: f64,
    /// Points under soles without any surface.
    pub(crate) holes: usize,
    pub(crate) seconds: f64,
}

/// The configurations of the curve, from many parts to few.
pub(crate) fn configs() -> impl Iterator<Item = ConvexConfig> {
    RATIOS.into_iter().map(|ratio| {
        let mut config = ConvexConfig::default();
        config.max_uncovered_share *= ratio;
        config.max_uncovered_m2 *= ratio;
        config
    })
}

/// The curve of a walk.
pub(crate) fn curve(surface: &Surface, truth: &Truth<'_>) -> Vec<Row> {
    let row = |config: ConvexConfig| {
        let Surface {
            planes,
            edges,
            levels,
            ..
        } = surface;
        let (parts, took) = timed(|| collision_parts(planes, edges, levels, &config));
        let table = Table::new(&parts);
        let soles = truth.footprints.iter().flat_map(|print| &print.ground);
        let errors: Vec<Option<f64>> = soles.map(|x| Some(table.height(*x)? - x[2])).collect();
        Row {
            uncovered_share: config.max_uncovered_share,
            parts: parts.report.parts,
            parts_per_100_m2: parts.report.parts_per_100_m2,
            sole_height: Quantiles::of(errors.iter().flatten().copied()),
            map_p95_mm: 1e3 * parts.report.height_errors.p95_m,
            holes: errors.iter().filter(|error| error.is_none()).count(),
            seconds: took.wall_s,
        }
    };
    configs().map(row).collect()
}

/// Upper faces of parts by their place, and height layers.
struct Table<'a> {
    faces: HashMap<[i32; 2], Vec<Vec<Vector3<f64>>>>,
    layers: &'a [HeightLayer],
}

impl<'a> Table<'a> {
    fn new(collision: &'a Collision) -> Self {
        let mut faces: HashMap<[i32; 2], Vec<Vec<Vector3<f64>>>> = HashMap::new();
        for part in &collision.parts {
            // Corners of the surface come first.
            let face: Vec<Vector3<f64>> = part.vertices[..part.vertices.len() / 2]
                .iter()
                .map(|x| Vector3::from(*x))
                .collect();
            let range = |k: usize| {
                let least = face.iter().map(|x| x[k]).fold(f64::INFINITY, f64::min);
                let most = face.iter().map(|x| x[k]).fold(f64::NEG_INFINITY, f64::max);
                (least / CELL_M).floor() as i32..=(most / CELL_M).floor() as i32
            };
            for x in range(0) {
                for y in range(1) {
                    faces.entry([x, y]).or_default().push(face.clone());
                }
            }
        }
        Self {
            faces,
            layers: &collision.layers,
        }
    }

    /// The highest surface near a point.
    fn height(&self, [x, y, z]: [f64; 3]) -> Option<f64> {
        let cell = [x, y].map(|v| (v / CELL_M).floor() as i32);
        let faces = self.faces.get(&cell).map_or(&[][..], Vec::as_slice);
        let of_parts = faces.iter().filter_map(|face| height(face, [x, y]));
        let of_layers = self.layers.iter().filter_map(|layer| layer.height_at(x, y));
        of_parts
            .chain(of_layers)
            .filter(|height| (height - z).abs() < LEVEL_M)
            .reduce(f64::max)
    }
}

/// Height of a plane polygon at a place inside of it.
fn height(face: &[Vector3<f64>], at: [f64; 2]) -> Option<f64> {
    let at = Vector2::from(at);
    let (origin, rest) = face.split_first()?;
    let fan = rest.windows(2);
    fan.filter_map(|pair| {
        let (u, v) = ((pair[0] - origin).xy(), (pair[1] - origin).xy());
        let area = u.x * v.y - u.y * v.x;
        if area.abs() < 1e-10 {
            return None;
        }
        let d = at - origin.xy();
        let of_u = (d.x * v.y - d.y * v.x) / area;
        let of_v = (u.x * d.y - u.y * d.x) / area;
        let is_inside = of_u >= -1e-6 && of_v >= -1e-6 && of_u + of_v <= 1.0 + 1e-6;
        is_inside.then(|| origin.z + of_u * (pair[0].z - origin.z) + of_v * (pair[1].z - origin.z))
    })
    .next()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_have_their_heights() {
        let face = [
            [0.0, 0.0, 1.0],
            [2.0, 0.0, 2.0],
            [2.0, 2.0, 2.0],
            [0.0, 2.0, 1.0],
        ];
        let face = face.map(Vector3::from);
        assert!((height(&face, [1.0, 1.5]).unwrap() - 1.5).abs() < 1e-12);
        assert_eq!(height(&face, [2.5, 1.0]), None);
    }
}
