//! The simplified mesh of the ground, as exports of meshes need it.

use super::error::ExportError;
use crate::outputs::TERRAIN;
use crate::outputs::terrain::{self, MeshDetail, TerrainMesh};
use crate::scene::Scene;

pub(super) fn simplified(scene: &Scene) -> Result<TerrainMesh, ExportError> {
    let reader = scene.output(TERRAIN)?;
    let terrain = terrain::read(&reader)?;
    Ok(terrain::read_mesh(
        &reader,
        MeshDetail::Simplified,
        &terrain,
    )?)
}

pub(super) fn description(mesh: &TerrainMesh) -> String {
    let (vertices, triangles) = (mesh.positions.len(), mesh.triangles.len());
    format!("{vertices} vertices and {triangles} triangles of the simplified mesh")
}

/// Properties that formats of meshes have no place for.
pub(super) fn note(format: &str) -> String {
    format!("sigma, views and planes of vertices cannot be represented in {format}")
}

/// Linear value, from 0 to 1, of each value of sRGB (IEC 61966-2-1).
pub(super) fn linear_colors() -> [f64; 256] {
    std::array::from_fn(|value| {
        let v = value as f64 / 255.0;
        match v <= 0.04045 {
            true => v / 12.92,
            false => libm::pow((v + 0.055) / 1.055, 2.4),
        }
    })
}
