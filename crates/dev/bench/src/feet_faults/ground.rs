//! The ground of a walk as the stage `terrain` has it, from depth of keyframes.

use anyhow::Result;
use rig_sim::scene::Lighting;
use scene_bundle::outputs::terrain::TerrainMesh;
use terrain::FusionConfig;
use terrain::mesh::Mesh;

use super::walks::{SIZE, Walk};
use crate::terrain::keyframes::{Source, depth_frames, keyframes};
use crate::terrain::surface::surface;
use crate::terrain::walks;

/// The mesh of depth alone, of all cameras of the example rig on the same walk, with true poses;
/// empty of walks without depth.
///
/// # Errors
/// As of the benchmark `terrain`.
pub(super) fn ground(walk: &Walk) -> Result<TerrainMesh> {
    if !walk.has_depth {
        return Ok(terrain_mesh(Mesh::default()));
    }
    let prepared = walks::Walk {
        kind: walk.scene,
        light: Lighting::Day,
        seed: walk.seed,
        span_s: [walk.begin_s, walk.begin_s + walk.long_s],
        size: SIZE,
    };
    let prepared = prepared.prepare()?;
    let rendered = keyframes(&prepared, &prepared.keyframes()?)?;
    let frames = depth_frames(&rendered, Source::Stereo)?;
    Ok(terrain_mesh(
        surface(&frames, FusionConfig::default())?.mesh,
    ))
}

fn terrain_mesh(mesh: Mesh) -> TerrainMesh {
    TerrainMesh {
        planes: vec![None; mesh.positions.len()],
        positions: mesh.positions,
        normals: mesh.normals,
        colors: mesh.colors,
        sigma_m: mesh.sigma_m,
        views: mesh.views,
        triangles: mesh.triangles,
    }
}
