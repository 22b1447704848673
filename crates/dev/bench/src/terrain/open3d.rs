//! Open3D's distance fields on the CPU, in an interpreter of their own, on the same depth maps.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use terrain::FusionConfig;
use terrain::mesh::Mesh;

use super::keyframes::DepthFrame;
use super::surface::fuse;
use crate::meter::{median, timed};
use crate::python;

const SCRIPT: &str = "terrain/fuse_with_open3d.py";
/// Threads of both sides.
pub(super) const THREADS: usize = 2;
/// Voxel, m, and truncation on both sides of a surface, voxels.
pub(super) const VOXEL_M: f64 = 0.02;
const TRUNCATION_VOXELS: f64 = 4.0;
const MAX_DEPTH_M: f64 = 8.0;

/// A mesh and the time of its fusion.
pub(super) struct MeshFusion {
    pub(super) name: String,
    pub(super) timing: Timing,
    pub(super) mesh: Mesh,
}

/// Time per keyframe, ms.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub(super) struct Timing {
    pub(super) median_ms: f64,
    pub(super) least_ms: f64,
    /// Processor time of all threads, median.
    pub(super) cpu_ms: f64,
}

impl Timing {
    /// Of times and processor times.
    fn of(ms: &[[f64; 2]]) -> Self {
        let of = |k: usize| ms.iter().map(move |pair| pair[k]);
        Self {
            median_ms: median(of(0)),
            least_ms: of(0).fold(f64::INFINITY, f64::min),
            cpu_ms: median(of(1)),
        }
    }
}

/// Ours with the constants of the stage, ours with the truncation of the peers, and the peers; with
/// the version of Open3D.
///
/// # Errors
/// No interpreter with Open3D, or one that fails.
pub(super) fn race(frames: &[DepthFrame], repeats: usize) -> Result<(Vec<MeshFusion>, String)> {
    let mut usual = FusionConfig::default();
    usual.voxel_m = VOXEL_M;
    let mut equal = usual;
    (equal.front_voxels, equal.front_sigmas) = (TRUNCATION_VOXELS, 0.0);
    (equal.back_voxels, equal.back_sigmas) = (TRUNCATION_VOXELS, 0.0);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(THREADS);
    let pool = pool.build().context("starting threads")?;
    let folder = tempfile::tempdir().context("making a folder for depth maps")?;
    let question = question(frames, folder.path())?;
    let configs = [("ours", usual), ("ours, truncation of the peers", equal)];
    let mut ours: Vec<(Vec<[f64; 2]>, Option<Mesh>)> = vec![(Vec::new(), None); configs.len()];
    let mut theirs: Vec<(String, Vec<[f64; 2]>)> = Vec::new();
    let mut answer = Value::Null;
    // Ours and theirs alternate, so that other load of the machine meets both.
    for _ in 0..repeats {
        for ((_, config), (times, mesh)) in configs.iter().zip(&mut ours) {
            let (volume, took) = timed(|| pool.install(|| fuse(frames, *config)));
            let share = 1e3 / frames.len().max(1) as f64;
            times.push([took.wall_s, took.cpu_s].map(|s| share * s));
            *mesh = Some(Mesh::of(&volume?, &terrain::MeshConfig::default()));
        }
        answer = python::ask_in(python::OPEN3D, SCRIPT, &question)?;
        let methods = answer["methods"].as_object().context("Open3D's methods")?;
        for (name, method) in methods {
            let times = method["ms"].as_array().context("Open3D's times")?;
            let number = |pair: &Value, k: usize| pair[k].as_f64().unwrap_or(f64::NAN);
            let times = times.iter().map(|pair| [0, 1].map(|k| number(pair, k)));
            match theirs.iter_mut().find(|(other, _)| other == name) {
                Some((_, own)) => own.extend(times),
                None => theirs.push((name.clone(), times.collect())),
            }
        }
    }
    let mut found: Vec<MeshFusion> = configs
        .iter()
        .zip(ours)
        .map(|((name, _), (times, mesh))| MeshFusion {
            name: (*name).to_owned(),
            timing: Timing::of(&times),
            mesh: mesh.unwrap_or_default(),
        })
        .collect();
    for (name, times) in theirs {
        let files = &answer["methods"][&name]["files"];
        found.push(MeshFusion {
            timing: Timing::of(&times),
            mesh: read_mesh(folder.path(), files)?,
            name: format!("Open3D {name}"),
        });
    }
    let version = answer["version"].as_str().context("Open3D's version")?;
    Ok((found, version.to_owned()))
}

/// Writes depth maps: what is not static has no depth.
fn question(frames: &[DepthFrame], folder: &Path) -> Result<Value> {
    let mut list = Vec::new();
    for (number, frame) in frames.iter().enumerate() {
        let depths = frame.static_depths();
        let bytes: Vec<u8> = depths
            .iter()
            .flat_map(|depth| depth.to_le_bytes())
            .collect();
        let path = folder.join(format!("{number}.bin"));
        fs::write(&path, bytes).with_context(|| format!("writing {}", path.display()))?;
        let view_from_world = frame.world_from_view.inverse();
        let (r, t) = (
            view_from_world.rotation_rows(),
            view_from_world.translation_m(),
        );
        let mut rows: Vec<f64> = (0..3)
            .flat_map(|k| [r[3 * k], r[3 * k + 1], r[3 * k + 2], t[k]])
            .collect();
        rows.extend([0.0, 0.0, 0.0, 1.0]);
        list.push(json!({
            "width": frame.size[0],
            "height": frame.size[1],
            "focal": frame.focal_px,
            "center": frame.center_px,
            "view_from_world": rows,
        }));
    }
    Ok(json!({
        "folder": folder,
        "frames": list,
        "voxel_m": VOXEL_M,
        "truncation_voxels": TRUNCATION_VOXELS,
        "max_depth_m": MAX_DEPTH_M,
        "threads": THREADS,
        "repeats": 1,
    }))
}

/// A mesh of positions and triangles.
fn read_mesh(folder: &Path, files: &Value) -> Result<Mesh> {
    let read = |k: usize| -> Result<Vec<[[u8; 4]; 3]>> {
        let name = files[k].as_str().context("a file of a mesh")?;
        let bytes = fs::read(folder.join(name)).with_context(|| format!("reading {name}"))?;
        let triple = |b: &[u8]| [0, 4, 8].map(|i| [b[i], b[i + 1], b[i + 2], b[i + 3]]);
        Ok(bytes.chunks_exact(12).map(triple).collect())
    };
    let positions: Vec<[f32; 3]> = read(0)?.iter().map(|t| t.map(f32::from_le_bytes)).collect();
    let triangles = read(1)?.iter().map(|t| t.map(u32::from_le_bytes)).collect();
    let count = positions.len();
    Ok(Mesh {
        positions,
        normals: vec![[0.0, 0.0, 1.0]; count],
        colors: vec![[0; 3]; count],
        sigma_m: vec![0.0; count],
        views: vec![1; count],
        triangles,
    })
}
