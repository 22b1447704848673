//! `paws-sim import`: a folder of Beogym as a scene of bundles.

use std::path::PathBuf;
use std::process::ExitCode;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result};
use clap::Args;
use command_line::output::print;
use simulation::{BeogymConfig, SceneData};

#[derive(Args)]
pub(crate) struct Arguments {
    /// The folder of Beogym: with `sec1/point_cloud.ply` and others, or with `sequence.json`.
    folder: PathBuf,
    /// The new folder of the scene; an error if it exists.
    #[arg(long, value_name = "SCENE")]
    out: PathBuf,
}

pub(crate) fn run(arguments: &Arguments) -> Result<ExitCode> {
    #[expect(
        clippy::disallowed_methods,
        reason = "states when the bundles were written, for a reader; nothing depends on it"
    )]
    let now = SystemTime::now();
    let now = now
        .duration_since(UNIX_EPOCH)
        .context("reading the clock")?;
    let now_ns = i64::try_from(now.as_nanos()).context("reading the clock")?;
    let config = BeogymConfig::default();
    let scene = SceneData::import_beogym(&arguments.folder, &arguments.out, &config, now_ns)?;
    for missing in scene.missing() {
        print(format_args!(
            "missing: {} of {}; without it: {}",
            missing.output, missing.place, missing.features
        ))?;
    }
    let gaussians = scene.sectors.iter().filter_map(|s| s.gaussians.as_ref());
    print(format_args!(
        "{} sectors, {} edges, {} Gaussians: {}",
        scene.sectors.len(),
        scene.sectors.iter().map(|s| s.edges.len()).sum::<usize>(),
        gaussians.map(|source| source.count()).sum::<usize>(),
        arguments.out.display()
    ))?;
    if !arguments.folder.join("sequence.json").is_file() {
        print("lengths are those of transformation.txt: metric only where it has the scale")?;
    }
    let is_whole = scene.missing().is_empty();
    Ok(ExitCode::from(if is_whole { 0 } else { 3 }))
}
