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
    once(&FOUND, "pawsd", "capture-daemon", "capture-daemon")
}

/// `paws`, as [`pawsd`].
///
/// # Errors
/// It cannot be built.
pub fn paws() -> Result<PathBuf> {
    static FOUND: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    once(&FOUND, "paws", "collector", "collector")
}

/// `paws-calib`, as [`pawsd`].
///
/// # Errors
/// It cannot be built.
pub fn calib() -> Result<PathBuf> {
    static FOUND: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    once(&FOUND, "paws-calib", "paws-calib", "calib")
}

/// `paws-reconstruct`, as [`pawsd`].
///
/// # Errors
/// It cannot be built.
pub fn reconstruct() -> Result<PathBuf> {
    static FOUND: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    once(
        &FOUND,
        "paws-reconstruct",
        "reconstruction",
        "reconstruction",
    )
}

fn once(
    found: &OnceLock<Result<PathBuf, String>>,
    name: &str,
    package: &str,
    folder: &str,
) -> Result<PathBuf> {
    let found = found.get_or_init(|| find(name, package, folder).map_err(|e| format!("{e:#}")));
    found.clone().map_err(|e| anyhow!(e))
}

/// What programs are made of, apart from their own folder.
const LIBRARIES: [&str; 7] = [
    "Cargo.lock",
    "cad-transforms",
    "crates/devices",
    "crates/formats",
    "crates/support",
    "crates/synthetic",
    "crates/vision",
];

fn find(name: &str, package: &str, source: &str) -> Result<PathBuf> {
    let own = std::env::current_exe().context("finding the own program")?;
    // A test is in `target/debug/deps`, a benchmark in `target/release`.
    let folder = own.ancestors().skip(1).find(|f| !f.ends_with("deps"));
    let folder = folder.context("finding the folder of the own program")?;
    let program = folder.join(name);
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
    let sources = LIBRARIES.iter().chain([&source]);
    if is_current(&program, sources.map(|s| workspace.join(s))) {
        return Ok(program);
    }
    // Not always: with one package selected, cargo may choose fewer features of shared libraries
    // than with the whole workspace, and would compile them a second time.
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

/// Whether a program exists and none of its sources, files or folders, is newer.
fn is_current(program: &Path, sources: impl Iterator<Item = PathBuf>) -> bool {
    let Ok(built) = fs::metadata(program).and_then(|m| m.modified()) else {
        return false;
    };
    let newest = sources.filter_map(|source| newest(&source)).max();
    newest.is_none_or(|newest| newest <= built)
}

/// Modification time of a file, or of the newest source or manifest in a folder.
fn newest(path: &Path) -> Option<SystemTime> {
    let Ok(entries) = fs::read_dir(path) else {
        return fs::metadata(path).and_then(|m| m.modified()).ok();
    };
    let is_source = |path: &Path| {
        let is_compiled = path.extension().is_some_and(|e| e == "rs" || e == "toml");
        is_compiled || path.is_dir() && !path.ends_with("target") && !path.ends_with("tests")
    };
    let paths = entries.filter_map(Result::ok).map(|entry| entry.path());
    let sources = paths.filter(|path| is_source(path));
    sources.filter_map(|path| newest(&path)).max()
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn a_program_older_than_a_source_is_not_current() {
        let folder = tempfile::tempdir().unwrap();
        let (source, program) = (folder.path().join("crates"), folder.path().join("pawsd"));
        fs::create_dir_all(source.join("video/src")).unwrap();
        let (file, page) = (
            source.join("video/src/lib.rs"),
            source.join("video/README.md"),
        );
        let current = || is_current(&program, [source.clone()].into_iter());
        assert!(!current(), "without a program");
        for path in [&file, &page, &program] {
            fs::write(path, "").unwrap();
        }
        let built = fs::metadata(&program).unwrap().modified().unwrap();
        let set = |path: &Path, time| {
            let file = fs::File::options().write(true).open(path).unwrap();
            file.set_modified(time).unwrap();
        };
        set(&file, built);
        set(&page, built + Duration::from_secs(1));
        assert!(current(), "a page is no source");
        set(&file, built + Duration::from_secs(1));
        assert!(!current());
    }
}
