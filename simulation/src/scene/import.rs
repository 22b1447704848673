//! Writes an import as a folder: a scene bundle for each sector, and a scene file with their areas
//! and edges.
//!
//! Contract: the folder is new and complete, or is not there: it is written beside its place and
//! renamed. Opened, it has the sectors, areas, edges, Gaussians and reference poses of the import,
//! and its maps near their sector.

mod crop;

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use ::splats::{Background, Scene};
use cad_transforms::RigidTransform;
use camera_models::Eye;
use gaussians::Plane;
use scene_bundle::outputs::splats::{
    self, SplatBackground, SplatContent, SplatScene, SplatSector, SplatTraining, SplatView,
};
use scene_bundle::outputs::{self, maps};
use scene_bundle::{Bundle, BundleError, Provenance, Record, RigRevision, error_chain};

use super::beogym::BeogymConfig;
use super::data::SceneData;
use super::file::IN_FOLDER;
use super::file::format::{EdgeEntry, FORMAT, RecordingEntry, SceneFile, VERSION};
use super::sector::Sector;
use crate::error::SimulationError;

/// Maps of a sector reach so far beyond its area, m: an agent crosses in the middle between areas,
/// and looks beyond that.
const REACH_M: f64 = 8.0;
/// Stage in the records of the outputs. Counted up when the same folder gives other outputs.
const STAGE: &str = "beogym-import";
const STAGE_VERSION: u32 = 1;

/// Writes an import of Beogym.
pub(super) fn write(
    scene: &SceneData,
    config: &BeogymConfig,
    folder: &Path,
    now_civil_ns: i64,
) -> Result<(), SimulationError> {
    let wrong = |found: String, expected: &str| SimulationError::Scene {
        place: folder.display().to_string(),
        found,
        expected: expected.to_owned(),
    };
    if folder.exists() {
        let found = "something that is there already".to_owned();
        return Err(wrong(found, "the path of a new folder"));
    }
    let Some(name) = folder.file_name() else {
        return Err(wrong("no name".to_owned(), "the path of a new folder"));
    };
    let partial = folder.with_file_name(format!(".{}.partial", name.display()));
    let written = write_partial(scene, config, &partial, now_civil_ns)
        .and_then(|()| fs::rename(&partial, folder).map_err(|error| error.to_string()));
    written.map_err(|found| {
        if let Err(remains) = fs::remove_dir_all(&partial) {
            log::warn!("removing {}: {remains}", partial.display());
        }
        wrong(found, "a folder that can be written")
    })
}

/// Writes a folder in place of what an import that was stopped has left of it.
fn write_partial(
    scene: &SceneData,
    config: &BeogymConfig,
    partial: &Path,
    now_civil_ns: i64,
) -> Result<(), String> {
    if partial.exists() {
        fs::remove_dir_all(partial).map_err(|error| error.to_string())?;
    }
    fs::create_dir(partial).map_err(|error| error.to_string())?;
    write_all(scene, config, partial, now_civil_ns)
}

fn write_all(
    scene: &SceneData,
    config: &BeogymConfig,
    folder: &Path,
    now_civil_ns: i64,
) -> Result<(), String> {
    let provenance = Provenance {
        session_id: format!("beogym {}", scene.name),
        handoff_blake3: blake3::Hash::from_bytes(*scene.hash()).to_hex().to_string(),
        judgement: None,
        rig: RigRevision {
            name: "beogym".to_owned(),
            revision: "unknown".to_owned(),
        },
        program: "paws-sim".to_owned(),
        program_version: env!("CARGO_PKG_VERSION").to_owned(),
        started_civil_ns: now_civil_ns,
        ended_civil_ns: None,
    };
    let record = Record {
        stage: STAGE.to_owned(),
        stage_version: STAGE_VERSION,
        settings: serde_json::to_value(config).map_err(|error| error.to_string())?,
        inputs: BTreeMap::from([("handoff".to_owned(), provenance.handoff_blake3.clone())]),
    };
    let mut file = SceneFile {
        format: FORMAT.to_owned(),
        version: VERSION,
        name: scene.name.clone(),
        recordings: Vec::new(),
        edges: Vec::new(),
    };
    for (number, sector) in scene.sectors.iter().enumerate() {
        // Names of sectors may have slashes.
        let name = format!("{number:03}.scene");
        let written = write_sector(sector, &folder.join(&name), &provenance, &record);
        written.map_err(|found| format!("sector {}: {found}", sector.name))?;
        file.recordings.push(RecordingEntry {
            name: sector.name.clone(),
            bundle: Some(name),
            beogym: None,
            area_min_m: Some(sector.area.min_m),
            area_max_m: Some(sector.area.max_m),
        });
        file.edges.extend(sector.edges.iter().map(|edge| EdgeEntry {
            from: sector.name.clone(),
            to: scene.sectors[edge.to].name.clone(),
            to_from_here: edge.to_from_here,
            overlap_min_m: edge.overlap.min_m,
            overlap_max_m: edge.overlap.max_m,
            residual_m: edge.residual_m,
        }));
    }
    let text = serde_json::to_vec_pretty(&file).map_err(|error| error.to_string())?;
    fs::write(folder.join(IN_FOLDER), text).map_err(|error| error.to_string())
}

/// Writes the bundle of a sector: its maps, and its Gaussians with the reference poses as views.
fn write_sector(
    sector: &Sector,
    path: &Path,
    provenance: &Provenance,
    record: &Record,
) -> Result<(), String> {
    let bundle = Bundle::create_or_open(path, provenance.clone()).map_err(error_text)?;
    let levels = sector.levels.iter().flat_map(|levels| levels.iter());
    let levels = levels.filter_map(|level| crop::cropped(level, &sector.area, REACH_M));
    let levels: Vec<_> = levels.collect();
    if !levels.is_empty() {
        let draft = bundle.begin(outputs::MAPS).map_err(error_text)?;
        maps::write(&draft, &levels).map_err(error_text)?;
        draft.commit(record.clone()).map_err(error_text)?;
    }
    if let Some(gaussians) = &sector.gaussians {
        let scene = gaussians.load().map_err(|error| error.to_string())?;
        let content = SplatContent {
            sectors: std::slice::from_ref(&scene.splats),
            sky: sky(&scene),
            ..SplatContent::default()
        };
        let mut splat_scene = splat_scene(&scene, gaussians.is_compensated());
        splat_scene.views = sector.references.iter().enumerate().map(view).collect();
        splat_scene.sectors[0].views = (0..sector.references.len()).collect();
        let draft = bundle.begin(outputs::SPLATS).map_err(error_text)?;
        splats::write(&draft, &splat_scene, &content).map_err(error_text)?;
        draft.commit(record.clone()).map_err(error_text)?;
    }
    bundle
        .finish(provenance.started_civil_ns)
        .map_err(error_text)
}

/// The record of Gaussians of one sector.
fn splat_scene(scene: &Scene, compensated: bool) -> SplatScene {
    let extreme = |of: fn(f64, f64) -> f64| {
        [0, 1, 2].map(|k| {
            let means = scene.splats.planes()[Plane::POSITION + k].iter();
            means.map(|mean| f64::from(*mean)).reduce(of).unwrap_or(0.0)
        })
    };
    SplatScene {
        degree: scene.splats.degree(),
        compensated,
        background: match &scene.background {
            Background::Constant(color) => SplatBackground::Constant(*color),
            Background::Sky(sky) => SplatBackground::Sky { size: sky.size() },
        },
        sectors: vec![SplatSector {
            min_m: extreme(f64::min),
            max_m: extreme(f64::max),
            count: 0,
            file: String::new(),
            blake3: String::new(),
            views: Vec::new(),
            neighbors: Vec::new(),
        }],
        views: Vec::new(),
        training: SplatTraining {
            preset: "beogym".to_owned(),
            ..SplatTraining::default()
        },
        coverage: None,
    }
}

fn sky(scene: &Scene) -> &[[f32; 3]] {
    match &scene.background {
        Background::Constant(_) => &[],
        Background::Sky(sky) => sky.texels(),
    }
}

/// A reference pose as a view of the training. Beogym's poses have no time.
fn view((number, world_from_camera): (usize, &RigidTransform)) -> SplatView {
    let one = |row: usize| [0, 1, 2, 3].map(|k| f32::from(u8::from(k == row)));
    SplatView {
        camera: "beogym".to_owned(),
        eye: Eye::Left,
        frame: number as u64,
        set: number as u64,
        time_ns: 0,
        world_from_camera: *world_from_camera,
        shutter: None,
        reduction: 1,
        exposure: [0, 1, 2].map(one),
        held_out: None,
    }
}

fn error_text(error: BundleError) -> String {
    error_chain(&error)
}

#[cfg(test)]
mod tests;
