//! The simplified mesh of the ground as Wavefront OBJ text.
//!
//! Contract: z is up, in metres. Every vertex has a normal, and its color (sRGB, 0 to 1) after the
//! position, as MeshLab and others read it. Positions have all the digits of their 32 bits.

use std::fmt::Write;
use std::path::Path;

use cad_transforms::output::{Existing, write};

use super::error::ExportError;
use super::summary::Summary;
use super::terrain_mesh::{description, note, simplified};
use crate::outputs::terrain::TerrainMesh;
use crate::scene::Scene;

pub(super) fn export(scene: &Scene, out: &Path) -> Result<Summary, ExportError> {
    let mesh = simplified(scene)?;
    write(out, to_text(&mesh).as_bytes(), Existing::Refuse)?;
    Ok(Summary {
        description: description(&mesh),
        notes: vec![note("OBJ")],
        lost: Vec::new(),
    })
}

fn to_text(mesh: &TerrainMesh) -> String {
    let mut text = String::from("# metres, z up\n");
    // Writing to a string does not fail.
    for ([x, y, z], color) in mesh.positions.iter().zip(&mesh.colors) {
        let [r, g, b] = color.map(|c| f64::from(c) / 255.0);
        let _ = writeln!(text, "v {x} {y} {z} {r:.4} {g:.4} {b:.4}");
    }
    for [x, y, z] in &mesh.normals {
        let _ = writeln!(text, "vn {x} {y} {z}");
    }
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|index| u64::from(index) + 1);
        let _ = writeln!(text, "f {a}//{a} {b}//{b} {c}//{c}");
    }
    text
}
