//! Heights of a collision shape at places, from its faces and height layers themselves.

use std::collections::HashMap;

use nalgebra::{Vector2, Vector3};
use scene_bundle::outputs::collision::{Collision, PartKind};
use terrain::convex::HeightLayer;

/// Cosine of the steepest face that is looked at from above.
const MIN_UP: f64 = 1e-3;
/// Edge of a cell of the table of faces, m.
const CELL_M: f64 = 0.25;

/// Names of what can be highest.
pub(super) const KINDS: [&str; 4] = ["ground", "wall", "obstacle", "layer"];

/// Upper faces of the parts by their place, and height layers.
pub(super) struct Probe {
    faces: Vec<Face>,
    /// Numbers of the faces that touch a cell.
    cells: HashMap<[i32; 2], Vec<u32>>,
    layers: Vec<HeightLayer>,
}

/// A face seen from above.
struct Face {
    kind: PartKind,
    corners: [Vector3<f64>; 3],
    bounds: [Vector2<f64>; 2],
}

impl Probe {
    pub(super) fn new(collision: &Collision) -> Self {
        let faces = faces(collision);
        let mut cells: HashMap<[i32; 2], Vec<u32>> = HashMap::new();
        for (number, face) in faces.iter().enumerate() {
            let [low, high] = face.bounds.map(cell);
            for x in low[0]..=high[0] {
                for y in low[1]..=high[1] {
                    cells.entry([x, y]).or_default().push(number as u32);
                }
            }
        }
        let layer = |layer: &scene_bundle::outputs::collision::HeightLayer| HeightLayer {
            cell_m: layer.grid.cell_m,
            origin: layer.grid.origin_m,
            size: [layer.grid.columns, layer.grid.rows],
            heights: layer.heights_m.clone(),
        };
        Self {
            faces,
            cells,
            layers: collision.layers.iter().map(layer).collect(),
        }
    }

    /// The highest surface within a distance of a height, m, and what it is.
    pub(super) fn highest(
        &self,
        at: Vector2<f64>,
        height_m: f64,
        within_m: f64,
    ) -> Option<(f64, usize)> {
        let kind = |kind: PartKind| PartKind::ALL.iter().position(|own| *own == kind);
        let numbers = self.cells.get(&cell(at)).map_or(&[][..], Vec::as_slice);
        let of_faces = numbers.iter().filter_map(|number| {
            let face = &self.faces[*number as usize];
            Some((face.height(at)?, kind(face.kind)?))
        });
        let of_layers = self
            .layers
            .iter()
            .filter_map(|layer| Some((layer.height_at(at.x, at.y)?, PartKind::ALL.len())));
        of_faces
            .chain(of_layers)
            .filter(|(height, _)| (height - height_m).abs() < within_m)
            .max_by(|a, b| a.0.total_cmp(&b.0))
    }
}

fn cell(at: Vector2<f64>) -> [i32; 2] {
    [at.x, at.y].map(|v| (v / CELL_M).floor() as i32)
}

/// Faces that point upwards.
fn faces(collision: &Collision) -> Vec<Face> {
    let of_part = |part: &scene_bundle::outputs::collision::ConvexPart| {
        let corners = part
            .triangles
            .iter()
            .map(|triangle| triangle.map(|index| Vector3::from(part.vertices_m[index as usize])));
        let upward = corners.filter(|[a, b, c]| {
            let normal = (b - a).cross(&(c - a));
            normal.z > MIN_UP * normal.norm() && normal.z > 1e-9
        });
        let face = |corners: [Vector3<f64>; 3]| {
            let [a, b, c] = corners.map(|corner| corner.xy());
            Face {
                kind: part.kind,
                corners,
                bounds: [a.inf(&b).inf(&c), a.sup(&b).sup(&c)],
            }
        };
        upward.map(face).collect::<Vec<_>>()
    };
    collision.parts.iter().flat_map(of_part).collect()
}

impl Face {
    /// Height at a place below or above it, m.
    fn height(&self, at: Vector2<f64>) -> Option<f64> {
        let [low, high] = self.bounds;
        if at.x < low.x || at.x > high.x || at.y < low.y || at.y > high.y {
            return None;
        }
        let [a, b, c] = self.corners;
        let (u, v, d) = ((b - a).xy(), (c - a).xy(), at - a.xy());
        let area = u.perp(&v);
        let (of_b, of_c) = (d.perp(&v) / area, u.perp(&d) / area);
        let is_inside = of_b >= -1e-9 && of_c >= -1e-9 && of_b + of_c <= 1.0 + 1e-9;
        is_inside.then(|| a.z + of_b * (b.z - a.z) + of_c * (c.z - a.z))
    }
}

#[cfg(test)]
mod tests {
    use scene_bundle::outputs::collision::ConvexPart;

    use super::*;

    #[test]
    fn the_highest_of_parts_and_layers_is_found() {
        let part = |kind, z: f64| ConvexPart {
            kind,
            plane: None,
            vertices_m: vec![
                [0.0, 0.0, z],
                [1.0, 0.0, z],
                [0.0, 1.0, z],
                [0.2, 0.2, z - 0.1],
            ],
            triangles: vec![[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]],
        };
        let collision = Collision {
            parts: vec![part(PartKind::Ground, 0.0), part(PartKind::Obstacle, 0.02)],
            ..Collision::default()
        };
        let mut probe = Probe::new(&collision);
        assert_eq!(probe.faces.len(), 2, "lower faces are left out");
        let layer = HeightLayer {
            cell_m: 1.0,
            origin: [0.0, 0.0],
            size: [2, 2],
            heights: vec![0.01; 4],
        };
        probe.layers.push(layer);
        let found = |x, y, ground| probe.highest(Vector2::new(x, y), ground, 0.4);
        assert_eq!(found(0.2, 0.3, 0.0), Some((0.02, 2)));
        let (height, kind) = found(0.9, 0.9, 0.0).expect("the layer");
        assert!((height - 0.01).abs() < 1e-6 && KINDS[kind] == "layer");
        assert_eq!(found(0.2, 0.3, 1.0), None, "another level");
        assert_eq!(found(1.2, 0.3, 0.0), None);
    }
}
