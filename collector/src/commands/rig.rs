//! `paws rig`: rig files shown, checked, compared and converted.
//!
//! Contract: rig files are read and new files written; nothing that exists is changed, and a file that is there already is an
//! error unless `--force` is given. Results are lines; `check` ends with 1 when the rig cannot be true, with 3 when something
//! should be looked at, and `diff` with 3 when something changed.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use cad_transforms::Rig;
use cad_transforms::output::Existing;
use clap::Subcommand;

use crate::console::Console;
use crate::outcome::Outcome;

mod calibrations;
pub(crate) mod canvas;
mod check;
pub(crate) mod colors;
mod convert;
mod diff;
pub(crate) mod drawing;
mod glyphs;
mod show;

/// What to do with rig files.
#[derive(Debug, Subcommand)]
pub enum RigVerb {
    /// Print where the frames are; with --out also draw them
    Show {
        /// The rig file
        file: PathBuf,
        /// Folder for rig.svg, rig.png and rig.gltf
        #[arg(long, value_name = "DIR")]
        out: Option<PathBuf>,
        /// Calibration of a camera: CAMERA=FILE, or CAMERA=FILE@WIDTHxHEIGHT; repeat
        #[arg(long, value_name = "CAMERA=FILE")]
        calibration: Vec<String>,
        /// Replace files that are there
        #[arg(long)]
        force: bool,
    },
    /// Tell everything that is wrong with a rig file
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
        /// The rig file as it was
        a: PathBuf,
        /// The rig file as it is
        b: PathBuf,
    },
    /// Make a rig file of a CAD file, or another format of a rig file
    Convert {
        /// STEP, URDF, glTF, CSV or TOML table; or a rig file
        src: PathBuf,
        /// Which part is which frame
        #[arg(long, value_name = "FILE")]
        map: Option<PathBuf>,
        /// The new file; for a rig file its ending says the format: .urdf, .gltf, .csv or .toml (a table)
        #[arg(long, value_name = "FILE", required_unless_present = "list")]
        out: Option<PathBuf>,
        /// Only print the parts with their places, to write a map by
        #[arg(long)]
        list: bool,
        /// Replace a file that is there
        #[arg(long)]
        force: bool,
    },
}

/// Does it.
///
/// # Errors
/// A file cannot be read, is wrong, or cannot be written.
pub fn run(verb: &RigVerb, console: &mut Console<'_>) -> Result<Outcome> {
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

/// The text of a file.
fn text_of(path: &Path) -> Result<String> {
    plain_file::read_to_string(path, plain_file::TEXT_LIMIT)
        .with_context(|| format!("reading {}", path.display()))
}

#[cfg(test)]
mod tests;
