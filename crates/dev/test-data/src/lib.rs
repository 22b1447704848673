//! Where the real recordings are. They are not part of the project; tests that need them skip
//! themselves where they are absent.

use std::path::{Path, PathBuf};

/// The folder that `PAWS_DATA` names, or the one beside the workspace; none where there is none.
pub fn folder() -> Option<PathBuf> {
    let named = std::env::var_os("PAWS_DATA").filter(|value| !value.is_empty());
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../../shared/data");
    let folder = named.map_or_else(beside, PathBuf::from);
    folder.canonicalize().ok().filter(|folder| folder.is_dir())
}

/// What has this path in the data folder, which is all of it for an empty one; none, with a line
/// that says why, where it is absent.
pub fn shared(path: &str) -> Option<PathBuf> {
    match sets([path]) {
        Ok([path]) => Some(path),
        Err(reason) => {
            eprintln!("{reason}");
            None
        }
    }
}

/// The data sets with these paths in the data folder, or the reason why the test is to be skipped.
///
/// # Errors
/// The reason, as it is to be printed.
pub fn sets<const N: usize>(paths: [&str; N]) -> Result<[PathBuf; N], String> {
    let Some(folder) = folder() else {
        return Err("skipped: no real recordings here; PAWS_DATA may name their folder".to_owned());
    };
    let sets = paths.map(|path| folder.join(path));
    match sets.iter().find(|set| !set.exists()) {
        Some(absent) => Err(format!(
            "skipped: this recording is absent: {}",
            absent.display()
        )),
        None => Ok(sets),
    }
}
