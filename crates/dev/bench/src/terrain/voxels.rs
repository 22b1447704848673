//! Errors, time and memory against the size of voxels.

use anyhow::Result;
use serde::{Deserialize, Serialize};
use terrain::FusionConfig;

use super::keyframes::DepthFrame;
use super::scores::{Quantiles, scores};
use super::surface::surface;
use super::truth::Truth;

/// Edges of voxels, m.
const VOXELS_M: [f64; 5] = [0.01, 0.015, 0.02, 0.03, 0.04];

/// A size of voxels on a walk.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Row {
    pub(super) voxel_m: f64,
    /// Times of a keyframe, and processor times of all threads.
    pub(super) fusion_ms: f64,
    pub(super) fusion_cpu_ms: f64,
    pub(super) refinement_ms: f64,
    pub(super) refinement_cpu_ms: f64,
    /// Mesh, planes, edges and maps after the last keyframe, s.
    pub(super) end_s: f64,
    pub(super) mbytes: f64,
    /// Heights of the mesh under soles and within 0.6 m of footprints.
    pub(super) sole_height: Quantiles,
    pub(super) near_height: Quantiles,
    /// Heights of steps, and distances across their edges.
    pub(super) riser: Quantiles,
    pub(super) edges: Quantiles,
    pub(super) crossed: usize,
    pub(super) crossed_found: usize,
    pub(super) triangles: usize,
    pub(super) invented_unflagged: usize,
}

/// All sizes on a walk.
///
/// # Errors
/// An invalid view.
pub(super) fn curve(frames: &[DepthFrame], truth: &Truth<'_>, quick: bool) -> Result<Vec<Row>> {
    let sizes = if quick { &VOXELS_M[2..] } else { &VOXELS_M[..] };
    let row = |voxel_m: &f64| {
        let mut fusion = FusionConfig::default();
        fusion.voxel_m = *voxel_m;
        let surface = surface(frames, fusion)?;
        let scores = scores(&surface, truth)?;
        let places = scores.edges.places_m.iter().flatten().copied();
        Ok(Row {
            voxel_m: *voxel_m,
            fusion_ms: surface.costs.fusion_ms,
            fusion_cpu_ms: surface.costs.fusion_cpu_ms,
            refinement_ms: surface.costs.refinement_ms,
            refinement_cpu_ms: surface.costs.refinement_cpu_ms,
            end_s: surface.costs.end_s,
            mbytes: 1e-6 * surface.costs.stats.bytes as f64,
            sole_height: scores.mesh_height,
            near_height: scores.near_height,
            riser: scores.edges.riser,
            edges: Quantiles::of(places),
            crossed: scores.edges.crossed,
            crossed_found: scores.edges.crossed_found,
            triangles: surface.mesh.triangles.len(),
            invented_unflagged: scores.invented_unflagged,
        })
    };
    sizes.iter().map(row).collect()
}
