//! Surfaces of views, with default configurations.

use terrain::edges::{Edge, find_edges, snap};
use terrain::fusion::Volume;
use terrain::mesh::Mesh;
use terrain::planes::{PlaneRefiner, Planes};
use terrain::{EdgeConfig, FusionConfig, MeshConfig, PlaneConfig};

use super::Shot;

/// The mesh of their fusion.
pub fn mesh_of(shots: &[Shot]) -> Mesh {
    let mut volume = Volume::new(FusionConfig::default()).unwrap();
    for shot in shots {
        volume.add(&shot.view()).unwrap();
    }
    Mesh::of(&volume, &MeshConfig::default())
}

/// The mesh with its planes and edges.
pub fn surface_of(shots: &[Shot]) -> (Mesh, Planes, Vec<Edge>) {
    let mesh = mesh_of(shots);
    let mut refiner = PlaneRefiner::new(&mesh, &PlaneConfig::default());
    for shot in shots {
        refiner.add(&shot.view()).unwrap();
    }
    let planes = refiner.finish();
    let edges = find_edges(&planes, &EdgeConfig::default());
    (mesh, planes, edges)
}

/// The same with vertices snapped to planes and edges.
pub fn snapped_surface_of(shots: &[Shot]) -> (Mesh, Planes, Vec<Edge>) {
    let (mut mesh, planes, edges) = surface_of(shots);
    snap(&mut mesh, &planes, &edges, 0.02);
    (mesh, planes, edges)
}
