//! The built programs, as a user would start them.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use std::time::SystemTime;

use anyhow::{Context as _, Result, anyhow, ensure};

/// `pawsd` of the same build as the calling program; built if it is absent or older than its
/// sources.
///
/// # Errors
/// It cannot be built.
pub fn pawsd() -> Result<PathBuf> {
    static FOUND: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let sources = [
        "capture-daemon/src",
        "crates/formats/calibration-files/src",
        "crates/formats/session-archive/src",
        "crates/support/camera-models/src",
        "crates/support/video/src",
    ];
    once(&FOUND, "pawsd", "capture-daemon", &sources)
}

/// `paws`, as [`pawsd`].
///
/// # Errors
/// It cannot be built.
pub fn paws() -> Result<PathBuf> {
    static FOUND: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let sources = [
        "collector/src",
        "crates/formats/calibration-files/src",
        "crates/support/camera-models/src",
        "cad-transforms/src",
        "crates/formats/session-archive/src",
    ];
    once(&FOUND, "paws", "collector", &sources)
}

/// `paws-calib`, as [`pawsd`].
///
/// # Errors
/// It cannot be built.
pub fn calib() -> Result<PathBuf> {
    static FOUND: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let sources = [
        "calib/src",
        "crates/formats/calibration-files/src",
        "crates/support/boards/src",
        "crates/support/camera-models/src",
        "crates/vision/calib/src",
        "cad-transforms/src",
        "crates/formats/session-archive/src",
    ];
    once(&FOUND, "paws-calib", "paws-calib", &sources)
}

/// `paws-reconstruct`, as [`pawsd`].
///
/// # Errors
/// It cannot be built.
pub fn reconstruct() -> Result<PathBuf> {
    static FOUND: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    let sources = [
        "reconstruction/src",
        "crates/vision/odometry/src",
        "crates/formats/scene-bundle/src",
        "crates/formats/calibration-files/src",
        "crates/support/camera-models/src",
    ];
    once(&FOUND, "paws-reconstruct", "reconstruction", &sources)
}

fn once(
    found: &OnceLock<Result<PathBuf, String>>,
    name: &str,
    package: &str,
    sources: &[&str],
) -> Result<PathBuf> {
    let found = found.get_or_init(|| find(name, package, sources).map_err(|e| format!("{e:#}")));
    found.clone().map_err(|e| anyhow!(e))
}

fn find(name: &str, package: &str, sources: &[&str]) -> Result<PathBuf> {
    let own = std::env::current_exe().context("finding the own program")?;
    // A test is in `target/debug/deps`, a benchmark in `target/release`.
    let folder = own.ancestors().skip(1).find(|f| !f.ends_with("deps"));
    let folder = folder.context("finding the folder of the own program")?;
    let program = folder.join(name);
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    let newest = sources
        .iter()
        .filter_map(|s| newest(&workspace.join(s)))
        .max();
    let built = fs::metadata(&program).and_then(|m| m.modified()).ok();
    if built.is_some() && built >= newest {
        return Ok(program);
    }
    let mut build = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    build
        .current_dir(&workspace)
        .args(["build", "--quiet", "--package", package, "--bin", name]);
    if let Some(target) = folder.parent() {
        build.arg("--target-dir").arg(target);
    }
    if folder.ends_with("release") {
        build.arg("--release");
    }
    let status = build.status().with_context(|| format!("building {name}"))?;
    ensure!(
        status.success(),
        "building {name}: cargo ended with {status}"
    );
    Ok(program)
}

/// Modification time of the newest file in a folder.
fn newest(folder: &Path) -> Option<SystemTime> {
    let entries = fs::read_dir(folder).ok()?.filter_map(Result::ok);
    let changed = |entry: fs::DirEntry| match entry.file_type() {
        Ok(kind) if kind.is_dir() => newest(&entry.path()),
        _ => entry.metadata().and_then(|m| m.modified()).ok(),
    };
    entries.filter_map(changed).max()
}
