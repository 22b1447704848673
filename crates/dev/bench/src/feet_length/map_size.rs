//! Size of the map that a walk leaves.

use std::path::Path;

use anyhow::{Context, Result};
use nalgebra::Vector3;
use reconstruction::pipeline::report_of;
use scene_bundle::outputs::terrain::{MeshDetail, TerrainMesh, read, read_mesh};
use scene_bundle::outputs::{self, CONTACTS, TERRAIN};
use scene_bundle::{Scene, error_chain};
use serde::{Deserialize, Serialize};

/// See the module.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct MapSize {
    /// Blocks of 8x8x8 voxels, and their memory, MB.
    pub(super) blocks: u64,
    pub(super) blocks_mb: f64,
    /// Vertices of the mesh, and its area, m².
    pub(super) vertices: usize,
    pub(super) area_m2: f64,
    pub(super) planes: usize,
    pub(super) contacts: usize,
    /// Keyframes that show the place of a contact, summed over contacts.
    pub(super) contact_views: usize,
}

impl MapSize {
    /// Of the terrain in one bundle and the contacts in another.
    ///
    /// # Errors
    /// A bundle lacks an output of the measured stages.
    pub(super) fn of(terrain: &Path, contacts: &Path) -> Result<Self> {
        let scene = Scene::open(terrain)?;
        let notes = report_of(&scene, TERRAIN)?.notes;
        let (blocks, blocks_mb) = notes
            .iter()
            .find_map(|note| blocks(note))
            .context("stage terrain reports no blocks")?;
        let reader = scene.output(TERRAIN)?;
        let terrain = read(&reader)?;
        let mesh = read_mesh(&reader, MeshDetail::Dense, &terrain)?;
        let reader = Scene::open(contacts)?.output(CONTACTS)?;
        let rows = outputs::contacts::read(&reader)?.len();
        let views = outputs::contacts::read_views(&reader, rows);
        let views = views.map_err(|error| anyhow::anyhow!(error_chain(&error)))?;
        Ok(Self {
            blocks,
            blocks_mb,
            vertices: mesh.positions.len(),
            area_m2: area_m2(&mesh),
            planes: terrain.planes.len(),
            contacts: rows,
            contact_views: views.len(),
        })
    }
}

/// Number of blocks and their MB in the note of the stage `terrain`.
fn blocks(note: &str) -> Option<(u64, f64)> {
    let (before, after) = note.split_once(" blocks of 8 x 8 x 8 voxels (")?;
    let (mb, _) = after.split_once(" MB)")?;
    Some((before.rsplit(' ').next()?.parse().ok()?, mb.parse().ok()?))
}

fn area_m2(mesh: &TerrainMesh) -> f64 {
    let area = |triangle: &[u32; 3]| {
        let [a, b, c] = triangle.map(|k| Vector3::from(mesh.positions[k as usize].map(f64::from)));
        0.5 * (b - a).cross(&(c - a)).norm()
    };
    mesh.triangles.iter().map(area).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_are_in_the_note_of_the_stage() {
        let note = "12 keyframes in 3456 blocks of 8 x 8 x 8 voxels (78 MB); 9 triangles";
        assert_eq!(blocks(note), Some((3456, 78.0)));
        assert_eq!(
            blocks("no depth map shows a surface: the mesh is empty"),
            None
        );
    }
}
