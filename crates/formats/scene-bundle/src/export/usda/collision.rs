//! Colliders.

use std::fmt::Write;

use super::text::{self, array};
use crate::outputs::collision::{Collision, HeightLayer};

/// Adds convex parts and height layers in one scope.
pub(super) fn add(text: &mut String, shape: &Collision) {
    text.push_str("\n    def Scope \"Collision\"\n    {\n");
    for (number, part) in shape.parts.iter().enumerate() {
        let name = format!("{}_{number}", part.kind.name());
        mesh(text, &name, "convexHull", &part.vertices_m, &part.triangles);
    }
    for (number, layer) in shape.layers.iter().enumerate() {
        let (vertices, triangles) = of_layer(layer);
        if !triangles.is_empty() {
            mesh(
                text,
                &format!("layer_{number}"),
                "none",
                &vertices,
                &triangles,
            );
        }
    }
    text.push_str("    }\n");
}

/// Vertices at the centers of cells, and two triangles between each four that are known.
fn of_layer(layer: &HeightLayer) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let (columns, rows) = (layer.grid.columns, layer.grid.rows);
    let is_known = |cell: usize| !layer.heights_m[cell].is_nan();
    let mut triangles = Vec::new();
    for row in 1..rows {
        for column in 1..columns {
            let [c, d] = [row * columns + column - 1, row * columns + column];
            let [a, b] = [c - columns, d - columns];
            for triangle in [[a, b, d], [a, d, c]] {
                if triangle.into_iter().all(is_known) {
                    triangles.push(triangle);
                }
            }
        }
    }
    // Cells of no triangle are left out.
    let mut numbers = vec![u32::MAX; layer.grid.cells()];
    let mut vertices = Vec::new();
    for cell in triangles.as_flattened() {
        if numbers[*cell] == u32::MAX {
            numbers[*cell] = vertices.len() as u32;
            let [x, y] = layer.grid.center_m(*cell);
            vertices.push([x, y, f64::from(layer.heights_m[*cell])]);
        }
    }
    let numbered = triangles.iter().map(|own| own.map(|cell| numbers[cell]));
    (vertices, numbered.collect())
}

fn mesh(
    text: &mut String,
    name: &str,
    approximation: &str,
    vertices: &[[f64; 3]],
    triangles: &[[u32; 3]],
) {
    let [low, high] = [f64::min as fn(f64, f64) -> f64, f64::max].map(|pick| {
        let bound = |k: usize| vertices.iter().map(|x| x[k]).reduce(pick).unwrap_or(0.0);
        [0, 1, 2].map(bound)
    });
    // Writing to a string does not fail.
    let _ = write!(
        text,
        "        def Mesh \"{name}\" (\n            \
         prepend apiSchemas = [\"PhysicsCollisionAPI\", \"PhysicsMeshCollisionAPI\"]\n        )\n        \
         {{\n            uniform token purpose = \"guide\"\n            \
         uniform token subdivisionScheme = \"none\"\n            \
         uniform token orientation = \"rightHanded\"\n            \
         bool physics:collisionEnabled = 1\n            \
         uniform token physics:approximation = \"{approximation}\"\n            \
         float3[] extent = [{}, {}]\n",
        tuple(&low),
        tuple(&high)
    );
    let counts = triangles.iter().map(|_| 3);
    array(text, "    int[] faceVertexCounts", counts, "");
    let indices = triangles.as_flattened().iter();
    array(text, "    int[] faceVertexIndices", indices, "");
    array(text, "    point3f[] points", vertices.iter().map(tuple), "");
    text.push_str("        }\n");
}

/// Of 32 bits, as USD has points.
fn tuple(v: &[f64; 3]) -> String {
    text::tuple(&v.map(|v| v as f32))
}
