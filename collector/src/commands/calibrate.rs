//! `paws calib`: from recordings to calibration, one verb below it for each thing that is calibrated.
//!
//! A result goes to a folder of its own, `calibration/` in the session's folder where a library lists
//! the session, else wherever `--out` says. A file that is there already is overwritten only with
//! `--force`, and whether one is in the way is known before any work is done.

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

/// Folder of the results in a session's folder.
pub const FOLDER: &str = "calibration";

/// What to calibrate.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Place and clock of the IMUs behind their cameras, from a recording before a board
    CameraImu {
        /// The session
        session: String,
        /// How to do it
        #[command(flatten)]
        options: camera_imu::Options,
        /// Where results go
        #[command(flatten)]
        output: Output,
    },
    /// Lenses, stereo cameras and the rig, from a session in which targets were shown
    Cameras {
        /// The session
        session: String,
        /// How to do it
        #[command(flatten)]
        options: cameras::Options,
        /// Where results go
        #[command(flatten)]
        output: Output,
    },
    /// Write a calibration file in another format
    Convert(convert::Options),
    /// Whether what is told of the rig is still true, from an ordinary walk
    Verify {
        /// The session
        session: String,
        /// How to do it
        #[command(flatten)]
        options: verify::Options,
    },
    /// Noise of the IMUs, from a rig that lay still
    Imu {
        /// The session
        session: String,
        /// How to do it
        #[command(flatten)]
        options: imu::Options,
        /// Where results go
        #[command(flatten)]
        output: Output,
    },
    /// Boards to print: a PDF at true size, and the board's file
    Targets(targets::Options),
}

/// Where results go.
#[derive(Clone, Debug, Default, Args)]
pub struct Output {
    /// Folder for the results [default: calibration/ in the session's folder]
    #[arg(long, value_name = "DIR")]
    pub out: Option<PathBuf>,
    /// Overwrite results that are there
    #[arg(long)]
    pub force: bool,
}

impl Output {
    /// The folder for the results of a session.
    ///
    /// # Errors
    /// None was given and no library lists the session.
    pub fn folder(&self, target: &Target) -> Result<PathBuf> {
        match &self.out {
            Some(out) => Ok(out.clone()),
            None => target.derived(FOLDER, "--out names another place for it"),
        }
    }

    /// Makes sure that none of the files that may come out is in the way, and gives where they will go. Call it before
    /// the work.
    ///
    /// # Errors
    /// One is there, and `--force` was not said.
    pub fn prepare(&self, folder: PathBuf, possible_files: Vec<String>) -> Result<ResultFiles> {
        for path in possible_files.iter().map(|file| folder.join(file)) {
            if !self.force && path.exists() {
                bail!(
                    "this result is there already, and --force was not said: {}",
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

/// Where the results of one run go.
pub struct ResultFiles {
    folder: PathBuf,
    possible_files: Vec<String>,
    existing: Existing,
}

impl ResultFiles {
    /// Writes results in their order, each of them whole or not at all, and says where they are; makes the folder. Results
    /// of an earlier run that did not come out this time go: beside new ones they would be taken for new.
    ///
    /// # Errors
    /// One is in the way, or the disk says no.
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

/// Does it.
///
/// # Errors
/// The session cannot be found or read, a result is in the way, or it cannot be written.
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
