//! The command line of `paws-scene`, which `paws scene` starts.
//!
//! Results go to standard output, the last line being a summary; progress, notes and what was lost go to standard error.
//! Exit codes: 0 fine, 1 failed, 2 bad arguments, 3 finished with loss.

use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{Parser, Subcommand, ValueEnum};
use indicatif::{ProgressBar, ProgressStyle};
use scene_bundle::Scene;
use scene_bundle::export::{self, Format, Options};
use scene_bundle::verify::verify;

mod show;

/// Exit code of a run that finished and left something out.
const LOSS: u8 = 3;

/// Looks into a scene bundle, checks it, and writes it in the formats of others.
#[derive(Parser)]
#[command(name = "paws-scene", version)]
struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    /// Say what a bundle was made of and what it holds.
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
        /// tum, kitti, euroc: the trajectory; nerfstudio, colmap-text, colmap-binary: pictures with poses, and points;
        /// ply, las, laz: points.
        #[arg(long, value_parser = format)]
        format: Format,
        /// File to write; a folder for kitti, nerfstudio and colmap. Must not exist.
        #[arg(long, value_name = "PATH")]
        out: PathBuf,
        /// Which trajectory; for tum, kitti and euroc.
        #[arg(long, value_enum, default_value_t = Which::Offline)]
        trajectory: Which,
        /// Folder that `paws-reconstruct frames` wrote, for nerfstudio and colmap. Keyframes whose picture is not there
        /// are left out. Without it pictures are named as in that folder, below `images` for nerfstudio.
        #[arg(long, value_name = "DIR")]
        pictures: Option<PathBuf>,
        /// Pictures of the right eyes too.
        #[arg(long)]
        right: bool,
        /// Only this camera; can be given several times.
        #[arg(long, value_name = "NAME")]
        camera: Vec<String>,
    },
}

#[derive(Clone, Copy, ValueEnum)]
enum Which {
    /// Computed with knowledge of the whole recording.
    Offline,
    /// Computed from what was before each pose alone.
    Causal,
}

fn main() -> ExitCode {
    // Bad arguments end here, with 2.
    let result = match Arguments::parse().command {
        Command::Show { bundle, json } => show(&bundle, json),
        Command::Verify { bundle } => check(&bundle),
        Command::Export {
            bundle,
            format,
            out,
            trajectory,
            pictures,
            right,
            camera,
        } => {
            let options = Options {
                causal: matches!(trajectory, Which::Causal),
                pictures,
                right,
                cameras: camera,
            };
            write_export(&bundle, format, &options, &out)
        }
    };
    result.unwrap_or_else(|error| {
        eprintln!("error: {error:#}");
        ExitCode::FAILURE
    })
}

fn show(bundle: &Path, json: bool) -> Result<ExitCode> {
    let scene = Scene::open(bundle)?;
    let shown = show::Shown::of(&scene);
    let text = if json { shown.json()? } else { shown.text() };
    io::stdout()
        .write_all(text.as_bytes())
        .context("writing to standard output")?;
    for problem in &shown.problems {
        eprintln!("lost: {problem}");
    }
    Ok(ExitCode::from(if shown.problems.is_empty() {
        0
    } else {
        LOSS
    }))
}

fn check(bundle: &Path) -> Result<ExitCode> {
    let scene = Scene::open(bundle)?;
    let style = ProgressStyle::with_template("checking {bytes}, {bytes_per_sec}")
        .context("laying out the progress line")?;
    let bar = ProgressBar::no_length().with_style(style);
    let checked = verify(&scene, |bytes| bar.inc(bytes))?;
    bar.finish_and_clear();
    for output in &checked.outputs {
        let (name, files, bytes) = (&output.name, output.files, output.bytes);
        let verdict = if output.problems.is_empty() {
            "whole"
        } else {
            "DAMAGED"
        };
        println!("{name:18} {verdict:8} {files} files, {bytes} bytes");
        for problem in &output.problems {
            eprintln!("{name}: {problem}");
        }
    }
    for path in &checked.unnamed {
        eprintln!("nothing names {path}");
    }
    let problems: usize = checked.outputs.iter().map(|o| o.problems.len()).sum();
    let files: u64 = checked.outputs.iter().map(|o| o.files).sum();
    let what = match problems {
        0 => "every byte is as it was written".to_owned(),
        count => format!("{count} problems"),
    };
    println!(
        "{} outputs, {files} files, {what}: {}",
        checked.outputs.len(),
        scene.path().display()
    );
    Ok(if checked.is_whole() {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

fn write_export(bundle: &Path, format: Format, options: &Options, out: &Path) -> Result<ExitCode> {
    let scene = Scene::open(bundle)?;
    let summary = export::export(&scene, format, options, out)?;
    for note in &summary.notes {
        eprintln!("note: {note}");
    }
    const SHOWN: usize = 20;
    for lost in summary.lost.iter().take(SHOWN) {
        eprintln!("lost: {lost}");
    }
    if summary.lost.len() > SHOWN {
        eprintln!("lost: {} more", summary.lost.len() - SHOWN);
    }
    let loss = match summary.lost.len() {
        0 => String::new(),
        count => format!(", {count} losses"),
    };
    println!(
        "{}: {}{loss}: {}",
        format.name(),
        summary.written,
        out.display()
    );
    Ok(ExitCode::from(if summary.lost.is_empty() {
        0
    } else {
        LOSS
    }))
}

fn format(name: &str) -> Result<Format, String> {
    Format::from_name(name).ok_or_else(|| {
        let names: Vec<&str> = Format::ALL.iter().map(|f| f.name()).collect();
        format!("expected one of {}", names.join(", "))
    })
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn the_command_line_is_consistent() {
        super::Arguments::command().debug_assert();
    }
}
