//! The command line of `paws-scene`, which `paws scene` starts.
//!
//! Results go to standard output, the last line being a summary; progress, notes and losses go to
//! standard error. Exit codes: 0 fine, 1 failed, 2 bad arguments, 3 finished with loss.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand, ValueEnum};
use command_line::output::{self, print};
use command_line::{Papers, Verbosity, complain};
use indicatif::{ProgressBar, ProgressStyle};
use log::LevelFilter;
use scene_bundle::Scene;
use scene_bundle::export::{self, Format, Options};
use scene_bundle::verify::verify;

mod examples;
mod show;

/// Exit code of a run that finished and left something out.
const LOSS: u8 = 3;

/// Shows a scene bundle, verifies it, and exports it to other formats.
#[derive(Parser)]
#[command(name = "paws-scene", version, after_help = AFTER)]
struct Arguments {
    #[command(flatten)]
    verbosity: Verbosity,
    #[command(subcommand)]
    command: Command,
}

const AFTER: &str = "\
`paws scene` starts this program too.
Exit codes: 0 fine, 1 failed, 2 bad arguments, 3 finished with loss.";

#[derive(Subcommand)]
enum Command {
    /// Show the provenance and the content of a bundle.
    Show {
        /// The bundle's folder, or the scene.json in it.
        bundle: PathBuf,
        /// As JSON.
        #[arg(long)]
        json: bool,
    },
    /// Check every byte of a bundle against its hashes.
    Verify {
        /// The bundle's folder, or the scene.json in it.
        bundle: PathBuf,
    },
    /// Write a bundle in another format. Nothing that exists is overwritten.
    Export {
        /// The bundle's folder, or the scene.json in it.
        bundle: PathBuf,
        /// tum, kitti, euroc: the trajectory; nerfstudio, colmap-text, colmap-binary: images with
        /// poses, and points; ply, las, laz: points; terrain-ply, terrain-obj, terrain-glb, usda:
        /// mesh of the ground; map-server, grid-map, height-geotiff: maps of the ground; mjcf,
        /// urdf: collision geometry; splat-ply, spz, splat, splat-glb: the scene as Gaussians.
        #[arg(long, value_parser = format_parser())]
        format: Format,
        /// File to write; a folder for kitti, nerfstudio, colmap, map-server, height-geotiff,
        /// mjcf and urdf. Must not exist.
        #[arg(long, value_name = "PATH")]
        out: PathBuf,
        /// Which trajectory; for tum, kitti and euroc.
        #[arg(long, value_enum, default_value_t = TrajectoryKind::Offline)]
        trajectory: TrajectoryKind,
        /// Folder that `paws-reconstruct frames` wrote, for nerfstudio and colmap. Keyframes
        /// without an image are left out. Without this option images are named as in that folder,
        /// below `images` for nerfstudio.
        #[arg(long, value_name = "DIR")]
        images: Option<PathBuf>,
        /// Include the images of the right side.
        #[arg(long)]
        right: bool,
        /// Only this camera; can be given several times.
        #[arg(long, value_name = "NAME")]
        camera: Vec<String>,
    },
    #[command(flatten)]
    Papers(Papers),
}

#[derive(Clone, Copy, ValueEnum)]
enum TrajectoryKind {
    /// Each pose computed from the whole recording
    Offline,
    /// Each pose computed from the data before it only
    Causal,
}

fn main() -> ExitCode {
    // Bad arguments end here, with 2.
    let arguments = Arguments::from_arg_matches(&command().get_matches());
    let arguments = arguments.unwrap_or_else(|error| error.exit());
    arguments.verbosity.logger(LevelFilter::Warn).init();
    let result = match arguments.command {
        Command::Show { bundle, json } => show(&bundle, json),
        Command::Verify { bundle } => check(&bundle),
        Command::Export {
            bundle,
            format,
            out,
            trajectory,
            images,
            right,
            camera,
        } => {
            let options = Options {
                causal: matches!(trajectory, TrajectoryKind::Causal),
                images,
                right,
                cameras: camera,
            };
            write_export(&bundle, format, &options, &out)
        }
        Command::Papers(papers) => papers
            .write(command(), &mut std::io::stdout())
            .map(|()| ExitCode::SUCCESS),
    };
    output::finish(result)
}

/// The command line with its examples.
fn command() -> clap::Command {
    command_line::examples::add(Arguments::command(), examples::EXAMPLES)
}

fn show(bundle: &Path, json: bool) -> Result<ExitCode> {
    let scene = Scene::open(bundle)?;
    let shown = show::BundleSummary::of(&scene);
    let text = if json { shown.json()? } else { shown.text() };
    print(text.trim_end()).context("writing to standard output")?;
    for problem in &shown.problems {
        complain!("lost: {problem}");
    }
    Ok(ExitCode::from(if shown.problems.is_empty() {
        0
    } else {
        LOSS
    }))
}

fn check(bundle: &Path) -> Result<ExitCode> {
    let scene = Scene::open(bundle)?;
    let style = ProgressStyle::with_template("checking {decimal_bytes}, {decimal_bytes_per_sec}")
        .context("laying out the progress line")?;
    let bar = match output::is_quiet() {
        true => ProgressBar::hidden(),
        false => ProgressBar::no_length().with_style(style),
    };
    let checked = verify(&scene, |bytes| bar.inc(bytes))?;
    bar.finish_and_clear();
    for output in &checked.outputs {
        let (name, files, bytes) = (&output.name, output.files, output.bytes);
        let verdict = if output.problems.is_empty() {
            "whole"
        } else {
            "DAMAGED"
        };
        print(format_args!(
            "{name:18} {verdict:8} {files} files, {bytes} bytes"
        ))?;
        for problem in &output.problems {
            complain!("{name}: {problem}");
        }
    }
    if !output::is_quiet() {
        for path in &checked.unnamed {
            complain!("nothing names {path}");
        }
    }
    let problems: usize = checked.outputs.iter().map(|o| o.problems.len()).sum();
    let files: u64 = checked.outputs.iter().map(|o| o.files).sum();
    let what = match problems {
        0 => "every byte is as it was written".to_owned(),
        count => format!("{count} problems"),
    };
    print(format_args!(
        "{} outputs, {files} files, {what}: {}",
        checked.outputs.len(),
        scene.path().display()
    ))?;
    Ok(if checked.is_whole() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

fn write_export(bundle: &Path, format: Format, options: &Options, out: &Path) -> Result<ExitCode> {
    let scene = Scene::open(bundle)?;
    let summary = export::export(&scene, format, options, out)?;
    if !output::is_quiet() {
        for note in &summary.notes {
            complain!("note: {note}");
        }
    }
    const SHOWN: usize = 20;
    for lost in summary.lost.iter().take(SHOWN) {
        complain!("lost: {lost}");
    }
    if summary.lost.len() > SHOWN {
        complain!("lost: {} more", summary.lost.len() - SHOWN);
    }
    let loss = match summary.lost.len() {
        0 => String::new(),
        count => format!(", {count} losses"),
    };
    print(format_args!(
        "{}: {}{loss}: {}",
        format.name(),
        summary.description,
        out.display()
    ))?;
    Ok(ExitCode::from(if summary.lost.is_empty() {
        0
    } else {
        LOSS
    }))
}

fn format_parser() -> impl TypedValueParser<Value = Format> {
    PossibleValuesParser::new(Format::ALL.map(Format::name))
        .map(|name| Format::from_name(&name).expect("only names of formats are possible"))
}

#[cfg(test)]
mod tests {
    use super::command;

    #[test]
    fn the_command_line_is_consistent() {
        command().debug_assert();
        let wrong = command_line::examples::check(&command());
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }

    #[test]
    fn every_help_lists_words_and_names_units() {
        let wrong = command_line::help::check(&command());
        assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    }
}
