//! The simplified mesh of the ground as text of Universal Scene Description (OpenUSD).
//!
//! Contract: a stage in metres with z up, whose default prim is `/Terrain` with the mesh
//! `/Terrain/Ground`: no subdivision, a normal and a linear color per vertex. The mesh is a static
//! collider of its own triangles (UsdPhysics), so that simulators can stand on it.

use std::fmt::{Display, Write};
use std::path::Path;

use cad_transforms::output::{Existing, write};

use super::error::ExportError;
use super::summary::Summary;
use super::terrain_mesh::{description, linear_colors, note, simplified};
use crate::outputs::terrain::TerrainMesh;
use crate::scene::Scene;

pub(super) fn export(scene: &Scene, out: &Path) -> Result<Summary, ExportError> {
    let mesh = simplified(scene)?;
    write(out, to_text(&mesh).as_bytes(), Existing::Refuse)?;
    Ok(Summary {
        description: description(&mesh),
        notes: vec![note("this USD mesh")],
        lost: Vec::new(),
    })
}

fn to_text(mesh: &TerrainMesh) -> String {
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for position in &mesh.positions {
        for k in 0..3 {
            low[k] = low[k].min(position[k]);
            high[k] = high[k].max(position[k]);
        }
    }
    let linear = linear_colors().map(|v| v as f32);
    let colors = mesh.colors.iter();
    let colors = colors.map(|color| tuple(&color.map(|c| linear[usize::from(c)])));
    let extent = match mesh.positions.is_empty() {
        true => String::new(),
        false => format!(
            "        float3[] extent = [{}, {}]\n",
            tuple(&low),
            tuple(&high)
        ),
    };
    let mut text = format!(
        "#usda 1.0\n(\n    defaultPrim = \"Terrain\"\n    metersPerUnit = 1\n    upAxis = \"Z\"\n)\n\n\
         def Xform \"Terrain\" (\n    kind = \"component\"\n)\n{{\n    def Mesh \"Ground\" (\n        \
         prepend apiSchemas = [\"PhysicsCollisionAPI\", \"PhysicsMeshCollisionAPI\"]\n    )\n    {{\n\
         {extent}        uniform token subdivisionScheme = \"none\"\n        \
         uniform token orientation = \"rightHanded\"\n        \
         bool physics:collisionEnabled = 1\n        \
         uniform token physics:approximation = \"none\"\n"
    );
    let indices = mesh.triangles.as_flattened().iter();
    let counts = mesh.triangles.iter().map(|_| 3);
    array(&mut text, "int[] faceVertexCounts", counts, "");
    array(&mut text, "int[] faceVertexIndices", indices, "");
    let positions = mesh.positions.iter().map(tuple);
    array(&mut text, "point3f[] points", positions, "");
    let normals = mesh.normals.iter().map(tuple);
    let per_vertex = " (\n            interpolation = \"vertex\"\n        )";
    array(&mut text, "normal3f[] normals", normals, per_vertex);
    array(
        &mut text,
        "color3f[] primvars:displayColor",
        colors,
        per_vertex,
    );
    text.push_str("    }\n}\n");
    text
}

fn tuple(v: &[f32; 3]) -> String {
    format!("({}, {}, {})", v[0], v[1], v[2])
}

/// An attribute with its values and what follows them.
fn array<T: Display>(text: &mut String, name: &str, values: impl Iterator<Item = T>, end: &str) {
    // Writing to a string does not fail.
    let _ = write!(text, "        {name} = [");
    for (number, value) in values.enumerate() {
        let comma = if number == 0 { "" } else { ", " };
        let _ = write!(text, "{comma}{value}");
    }
    let _ = writeln!(text, "]{end}");
}
