//! Output `terrain`: the ground as triangles, and its planes and step edges.
//!
//! Contract: `terrain.json` has the planes and edges, `mesh.ply` the dense mesh, and
//! `mesh-simplified.ply` the mesh for use. Vertices of both refer to planes by their index. Every
//! index is in range and every number finite, except the sigma of a vertex, which is NaN where it
//! is not known. Nothing is filled: where no view saw the ground the meshes have holes.

mod mesh;
mod planes;

pub use mesh::TerrainMesh;
pub use planes::{EdgeKind, Step, StepEdge, TerrainPlane, TerrainPolygon};

use serde::{Deserialize, Serialize};

use super::{Fault, read_json, write_compact_json};
use crate::draft::Draft;
use crate::error::BundleError;
use crate::scene::OutputReader;

const FILE: &str = "terrain.json";

/// Planes and step edges of the ground.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Terrain {
    /// Edge of a voxel of the fusion, m.
    pub voxel_m: f64,
    /// Planes. Vertices and edges refer to them by their index.
    pub planes: Vec<TerrainPlane>,
    /// Edges of planes.
    pub edges: Vec<StepEdge>,
}

/// Which of the two meshes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshDetail {
    /// A vertex per voxel at the surface.
    Dense,
    /// Without triangles that a use of the ground does not need.
    Simplified,
}

impl MeshDetail {
    /// Path of the mesh in the output's folder.
    pub fn path(self) -> &'static str {
        match self {
            Self::Dense => "mesh.ply",
            Self::Simplified => "mesh-simplified.ply",
        }
    }
}

impl Terrain {
    fn check(&self) -> Result<(), Fault> {
        if !(self.voxel_m.is_finite() && self.voxel_m > 0.0) {
            let found = format!("{} m", self.voxel_m);
            return Err(Fault::new("voxel_m", found, "a positive number"));
        }
        for (number, plane) in self.planes.iter().enumerate() {
            plane.check(&format!("plane {number}"))?;
        }
        for (number, edge) in self.edges.iter().enumerate() {
            edge.check(&format!("edge {number}"), self.planes.len())?;
        }
        Ok(())
    }
}

/// Writes the ground.
///
/// # Errors
/// [`BundleError::Refused`] for numbers that are not finite, indices out of range, and properties
/// of a mesh that are not of the same number; [`BundleError::Io`].
///
/// ```
/// use scene_bundle::outputs::{self, terrain};
/// # use scene_bundle::Bundle;
/// # let folder = tempfile::tempdir()?;
/// # let provenance = scene_bundle::Provenance {
/// #     session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
/// #     handoff_blake3: "ab".repeat(32),
/// #     judgement: None,
/// #     rig: scene_bundle::RigRevision { name: "chest".to_owned(), revision: "B".to_owned() },
/// #     program: "example".to_owned(),
/// #     program_version: "1.0".to_owned(),
/// #     started_civil_ns: 1_790_000_000_000_000_000,
/// #     ended_civil_ns: None,
/// # };
/// # let record = scene_bundle::Record {
/// #     stage: "example".to_owned(),
/// #     stage_version: 1,
/// #     settings: serde_json::json!({ "step": 2 }),
/// #     inputs: std::collections::BTreeMap::new(),
/// # };
/// # let bundle = Bundle::create_or_open(&folder.path().join("walk.scene"), provenance)?;
///
/// // A square metre of pavement, on no plane.
/// let mesh = terrain::TerrainMesh {
///     positions: vec![[0.0, 0.0, 0.1], [1.0, 0.0, 0.1], [1.0, 1.0, 0.1], [0.0, 1.0, 0.1]],
///     normals: vec![[0.0, 0.0, 1.0]; 4],
///     colors: vec![[128, 120, 110]; 4],
///     sigma_m: vec![0.004; 4],
///     views: vec![12; 4],
///     planes: vec![None; 4],
///     triangles: vec![[0, 1, 2], [0, 2, 3]],
/// };
/// let ground = terrain::Terrain { voxel_m: 0.02, planes: Vec::new(), edges: Vec::new() };
/// let draft = bundle.begin(outputs::TERRAIN)?;
/// terrain::write(&draft, &ground, &mesh, &mesh)?;
/// draft.commit(record)?;
///
/// let reader = bundle.scene().output(outputs::TERRAIN)?;
/// let ground = terrain::read(&reader)?;
/// assert_eq!(terrain::read_mesh(&reader, terrain::MeshDetail::Simplified, &ground)?, mesh);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn write(
    draft: &Draft,
    terrain: &Terrain,
    dense: &TerrainMesh,
    simplified: &TerrainMesh,
) -> Result<(), BundleError> {
    terrain
        .check()
        .map_err(|fault| fault.refused(draft, FILE))?;
    let meshes = [
        (MeshDetail::Dense, dense),
        (MeshDetail::Simplified, simplified),
    ];
    for (detail, mesh) in meshes {
        let checked = mesh.check(terrain.planes.len());
        checked.map_err(|fault| fault.refused(draft, detail.path()))?;
    }
    for (detail, mesh) in meshes {
        mesh::write(draft, detail.path(), mesh)?;
    }
    write_compact_json(draft, FILE, terrain)
}

/// Reads planes and step edges.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read(reader: &OutputReader) -> Result<Terrain, BundleError> {
    let terrain: Terrain = read_json(reader, FILE)?;
    let checked = terrain.check();
    checked.map_err(|fault| fault.malformed(reader, FILE))?;
    Ok(terrain)
}

/// Reads a mesh of the ground whose planes and edges were read before.
///
/// # Errors
/// As [`OutputReader::read`]; [`BundleError::Malformed`].
pub fn read_mesh(
    reader: &OutputReader,
    detail: MeshDetail,
    terrain: &Terrain,
) -> Result<TerrainMesh, BundleError> {
    let path = detail.path();
    let mesh = mesh::parse(&reader.read(path)?).map_err(|fault| fault.malformed(reader, path))?;
    let checked = mesh.check(terrain.planes.len());
    checked.map_err(|fault| fault.malformed(reader, path))?;
    Ok(mesh)
}

/// The file of a mesh as stored, checked against its hash: any program that reads PLY can use it.
///
/// # Errors
/// As [`OutputReader::read`].
pub fn read_mesh_file(reader: &OutputReader, detail: MeshDetail) -> Result<Vec<u8>, BundleError> {
    reader.read(detail.path())
}
