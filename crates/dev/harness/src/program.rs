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
    once(&FOUND, "pawsd", "capture-daemon")
}

/// `paws`, as [`pawsd`].
///
/// # Errors
/// It cannot be built.
pub fn paws() -> Result<PathBuf> {
    static FOUND: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    once(&FOUND, "paws", "collector")
}

/// `paws-calib`, as [`pawsd`].
///
/// # Errors
/// It cannot be built.
pub fn calib() -> Result<PathBuf> {
    static FOUND: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    once(&FOUND, "paws-calib", "paws-calib")
}

/// `paws-reconstruct`, as [`pawsd`].
///
/// # Errors
/// It cannot be built.
pub fn reconstruct() -> Result<PathBuf> {
    static FOUND: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    once(&FOUND, "paws-reconstruct", "reconstruction")
}

fn once(found: &OnceLock<Result<PathBuf, String>>, name: &str, package: &str) -> Result<PathBuf> {
    let found = found.get_or_init(|| find(name, package).map_err(|e| format!("{e:#}")));
    found.clone().map_err(|e| anyhow!(e))
}

fn find(name: &str, package: &str) -> Result<PathBuf> {
    let own = std::env::current_exe().context("finding the own program")?;
    // A test is in `target/debug/deps`, a benchmark in `target/release`.
    let folder = own.ancestors().skip(1).find(|f| !f.ends_with("deps"));
    let folder = folder.context("finding the folder of the own program")?;
    let program = folder.join(name);
    if is_current(&program) {
        return Ok(program);
    }
    // Not always: with one package selected, cargo may choose fewer features of shared libraries
    // than with the whole workspace, and would compile them a second time.
    let workspace = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..");
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

/// Whether a program exists and none of the sources that cargo lists for it (beside it, in
/// `NAME.d`) is newer.
fn is_current(program: &Path) -> bool {
    let modified = |path: &Path| fs::metadata(path).and_then(|m| m.modified());
    let (Ok(built), Ok(list)) = (
        modified(program),
        fs::read_to_string(program.with_extension("d")),
    ) else {
        return false;
    };
    let is_older = |source: &PathBuf| modified(source).is_ok_and(|m: SystemTime| m <= built);
    sources(&list).iter().all(is_older)
}

/// The sources in a dependency file of `make`: `PROGRAM: SOURCE SOURCE`, with `\ ` for a space.
fn sources(list: &str) -> Vec<PathBuf> {
    let Some((_, sources)) = list.lines().next().and_then(|l| l.split_once(": ")) else {
        return Vec::new();
    };
    let whole = sources.replace("\\ ", "\0");
    let path = |s: &str| PathBuf::from(s.replace('\0', " "));
    whole.split_whitespace().map(path).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_are_read_from_the_dependency_file() {
        let list = "/t/debug/pawsd: /a/src/main.rs /b\\ c/src/lib.rs\n";
        assert_eq!(
            sources(list),
            ["/a/src/main.rs", "/b c/src/lib.rs"].map(PathBuf::from)
        );
        assert!(sources("").is_empty());
    }

    #[test]
    fn a_program_older_than_a_source_is_not_current() {
        let folder = std::env::temp_dir().join(format!("program-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let (source, program) = (folder.join("main.rs"), folder.join("pawsd"));
        assert!(!is_current(&program));
        fs::write(&source, "").unwrap();
        fs::write(&program, "").unwrap();
        assert!(!is_current(&program), "without a list of sources");
        let list = format!("{}: {}\n", program.display(), source.display());
        fs::write(folder.join("pawsd.d"), list).unwrap();
        let built = fs::metadata(&program).unwrap().modified().unwrap();
        let set = |time| fs::File::open(&source).unwrap().set_modified(time).unwrap();
        set(built);
        assert!(is_current(&program));
        set(built + std::time::Duration::from_secs(1));
        assert!(!is_current(&program));
        fs::remove_file(&source).unwrap();
        assert!(!is_current(&program));
        fs::remove_dir_all(&folder).unwrap();
    }
}
