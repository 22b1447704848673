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
pub mod sightings;
pub mod targets;
pub mod told;
pub mod verify;

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
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

    /// Makes sure that none of these files is in the way. Call it before the work.
    ///
    /// # Errors
    /// One is there, and `--force` was not said.
    pub fn check<'a>(&self, folder: &Path, files: impl IntoIterator<Item = &'a str>) -> Result<()> {
        for path in files.into_iter().map(|file| folder.join(file)) {
            if !self.force && path.exists() {
                bail!(
                    "this result is there already, and --force was not said: {}",
                    path.display()
                );
            }
        }
        Ok(())
    }

    /// Writes results, all of them or as many as the disk took; makes the folder.
    ///
    /// # Errors
    /// One is in the way and `--force` was not said (then nothing is written), or the disk says no.
    pub fn write(&self, folder: &Path, files: &[(String, Vec<u8>)]) -> Result<()> {
        self.check(folder, files.iter().map(|(name, _)| name.as_str()))?;
        fs::create_dir_all(folder).with_context(|| format!("making {}", folder.display()))?;
        for (name, bytes) in files {
            let path = folder.join(name);
            fs::write(&path, bytes).with_context(|| format!("writing {}", path.display()))?;
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
