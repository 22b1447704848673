//! `paws-sim info`: what a scene has for simulators.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Args;
use command_line::output::print;
use scene_bundle::outputs::maps::{FREE, MapLevel};
use serde::Serialize;
use simulation::SceneData;

#[derive(Args)]
pub(crate) struct Arguments {
    /// The scene: a bundle, or a scene file of several recordings.
    scene: PathBuf,
    /// As JSON.
    #[arg(long)]
    json: bool,
}

/// What a scene has.
#[derive(Serialize)]
struct Info {
    name: String,
    /// BLAKE3 over what simulators use of it.
    hash: String,
    sectors: Vec<SectorInfo>,
    missing: Vec<MissingInfo>,
}

#[derive(Serialize)]
struct SectorInfo {
    name: String,
    levels: usize,
    /// Ground that is known and free, m2.
    free_m2: f64,
    gaussians: usize,
    degree: usize,
    /// Memory of the Gaussians while they are used, bytes.
    resident_bytes: u64,
    reference_poses: usize,
    cameras: Vec<String>,
    contacts: usize,
    /// Names of sectors with an edge from this one.
    edges: Vec<String>,
}

#[derive(Serialize)]
struct MissingInfo {
    place: String,
    output: String,
    features: String,
}

pub(crate) fn run(arguments: &Arguments) -> Result<ExitCode> {
    let scene = SceneData::open(&arguments.scene)?;
    let info = Info::of(&scene);
    if arguments.json {
        print(serde_json::to_string_pretty(&info).context("writing JSON")?)?;
        return Ok(ExitCode::SUCCESS);
    }
    for sector in &info.sectors {
        print(format_args!(
            "{}: {:.1} m2 of free ground on {} levels, {} Gaussians of degree {} ({:.1} MB in use), \
             {} reference poses, {} contacts",
            sector.name,
            sector.free_m2,
            sector.levels,
            sector.gaussians,
            sector.degree,
            sector.resident_bytes as f64 / 1e6,
            sector.reference_poses,
            sector.contacts,
        ))?;
        print(format_args!("  cameras {}", sector.cameras.join(", ")))?;
        if !sector.edges.is_empty() {
            print(format_args!("  leads to {}", sector.edges.join(", ")))?;
        }
    }
    for missing in &info.missing {
        print(format_args!(
            "missing: output {} of {}; without it: {}",
            missing.output, missing.place, missing.features
        ))?;
    }
    print(format_args!(
        "{} sectors, {} outputs missing: {}",
        info.sectors.len(),
        info.missing.len(),
        arguments.scene.display()
    ))?;
    Ok(ExitCode::SUCCESS)
}

impl Info {
    fn of(scene: &SceneData) -> Self {
        let sectors = scene.sectors.iter().map(|sector| {
            let levels: &[MapLevel] = sector.levels.as_ref().map_or(&[], |levels| levels);
            let gaussians = sector.gaussians.as_ref();
            let cameras = sector.recording.cameras.iter();
            SectorInfo {
                name: sector.name.clone(),
                levels: levels.len(),
                free_m2: levels.iter().map(free_m2).sum(),
                gaussians: gaussians.map_or(0, |source| source.count()),
                degree: gaussians.map_or(0, |source| source.degree()),
                resident_bytes: gaussians.map_or(0, |source| source.resident_bytes()),
                reference_poses: sector.references.len(),
                cameras: cameras.map(|camera| camera.name.clone()).collect(),
                contacts: sector.recording.contacts.len(),
                edges: (sector.edges.iter())
                    .map(|edge| scene.sectors[edge.to].name.clone())
                    .collect(),
            }
        });
        let missing = scene.missing().iter().map(|missing| MissingInfo {
            place: missing.place.clone(),
            output: missing.output.clone(),
            features: missing.features.clone(),
        });
        Self {
            name: scene.name.clone(),
            hash: scene.hash().iter().map(|b| format!("{b:02x}")).collect(),
            sectors: sectors.collect(),
            missing: missing.collect(),
        }
    }
}

fn free_m2(level: &MapLevel) -> f64 {
    let free = level.occupancy.iter().filter(|cell| **cell == FREE);
    free.count() as f64 * level.grid.cell_m * level.grid.cell_m
}
