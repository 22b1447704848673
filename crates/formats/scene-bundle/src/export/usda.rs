//! The ground as text of Universal Scene Description (OpenUSD): what is seen, what bodies touch,
//! and where cameras were.
//!
//! Contract: a stage in metres with z up, whose default prim is `/Terrain`.
//!
//! - `/Terrain/Ground` is the simplified mesh: no subdivision, a normal and a linear color per
//!   vertex. Without the output `collision` it is a static collider of its own triangles.
//! - `/Terrain/Collision` has static colliders (UsdPhysics) with the output `collision`: each
//!   convex part as a convex hull, each height layer as a mesh of its triangles, with its holes.
//! - `/Terrain/Cameras` has the left eye of each camera of the rig at its keyframes, if there are
//!   any; time codes are seconds since the first one.
//! - `/Terrain/PhysicsScene` has the gravity.

mod cameras;
mod collision;
mod text;

use std::fmt::Write;
use std::path::Path;

use cad_transforms::output::{Existing, write};

use self::cameras::CameraPath;
use self::text::{array, tuple};
use super::error::ExportError;
use super::summary::Summary;
use super::terrain_mesh::{description, linear_colors, note, simplified};
use crate::outputs::collision::Collision;
use crate::outputs::terrain::TerrainMesh;
use crate::outputs::{COLLISION, KEYFRAMES, RIG};
use crate::scene::Scene;

pub(super) fn export(scene: &Scene, out: &Path) -> Result<Summary, ExportError> {
    let mesh = simplified(scene)?;
    let shape = match scene.has(COLLISION) {
        true => Some(crate::outputs::collision::read(&scene.output(COLLISION)?)?),
        false => None,
    };
    let paths = match scene.has(KEYFRAMES) && scene.has(RIG) {
        true => cameras::read(scene)?,
        false => Vec::new(),
    };
    write(
        out,
        to_text(&mesh, shape.as_ref(), &paths).as_bytes(),
        Existing::Refuse,
    )?;
    let mut description = description(&mesh);
    if let Some(shape) = &shape {
        let (parts, layers) = (shape.parts.len(), shape.layers.len());
        let _ = write!(
            description,
            ", {parts} convex parts, {layers} height layers"
        );
    }
    let mut notes = vec![note("this USD mesh")];
    if !paths.is_empty() {
        let _ = write!(description, ", {} cameras", paths.len());
        notes.push("cameras are pinholes: USD has no lens distortion".to_owned());
    }
    Ok(Summary {
        description,
        notes,
        lost: Vec::new(),
    })
}

fn to_text(mesh: &TerrainMesh, shape: Option<&Collision>, paths: &[CameraPath]) -> String {
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
        "#usda 1.0\n(\n    defaultPrim = \"Terrain\"\n    kilogramsPerUnit = 1\n    metersPerUnit = 1\n    \
         timeCodesPerSecond = 1\n    upAxis = \"Z\"\n)\n\n\
         def Xform \"Terrain\" (\n    kind = \"component\"\n)\n{{\n    def Mesh \"Ground\" (\n        \
         prepend apiSchemas = [\"PhysicsCollisionAPI\", \"PhysicsMeshCollisionAPI\"]\n    )\n    {{\n\
         {extent}        uniform token subdivisionScheme = \"none\"\n        \
         uniform token orientation = \"rightHanded\"\n        \
         bool physics:collisionEnabled = {}\n        \
         uniform token physics:approximation = \"none\"\n",
        u8::from(shape.is_none())
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
    text.push_str("    }\n");
    if let Some(shape) = shape {
        collision::add(&mut text, shape);
    }
    cameras::add(&mut text, paths);
    text.push_str(
        "\n    def PhysicsScene \"PhysicsScene\"\n    {\n        \
         vector3f physics:gravityDirection = (0, 0, -1)\n        \
         float physics:gravityMagnitude = 9.81\n    }\n}\n",
    );
    text
}
