//! Models of MuJoCo of true and reconstructed ground, by the exporter of scene bundles.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use rayon::prelude::*;
use scene_bundle::export::{Format, Options, export};
use scene_bundle::outputs::collision::{
    self, Collision, CollisionReport, ConvexPart, HeightLayer, PartKind,
};
use scene_bundle::outputs::{COLLISION, grid::Grid};
use scene_bundle::{Bundle, Provenance, Record, RigRevision};
use terrain::ConvexConfig;
use terrain::ObstacleConfig;
use terrain::convex::{collision_parts, obstacle_parts};

use super::course::{Course, LENGTH_M, ground};
use crate::terrain::surface::Surface;
use crate::terrain::truth::Truth;

/// Cells of the true ground, m.
const CELL_M: f64 = 0.01;
/// True ground around a course, m.
const MARGIN_M: f64 = 1.2;

/// Collision geometry as the stage `maps` writes it.
pub(super) fn reconstructed(surface: &Surface) -> Collision {
    let config = ConvexConfig::default();
    let Surface {
        mesh,
        planes,
        edges,
        levels,
        ..
    } = surface;
    let parts = collision_parts(planes, edges, levels, &config);
    let obstacles = obstacle_parts(mesh, planes, levels, &ObstacleConfig::default());
    let of_plane = parts.parts.into_iter().map(|part| ConvexPart {
        kind: match planes.planes[part.plane as usize].normal[2] >= config.min_ground_cos {
            true => PartKind::Ground,
            false => PartKind::Wall,
        },
        plane: Some(part.plane),
        vertices_m: part.vertices,
        triangles: part.triangles,
    });
    let of_obstacle = obstacles.into_iter().map(|own| ConvexPart {
        kind: PartKind::Obstacle,
        plane: None,
        vertices_m: own.vertices,
        triangles: own.triangles,
    });
    let layers = parts.layers.into_iter().map(|layer| HeightLayer {
        grid: Grid {
            cell_m: layer.cell_m,
            origin_m: layer.origin,
            columns: layer.size[0],
            rows: layer.size[1],
        },
        heights_m: layer.heights,
    });
    Collision {
        parts: of_plane.chain(of_obstacle).collect(),
        layers: layers.collect(),
        report: CollisionReport::default(),
    }
}

/// The true ground around a course as a height layer of 1 cm.
pub(super) fn truth(truth: &Truth<'_>, course: &Course) -> Collision {
    let corners = [
        [-MARGIN_M, -MARGIN_M],
        [-MARGIN_M, MARGIN_M],
        [LENGTH_M + MARGIN_M, -MARGIN_M],
        [LENGTH_M + MARGIN_M, MARGIN_M],
    ]
    .map(|[ahead, left]| course.at(ahead, left));
    let bound = |k: usize, pick: fn(f64, f64) -> f64| {
        corners.iter().map(|x| x[k]).reduce(pick).unwrap_or(0.0)
    };
    let low = [0, 1].map(|k| (bound(k, f64::min) / CELL_M).floor() * CELL_M);
    let [columns, rows] =
        [0, 1].map(|k| ((bound(k, f64::max) - low[k]) / CELL_M).ceil() as usize + 1);
    let height = |cell: usize| {
        let at = [
            low[0] + (cell % columns) as f64 * CELL_M,
            low[1] + (cell / columns) as f64 * CELL_M,
        ];
        ground(truth, at).map_or(f32::NAN, |z| z as f32)
    };
    let heights_m = (0..columns * rows).into_par_iter().map(height).collect();
    let grid = Grid {
        cell_m: CELL_M,
        origin_m: low,
        columns,
        rows,
    };
    Collision {
        parts: Vec::new(),
        layers: vec![HeightLayer { grid, heights_m }],
        report: CollisionReport::default(),
    }
}

/// A folder of an export in the folder of this benchmark; one that is there is replaced.
///
/// # Errors
/// It cannot be written, or geometry is lost in it.
pub(super) fn exported(collision: &Collision, folder: &Path, name: &str) -> Result<PathBuf> {
    let (bundle, out) = (folder.join(format!("{name}.scene")), folder.join(name));
    for old in [&bundle, &out] {
        if old.exists() {
            fs::remove_dir_all(old).with_context(|| format!("removing {}", old.display()))?;
        }
    }
    let provenance = Provenance {
        session_id: "00000000-0000-7000-8000-000000000000".to_owned(),
        handoff_blake3: "00".repeat(32),
        judgement: None,
        rig: RigRevision {
            name: "example".to_owned(),
            revision: "A".to_owned(),
        },
        program: "bench".to_owned(),
        program_version: String::new(),
        started_civil_ns: 0,
        ended_civil_ns: None,
    };
    let bundle = Bundle::create_or_open(&bundle, provenance)?;
    let draft = bundle.begin(COLLISION)?;
    collision::write(&draft, collision)?;
    draft.commit(Record {
        stage: "bench".to_owned(),
        stage_version: 1,
        settings: serde_json::Value::Null,
        inputs: BTreeMap::new(),
    })?;
    let summary = export(&bundle.scene(), Format::Mjcf, &Options::default(), &out)?;
    ensure!(summary.lost.is_empty(), "lost: {:?}", summary.lost);
    Ok(out)
}
