//! Small files of the kernel: one value each, or nothing.
//!
//! A file that is absent, empty, refused, not text, or fails to answer (a Jetson's sensors do while
//! their unit is off) has the same meaning: the machine does not report the value.

use std::fs::{self, File};
use std::io::Read;
use std::path::{Path, PathBuf};

/// No file of one value is longer, bytes.
const LONGEST: u64 = 4096;

/// Where the kernel's files are; in tests, a folder that imitates them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Roots {
    /// In place of `/sys`.
    pub sys: PathBuf,
    /// In place of `/proc`.
    pub proc: PathBuf,
    /// In place of `/run`.
    pub run: PathBuf,
}

impl Default for Roots {
    fn default() -> Self {
        Self::below(Path::new("/"))
    }
}

impl Roots {
    /// `sys`, `proc` and `run` below `root`.
    pub fn below(root: &Path) -> Self {
        Self {
            sys: root.join("sys"),
            proc: root.join("proc"),
            run: root.join("run"),
        }
    }
}

/// The file's text without blanks around it.
pub(crate) fn text(path: impl AsRef<Path>) -> Option<String> {
    let mut text = String::new();
    File::open(path)
        .ok()?
        .take(LONGEST)
        .read_to_string(&mut text)
        .ok()?;
    let text = text.trim();
    (!text.is_empty()).then(|| text.to_owned())
}

/// The whole number in the file.
pub(crate) fn integer(path: impl AsRef<Path>) -> Option<i64> {
    text(path)?.parse().ok()
}

/// The entries of `folder` that are named `prefix` and a number, by number.
pub(crate) fn numbered(folder: impl AsRef<Path>, prefix: &str) -> Vec<(u32, PathBuf)> {
    let mut found: Vec<(u32, PathBuf)> = names(&folder)
        .into_iter()
        .filter_map(|name| {
            let number = name.strip_prefix(prefix)?.parse().ok()?;
            Some((number, folder.as_ref().join(&name)))
        })
        .collect();
    found.sort();
    found
}

/// The names in `folder`, sorted; none if it is not there.
pub(crate) fn names(folder: impl AsRef<Path>) -> Vec<String> {
    let mut names: Vec<String> = fs::read_dir(folder)
        .into_iter()
        .flatten()
        .filter_map(|entry| entry.ok()?.file_name().into_string().ok())
        .collect();
    names.sort();
    names
}

/// Folders that imitate the kernel's.
#[cfg(test)]
pub(crate) mod fake {
    use super::*;
    use tempfile::TempDir;

    /// A root in which each line of `files`, `path = text`, is a file and each `path -> path` a
    /// link to another place in the root.
    pub(crate) fn tree(files: &str) -> (TempDir, Roots) {
        let root = tempfile::tempdir().unwrap();
        for line in files.lines().map(str::trim).filter(|l| !l.is_empty()) {
            let path = |name: &str| root.path().join(name.trim());
            let make_parent = |path: &Path| fs::create_dir_all(path.parent().unwrap()).unwrap();
            if let Some((link, target)) = line.split_once(" -> ") {
                make_parent(&path(link));
                std::os::unix::fs::symlink(path(target), path(link)).unwrap();
            } else {
                let (file, text) = line.split_once('=').unwrap();
                make_parent(&path(file));
                fs::write(path(file), format!("{}\n", text.trim())).unwrap();
            }
        }
        let roots = Roots::below(root.path());
        (root, roots)
    }

    #[test]
    fn values_or_nothing() {
        let (_root, roots) = tree("sys/a = 42\nsys/b =\nsys/c = warm\nsys/n10/x = 1\nsys/n9/x = 1");
        assert_eq!(integer(roots.sys.join("a")), Some(42));
        assert_eq!(integer(roots.sys.join("b")), None);
        assert_eq!(integer(roots.sys.join("c")), None);
        assert_eq!(text(roots.sys.join("c")).as_deref(), Some("warm"));
        assert_eq!(text(roots.sys.join("absent")), None);
        assert_eq!(text(&roots.sys), None, "a folder is no value");
        let numbers: Vec<u32> = numbered(&roots.sys, "n").iter().map(|(n, _)| *n).collect();
        assert_eq!(numbers, [9, 10], "by number, not by name");
        assert!(names(roots.sys.join("absent")).is_empty());
    }
}
