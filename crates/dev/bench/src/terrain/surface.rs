//! From depth to surface, planes, edges and maps, in the order and with the constants of the stages
//! `terrain` and `maps`.

use anyhow::Result;
use terrain::edges::{Edge, find_edges, snap, without_ramps};
use terrain::fusion::{Volume, VolumeStats};
use terrain::maps::{GroundSample, Level, build};
use terrain::mesh::Mesh;
use terrain::planes::{PlaneRefiner, Planes};
use terrain::{EdgeConfig, FusionConfig, MapConfig, MeshConfig, PlaneConfig, RampConfig};

use super::keyframes::DepthFrame;
use crate::meter::timed;

/// The surface of a walk.
pub(crate) struct Surface {
    /// The mesh before its vertices were moved to planes and edges.
    pub(crate) field: Mesh,
    pub(crate) mesh: Mesh,
    /// The mesh without ramps below steps, of which maps and obstacles are made.
    pub(crate) ground: Mesh,
    pub(crate) planes: Planes,
    pub(crate) edges: Vec<Edge>,
    pub(crate) levels: Vec<Level>,
    pub(crate) costs: Costs,
}

/// Time and memory.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Costs {
    pub(crate) keyframes: usize,
    /// Fusion, ms per keyframe, and processor time of all threads.
    pub(crate) fusion_ms: f64,
    pub(crate) fusion_cpu_ms: f64,
    /// The same for the second pass, for the planes.
    pub(crate) refinement_ms: f64,
    pub(crate) refinement_cpu_ms: f64,
    /// Mesh, planes, edges and maps after the last keyframe, s.
    pub(crate) end_s: f64,
    pub(crate) stats: VolumeStats,
}

/// The surface of depth maps, with maps of depth alone.
///
/// # Errors
/// An invalid view.
pub(crate) fn surface(frames: &[DepthFrame], fusion: FusionConfig) -> Result<Surface> {
    let count = frames.len().max(1) as f64;
    let (volume, fused) = timed(|| fuse(frames, fusion));
    let volume = volume?;
    let (mut mesh, meshed) = timed(|| Mesh::of(&volume, &MeshConfig::default()));
    let (stats, field) = (volume.stats(), mesh.clone());
    drop(volume);
    let (refiner, candidates) = timed(|| PlaneRefiner::new(&mesh, &PlaneConfig::default()));
    let mut refiner = refiner;
    let (added, refined) = timed(|| frames.iter().try_for_each(|own| refiner.add(&own.view())));
    added?;
    let ((planes, edges, ground, levels), ended) = timed(|| {
        let planes = refiner.finish();
        let edges = find_edges(&planes, &EdgeConfig::default());
        snap(&mut mesh, &planes, &edges, fusion.voxel_m);
        let ground = without_ramps(&mesh, &planes, &edges, &RampConfig::default());
        let levels = maps(&ground, &edges, &[]);
        (planes, edges, ground, levels)
    });
    let costs = Costs {
        keyframes: frames.len(),
        fusion_ms: 1e3 * fused.wall_s / count,
        fusion_cpu_ms: 1e3 * fused.cpu_s / count,
        refinement_ms: 1e3 * refined.wall_s / count,
        refinement_cpu_ms: 1e3 * refined.cpu_s / count,
        end_s: meshed.wall_s + candidates.wall_s + ended.wall_s,
        stats,
    };
    Ok(Surface {
        field,
        mesh,
        ground,
        planes,
        edges,
        levels,
        costs,
    })
}

/// The distance field alone.
///
/// # Errors
/// An invalid view.
pub(crate) fn fuse(frames: &[DepthFrame], fusion: FusionConfig) -> Result<Volume> {
    let mut volume = Volume::new(fusion)?;
    for frame in frames {
        volume.add(&frame.view())?;
    }
    Ok(volume)
}

/// Maps with ground samples.
pub(crate) fn maps(mesh: &Mesh, edges: &[Edge], samples: &[GroundSample]) -> Vec<Level> {
    build(mesh, edges, samples, &MapConfig::default())
}
