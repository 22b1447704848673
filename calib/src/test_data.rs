//! Files for tests: made-up ones in a temporary folder, real ones outside the project.

use std::path::{Path, PathBuf};

/// A folder that goes away with the test.
pub(crate) struct Folder(tempfile::TempDir);

impl Folder {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().expect("a temporary folder can be made"))
    }

    pub(crate) fn path(&self) -> &Path {
        self.0.path()
    }

    /// Writes a file, with the folders above it.
    pub(crate) fn file(&self, name: &str, text: &str) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::create_dir_all(path.parent().expect("a file is in a folder"))
            .expect("a folder can be made");
        std::fs::write(&path, text).expect("a file can be written");
        path
    }
}

/// A path in the real data: the folder that `PAWS_DATA` names, or `../shared/data` from the project's
/// root. `None`, with the reason printed, when it is not there.
pub(crate) fn shared(path: &str) -> Option<PathBuf> {
    let root = match std::env::var_os("PAWS_DATA") {
        Some(root) => PathBuf::from(root),
        None => Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared/data"),
    };
    let path = root.join(path);
    if !path.exists() {
        eprintln!("skipped: no real data at {}", path.display());
        return None;
    }
    Some(path)
}
