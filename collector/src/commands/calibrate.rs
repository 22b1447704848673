//! `paws calib`: calibration from recordings, one subcommand for each kind.
//!
//! Results go to a separate folder: `calibration/` in the session's folder if a library lists the
//! session, else the one of `--out`. Existing files are overwritten only with `--force`, which is
//! checked before any work is done.

pub mod camera_imu;
pub mod cameras;
pub mod convert;
pub mod imu;
pub mod imu_samples;
pub mod nominal_rig;
mod rig_file;
mod rig_poses;
pub mod target_detections;
pub mod targets;
pub mod verify;

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use cad_transforms::output::{Existing, write};
use clap::{Args, Subcommand};

use crate::console::Console;
use crate::outcome::Outcome;
use crate::target::Target;

/// Name of the results' folder in a session's folder.
pub const FOLDER: &str = "calibration";

/// What to calibrate.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Extrinsics and time offsets of the IMUs against their cameras, from a recording of a board
    CameraImu {
        /// The session
        session: String,
        /// Options
        #[command(flatten)]
        options: camera_imu::Options,
        /// Output
        #[command(flatten)]
        output: Output,
    },
    /// Intrinsics, stereo extrinsics and the rig, from a session in which targets were shown
    Cameras {
        /// The session
        session: String,
        /// Options
        #[command(flatten)]
        options: cameras::Options,
        /// Output
        #[command(flatten)]
        output: Output,
    },
    /// Write a calibration file in another format
    Convert(convert::Options),
    /// Check that the calibration still holds, from an ordinary recording
    Verify {
        /// The session
        session: String,
        /// Options
        #[command(flatten)]
        options: verify::Options,
    },
    /// Noise of the IMUs, from a recording at rest
    Imu {
        /// The session
        session: String,
        /// Options
        #[command(flatten)]
        options: imu::Options,
        /// Output
        #[command(flatten)]
        output: Output,
    },
    /// Calibration boards to print: a PDF at true size, and the board's file
    Targets(targets::Options),
}

/// Output.
#[derive(Clone, Debug, Default, Args)]
pub struct Output {
    /// Folder for the results [default: calibration/ in the session's folder]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Overwrite existing results
    #[arg(long)]
    pub force: bool,
}

impl Output {
    /// The folder for the results of a session.
    ///
    /// # Errors
    /// No folder was given and no library lists the session.
    pub fn folder(&self, target: &Target) -> Result<PathBuf> {
        match &self.out {
            Some(out) => Ok(out.clone()),
            None => target.derived(FOLDER, "--out names another path"),
        }
    }

    /// Checks that no possible output file exists, and returns the destination. Call it before the
    /// work.
    ///
    /// # Errors
    /// An output file exists, and `--force` was not given.
    pub fn prepare(&self, folder: PathBuf, possible_files: Vec<String>) -> Result<ResultFiles> {
        for path in possible_files.iter().map(|file| folder.join(file)) {
            if !self.force && path.exists() {
                bail!(
                    "this result exists already, and --force was not given: {}",
                    path.display()
                );
            }
        }
        let existing = match self.force {
            true => Existing::Replace,
            false => Existing::Refuse,
        };
        Ok(ResultFiles {
            folder,
            possible_files,
            existing,
        })
    }
}

/// Destination of the results of one run.
pub struct ResultFiles {
    folder: PathBuf,
    possible_files: Vec<String>,
    existing: Existing,
}

impl ResultFiles {
    /// Writes results in this order, each atomically, and prints their paths; creates the folder.
    /// Results of an earlier run without a new version are removed: beside new ones they would be
    /// mistaken for new.
    ///
    /// # Errors
    /// An output file exists, or an I/O error occurs.
    pub fn write(self, files: &[(String, Vec<u8>)], console: &mut Console<'_>) -> Result<()> {
        let folder = &self.folder;
        fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))?;
        let came = |name: &String| files.iter().any(|(other, _)| other == name);
        for name in self.possible_files.iter().filter(|name| !came(name)) {
            let path = folder.join(name);
            if self.existing == Existing::Replace && path.exists() {
                fs::remove_file(&path)
                    .with_context(|| format!("removing an old result: {}", path.display()))?;
                console.line(format!("removed the old {}", path.display()))?;
            }
        }
        for (name, bytes) in files {
            let path = folder.join(name);
            write(&path, bytes, self.existing)?;
            console.line(path.display())?;
        }
        Ok(())
    }
}

/// Runs `paws calib`.
///
/// # Errors
/// The session cannot be found or read, an output file exists already, or it cannot be written.
pub fn run(
    command: &Command,
    library: Option<&Path>,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    match command {
        Command::CameraImu {
            session,
            options,
            output,
        } => camera_imu::run(&Target::find(session, library)?, options, output, console),
        Command::Cameras {
            session,
            options,
            output,
        } => cameras::run(&Target::find(session, library)?, options, output, console),
        Command::Convert(options) => convert::run(options, console),
        Command::Verify { session, options } => {
            verify::run(&Target::find(session, library)?, options, console)
        }
        Command::Imu {
            session,
            options,
            output,
        } => imu::run(&Target::find(session, library)?, options, output, console),
        Command::Targets(options) => targets::run(options, console),
    }
}
