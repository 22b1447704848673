//! A test case: a name, what it shows, and a function that shows it in guests.
//!
//! A case prints nothing and decides by itself whether it has passed: an error is a failure. What
//! it measured is its [`Report`], also where it passes.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result};
use serde_json::Value;

use crate::machine::Machine;

/// A test case.
#[derive(Clone, Copy, Debug)]
pub struct Case {
    /// Its name, as typed.
    pub name: &'static str,
    /// What it shows, in a line.
    pub shows: &'static str,
    /// Whether it is part of the short form.
    pub quick: bool,
    /// Whether QEMU can run it.
    pub on_qemu: bool,
    /// Runs it.
    pub run: fn(&Bench) -> Result<Report>,
}

/// What a case measured.
#[derive(Clone, Debug, Default)]
pub struct Report {
    /// A line for people.
    pub line: String,
    /// Everything, for programs.
    pub figures: Value,
}

/// Where a case works.
#[derive(Clone, Debug)]
pub struct Bench {
    /// What runs its guests.
    pub machine: Machine,
    /// An empty folder of its own.
    pub folder: PathBuf,
    /// Whether a short slice will do.
    pub quick: bool,
    /// Decides everything that is random.
    pub seed: u64,
}

impl Bench {
    /// A folder in its folder, empty.
    ///
    /// # Errors
    /// It cannot be made.
    pub fn folder(&self, name: &str) -> Result<PathBuf> {
        let folder = self.folder.join(name);
        make_empty(&folder)?;
        Ok(folder)
    }
}

/// Makes a folder, or empties it.
///
/// # Errors
/// It cannot be made.
pub fn make_empty(folder: &Path) -> Result<()> {
    if folder.exists() {
        fs::remove_dir_all(folder).with_context(|| format!("emptying {}", folder.display()))?;
    }
    fs::create_dir_all(folder).with_context(|| format!("making the folder {}", folder.display()))
}
