//! `paws export`: a session in other formats. (The segments are MCAP already.)
//!
//! * `euroc`: an ASL folder per camera, images decoded to PNG.
//! * `mp4`: one file per camera, the access units unchanged.
//! * `csv`: IMU samples, frames, frame sets, gaps and events as tables.
//!
//! An export goes to a new or an empty folder. Data that cannot be exported, including damaged
//! ranges of the session, is counted, reported, and changes the exit code.

mod common;
mod csv;
mod euroc;
mod mp4;
mod yaml;

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use clap::ValueEnum;
use console_output::{Console, Outcome};
use session_access::open;
use session_archive::manifest::Manifest;

use self::common::file_name;
use crate::target::Target;

/// Export format.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// ASL/EuRoC folders: PNG images, IMU and calibration
    Euroc,
    /// One MP4 file per camera, without re-encoding
    Mp4,
    /// Tables of IMU samples, frames, frame sets, gaps and events
    Csv,
}

/// Exports a session into the folder `out`.
///
/// # Errors
/// The session cannot be read, the folder is in use, or it cannot be written.
pub fn run(
    target: &Target,
    format: Format,
    out: &Path,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    let occupied = out.exists()
        && fs::read_dir(out)
            .with_context(|| format!("exporting to {}", out.display()))?
            .next()
            .is_some();
    ensure!(
        !occupied,
        "an export needs a new or an empty folder, and this one holds something: {}",
        out.display()
    );
    let reader = open(&target.folder)?;
    check_names(reader.manifest())?;
    fs::create_dir_all(out).with_context(|| format!("making {}", out.display()))?;
    match format {
        Format::Euroc => euroc::export(&reader, out, console),
        Format::Mp4 => mp4::export(&reader, out, console),
        Format::Csv => csv::export(&reader, out, console),
    }
    .with_context(|| format!("exporting to {}", out.display()))
}

/// Checks that no two streams or tables go to one file.
fn check_names(manifest: &Manifest) -> Result<()> {
    let mut names = BTreeSet::from(["events", "gaps", "frame_sets"].map(str::to_owned));
    let cameras = manifest.cameras.iter().map(|c| file_name(&c.name));
    let cameras = cameras.flat_map(|name| [format!("{name}_frames"), name]);
    for name in cameras.chain(manifest.imus.iter().map(|i| file_name(&i.name))) {
        ensure!(
            names.insert(name.clone()),
            "two of the session's cameras and IMUs would be written to files named {name}"
        );
    }
    Ok(())
}
