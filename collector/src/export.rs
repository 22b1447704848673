//! `paws export`: a session in the formats of others. (MCAP needs none: the segments are MCAP.)
//!
//! * `euroc`: an ASL folder per camera, pictures decoded to PNG.
//! * `mp4`: one file per camera, the compressed pictures as they are.
//! * `csv`: IMU samples, frames, frame sets, gaps and events as tables.
//!
//! An export goes to a new or an empty folder. What cannot be exported is counted, told, and makes
//! the exit code say so.

mod csv;
mod euroc;
mod mp4;
mod yaml;

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use clap::ValueEnum;

use crate::console::Console;
use crate::outcome::Outcome;
use crate::target::Target;
use crate::validate::open;

/// What to export to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Format {
    /// ASL/EuRoC folders: PNG pictures, IMU and calibration
    Euroc,
    /// One MP4 file per camera, not encoded again
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
    fs::create_dir_all(out).with_context(|| format!("making {}", out.display()))?;
    let reader = open(&target.folder)?;
    match format {
        Format::Euroc => euroc::export(&reader, out, console),
        Format::Mp4 => mp4::export(&reader, out, console),
        Format::Csv => csv::export(&reader, out, console),
    }
    .with_context(|| format!("exporting to {}", out.display()))
}

/// The name of a stream as part of a file name: `feet/imu` as `feet_imu`.
fn file_name(stream: &str) -> String {
    stream.replace('/', "_")
}
