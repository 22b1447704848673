//! `paws export`: a session in other formats. (The segments are MCAP already.)
//!
//! * `euroc`: an ASL folder per camera, images decoded to PNG.
//! * `mp4`: one file per camera, the access units unchanged.
//! * `csv`: IMU samples, frames, frame sets, gaps and events as tables.
//!
//! An export goes to a new or an empty folder. Data that cannot be exported, including damaged
//! ranges of the session, is counted, reported, and changes the exit code.

mod csv;
mod euroc;
mod mp4;
mod yaml;

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use clap::ValueEnum;
use console_output::{Console, Outcome, text};
use session_access::open;
use session_archive::index::Index;
use session_archive::manifest::Manifest;

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

/// Reports how much the index had to leave out.
fn damage(index: &Index, console: &mut Console<'_>) -> Result<Outcome> {
    if index.damaged == 0 {
        return Ok(Outcome::Fine);
    }
    console.line(left_out(index.damaged))?;
    Ok(Outcome::Loss)
}

fn left_out(damaged: u64) -> String {
    let places = text::count(damaged, "damaged place");
    format!("{places} left out; `paws validate` reports what is missing")
}

/// A stream's name as part of a file name: `feet/imu` as `feet_imu`.
fn file_name(stream: &str) -> String {
    stream.replace('/', "_")
}
