//! Meshes, planes and step edges as the output `terrain` has them, and back.

use scene_bundle::outputs::terrain::{
    EdgeKind, Step, StepEdge, Terrain, TerrainMesh, TerrainPlane, TerrainPolygon,
};
use terrain::PlaneConfig;
use terrain::edges::{self, Edge};
use terrain::mesh::Mesh;
use terrain::planes::{Plane, PlaneOutline, Planes, Polygon};

/// Planes and step edges.
pub(super) fn terrain(planes: &Planes, edges: &[Edge], voxel_m: f64) -> Terrain {
    Terrain {
        voxel_m,
        planes: planes.planes.iter().map(stored_plane).collect(),
        edges: edges.iter().map(stored_edge).collect(),
    }
}

/// A mesh with the plane of each vertex.
pub(super) fn mesh(mesh: Mesh, planes: Vec<Option<u32>>) -> TerrainMesh {
    TerrainMesh {
        positions: mesh.positions,
        normals: mesh.normals,
        colors: mesh.colors,
        sigma_m: mesh.sigma_m,
        views: mesh.views,
        planes,
        triangles: mesh.triangles,
    }
}

/// A simplified mesh: its vertices are not those that planes have.
pub(super) fn mesh_without_planes(simplified: Mesh) -> TerrainMesh {
    let planes = vec![None; simplified.positions.len()];
    mesh(simplified, planes)
}

/// What the output has, as maps and collision parts need it.
pub(in super::super) fn of_files(
    terrain: &Terrain,
    mesh: TerrainMesh,
) -> (Mesh, Planes, Vec<Edge>) {
    let config = PlaneConfig::default();
    let planes = Planes {
        planes: terrain
            .planes
            .iter()
            .map(|own| plane(own, &config))
            .collect(),
        of_vertex: mesh.planes,
        config,
    };
    let surface = Mesh {
        positions: mesh.positions,
        normals: mesh.normals,
        colors: mesh.colors,
        sigma_m: mesh.sigma_m,
        views: mesh.views,
        triangles: mesh.triangles,
    };
    (surface, planes, terrain.edges.iter().map(edge).collect())
}

fn stored_plane(plane: &Plane) -> TerrainPlane {
    let polygon = |polygon: &Polygon| TerrainPolygon {
        outline_m: polygon.outline.clone(),
        holes_m: polygon.holes.clone(),
    };
    TerrainPlane {
        center_m: plane.center,
        normal: plane.normal,
        axes: plane.axes,
        sigma_m: plane.sigma_m,
        tilt_sigma_rad: plane.tilt_sigma_rad,
        depths: plane.depths,
        views: plane.views as u64,
        chi_square: plane.chi_square,
        area_m2: plane.area_m2,
        polygons: plane.polygons.iter().map(polygon).collect(),
    }
}

fn plane(stored: &TerrainPlane, config: &PlaneConfig) -> Plane {
    let polygon = |polygon: &TerrainPolygon| Polygon {
        outline: polygon.outline_m.clone(),
        holes: polygon.holes_m.clone(),
    };
    let outline = PlaneOutline {
        center: stored.center_m,
        normal: stored.normal,
        axes: stored.axes,
        sigma_m: stored.sigma_m,
        tilt_sigma_rad: stored.tilt_sigma_rad,
        depths: stored.depths,
        views: stored.views as usize,
        chi_square: stored.chi_square,
        polygons: stored.polygons.iter().map(polygon).collect(),
    };
    Plane::of_outline(&outline, config)
}

fn stored_edge(edge: &Edge) -> StepEdge {
    StepEdge {
        kind: match edge.kind {
            edges::EdgeKind::Convex => EdgeKind::Convex,
            edges::EdgeKind::Concave => EdgeKind::Concave,
            edges::EdgeKind::End => EdgeKind::End,
        },
        from_m: edge.from,
        to_m: edge.to,
        sigma_m: edge.sigma_m,
        planes: edge.planes,
        step: edge.step.map(|step| Step {
            below: step.below,
            height_m: step.height_m,
            sigma_m: step.sigma_m,
            views: step.views as u64,
            direction: step.direction,
        }),
    }
}

fn edge(stored: &StepEdge) -> Edge {
    Edge {
        kind: match stored.kind {
            EdgeKind::Convex => edges::EdgeKind::Convex,
            EdgeKind::Concave => edges::EdgeKind::Concave,
            EdgeKind::End => edges::EdgeKind::End,
        },
        from: stored.from_m,
        to: stored.to_m,
        sigma_m: stored.sigma_m,
        planes: stored.planes,
        step: stored.step.map(|step| edges::Step {
            below: step.below,
            height_m: step.height_m,
            sigma_m: step.sigma_m,
            views: step.views as usize,
            direction: step.direction,
        }),
    }
}
