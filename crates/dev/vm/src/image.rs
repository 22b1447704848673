//! Disk images: sparse files with a file system in them.

use std::ffi::OsStr;
use std::fs::File;
use std::path::Path;
use std::process::{Command, Stdio};

use anyhow::{Context as _, Result, bail};
use serde::Serialize;

/// A file system that the rig may have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FileSystem {
    /// ext4, as mkfs makes it.
    Ext4,
    /// F2FS, for flash.
    F2fs,
}

impl FileSystem {
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Ext4, Self::F2fs];

    /// Its name, as mount knows it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Ext4 => "ext4",
            Self::F2fs => "f2fs",
        }
    }
}

/// An image without a file system, all holes.
///
/// # Errors
/// The file cannot be made.
pub fn blank(path: &Path, bytes: u64) -> Result<()> {
    File::create(path)
        .and_then(|file| file.set_len(bytes))
        .with_context(|| format!("making a disk image of {bytes} bytes {}", path.display()))
}

/// An image with an empty file system.
///
/// # Errors
/// The file cannot be made, or mkfs is missing or fails.
pub fn formatted(path: &Path, bytes: u64, file_system: FileSystem) -> Result<()> {
    blank(path, bytes)?;
    match file_system {
        // Nothing is left to be done at the first mount, so that the log of writes is that of the
        // recording.
        FileSystem::Ext4 => tool(
            "mkfs.ext4",
            ["-q", "-F", "-E", "lazy_itable_init=0,lazy_journal_init=0"],
            path,
        ),
        FileSystem::F2fs => tool("mkfs.f2fs", ["-q", "-f"], path),
    }
}

/// A copy that has holes where the original has zeros.
///
/// # Errors
/// What cp says.
pub fn copy(from: &Path, to: &Path) -> Result<()> {
    tool(
        "cp",
        [
            OsStr::new("--sparse=always"),
            OsStr::new("--reflink=auto"),
            from.as_os_str(),
        ],
        to,
    )
}

fn tool(
    program: &str,
    arguments: impl IntoIterator<Item = impl AsRef<OsStr>>,
    image: &Path,
) -> Result<()> {
    // mkfs is where only root looks.
    let path = std::env::var("PATH").unwrap_or_default() + ":/usr/sbin:/sbin";
    let output = Command::new(program)
        .env("PATH", path)
        .args(arguments)
        .arg(image)
        .stdin(Stdio::null())
        .output()
        .with_context(|| format!("starting {program} for the image {}", image.display()))?;
    if output.status.success() {
        return Ok(());
    }
    bail!(
        "{program} ended with {}: {}: {}",
        output.status,
        String::from_utf8_lossy(&output.stderr).trim(),
        image.display()
    )
}
