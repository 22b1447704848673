//! `paws rig`: shows, checks, compares and converts rig files.
//!
//! Contract: rig files are read and new files written; nothing that exists is changed, and an
//! existing output file is an error unless `--force` is given. Results are lines; `check` ends with
//! 1 if the rig is invalid, with 3 on warnings, and `diff` with 3 if something changed.

use std::path::PathBuf;

use anyhow::Result;
use cad_transforms::Rig;
use cad_transforms::output::Existing;
use clap::Subcommand;
use console_output::{Console, Outcome};

mod calibrations;
mod check;
mod convert;
mod diff;
mod show;
mod text_file;

/// Commands for rig files.
#[derive(Debug, Subcommand)]
pub(crate) enum RigVerb {
    /// Print the poses of the frames; with --out also draw them
    Show {
        /// The rig file
        file: PathBuf,
        /// Folder for rig.svg, rig.png and rig.gltf
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
        /// Calibration of a camera: CAMERA=FILE, or CAMERA=FILE@WIDTHxHEIGHT; repeat
        #[arg(long, value_name = "CAMERA=FILE")]
        calibration: Vec<String>,
        /// Replace existing files
        #[arg(long)]
        force: bool,
    },
    /// Report all errors of a rig file
    Check {
        /// The rig file
        file: PathBuf,
        /// Calibration of a camera: CAMERA=FILE, or CAMERA=FILE@WIDTHxHEIGHT; repeat
        #[arg(long, value_name = "CAMERA=FILE")]
        calibration: Vec<String>,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Compare two rig files, in mm and degrees
    Diff {
        /// The old rig file
        a: PathBuf,
        /// The new rig file
        b: PathBuf,
    },
    /// Convert a CAD file to a rig file, or a rig file to another format
    Convert {
        /// STEP, URDF, glTF, CSV or TOML table; or a rig file
        src: PathBuf,
        /// Map from parts to frames
        #[arg(long, value_name = "FILE")]
        map: Option<PathBuf>,
        /// The new file; for a rig file its extension selects the format: .urdf, .gltf, .csv or
        /// .toml (a table)
        #[arg(long, value_name = "FILE", required_unless_present = "list")]
        out: Option<PathBuf>,
        /// Only print the parts with their poses, to write a map from
        #[arg(long)]
        list: bool,
        /// Replace an existing file
        #[arg(long)]
        force: bool,
    },
}

/// Runs `paws rig`.
///
/// # Errors
/// A file cannot be read, is wrong, or cannot be written.
pub(crate) fn run(verb: &RigVerb, console: &mut Console<'_>) -> Result<Outcome> {
    let existing = |force: &bool| {
        if *force {
            Existing::Replace
        } else {
            Existing::Refuse
        }
    };
    match verb {
        RigVerb::Show {
            file,
            out,
            calibration,
            force,
        } => {
            let facts = calibrations::read(calibration)?;
            let rig = Rig::read(file)?;
            show::run(&rig, &facts, out.as_deref(), existing(force), console)
        }
        RigVerb::Check {
            file,
            calibration,
            json,
        } => {
            let facts = calibrations::read(calibration)?;
            check::run(file, &facts, *json, console)
        }
        RigVerb::Diff { a, b } => diff::run(&Rig::read(a)?, &Rig::read(b)?, console),
        RigVerb::Convert {
            src,
            map,
            out,
            list,
            force,
        } => {
            let out = out.as_deref().filter(|_| !list);
            convert::run(src, map.as_deref(), out, existing(force), console)
        }
    }
}

#[cfg(test)]
mod tests;
