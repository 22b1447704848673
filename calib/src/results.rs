//! The files that a run writes.
//!
//! Results go to a separate folder: `calibration/` in the session's folder if a library lists the
//! session, else the one of `--out`. Existing files are overwritten only with `--force`, which is
//! checked before any work is done.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use cad_transforms::output::{Existing, write};
use clap::Args;
use console_output::Console;
use session_access::SessionFolder;

/// Name of the results' folder in a session's folder.
const FOLDER: &str = "calibration";

/// Output.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct Output {
    /// Folder for the results [default: calibration/ in the session's folder]
    #[arg(long, value_name = "DIR")]
    pub(crate) out: Option<PathBuf>,
    /// Overwrite existing results
    #[arg(long)]
    pub(crate) force: bool,
}

impl Output {
    /// The folder for the results of a session.
    ///
    /// # Errors
    /// No folder was given and no library lists the session.
    pub(crate) fn folder(&self, session: &SessionFolder) -> Result<PathBuf> {
        match &self.out {
            Some(out) => Ok(out.clone()),
            None => session.derived(FOLDER, "--out names another path"),
        }
    }

    /// Checks that no possible output file exists, and returns the destination. Call it before the
    /// work.
    ///
    /// # Errors
    /// An output file exists, and `--force` was not given.
    pub(crate) fn prepare(
        &self,
        folder: PathBuf,
        possible_files: Vec<String>,
    ) -> Result<ResultFiles> {
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
pub(crate) struct ResultFiles {
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
    pub(crate) fn write(
        self,
        files: &[(String, Vec<u8>)],
        console: &mut Console<'_>,
    ) -> Result<()> {
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
