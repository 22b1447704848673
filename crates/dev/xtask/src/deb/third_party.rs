//! The notice of other people's code inside the program: each crate's version and licence, and the
//! texts of the licences, every text once.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use super::Architecture;
use super::files::output;
use super::program::cargo_home;
use crate::process::cargo;

/// A crate of the registry.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Crate {
    name: String,
    version: String,
    licence: String,
}

/// The notice, as text.
pub(super) fn notice(architecture: Architecture) -> Result<String> {
    let listing = output(
        cargo()?
            .args(["tree", "--locked", "--package=capture-daemon"])
            .args(["--edges=normal,no-proc-macro", "--prefix=none"])
            .args(["--target", &architecture.target(), "--format={p}|{l}"]),
    )?;
    let crates = registry_crates(&listing);
    let folders = source_folders()?;

    let mut text = String::from(
        "Crates of other people inside pawsd, and the texts of their licences.\n\n\
         The Rust standard library is inside too; its licence is MIT or Apache-2.0.\n\n",
    );
    let mut texts: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
    for Crate {
        name,
        version,
        licence,
    } in &crates
    {
        let title = format!("{name} {version}");
        text.push_str(&format!("{title}: {licence}\n"));
        for (file, licence) in licence_files(&folders, &format!("{name}-{version}"))? {
            let from = texts.entry(licence).or_default();
            from.insert(format!("{title}, {file}"));
        }
    }
    for (licence, from) in texts {
        let from: Vec<String> = from.into_iter().collect();
        let line = "=".repeat(78);
        text.push_str(&format!(
            "\n{line}\n{}\n{line}\n\n{}\n",
            from.join("\n"),
            licence.trim_end()
        ));
    }
    Ok(text)
}

/// The lines `NAME vVERSION|LICENCE` of crates that are not ours: those have a path after the
/// version. A crate that was listed before has a mark at its end.
fn registry_crates(listing: &str) -> BTreeSet<Crate> {
    listing
        .lines()
        .filter_map(|line| {
            let (package, licence) = line.split_once('|')?;
            let (name, version) = package.split_once(" v")?;
            (!version.contains(' ')).then(|| Crate {
                name: name.to_owned(),
                version: version.to_owned(),
                licence: licence.trim_end_matches(" (*)").to_owned(),
            })
        })
        .collect()
}

/// The folders in which Cargo keeps the sources of registries.
fn source_folders() -> Result<Vec<PathBuf>> {
    let folder = cargo_home()?.join("registry/src");
    let reading = || format!("reading {}", folder.display());
    let entries = fs::read_dir(&folder).with_context(reading)?;
    entries
        .map(|entry| Ok(entry.with_context(reading)?.path()))
        .collect()
}

/// The names and texts of a crate's licence files.
fn licence_files(folders: &[PathBuf], name: &str) -> Result<Vec<(String, String)>> {
    let folder = folders
        .iter()
        .map(|folder| folder.join(name))
        .find(|folder| folder.is_dir())
        .with_context(|| format!("the source of the crate {name} is in none of {folders:?}"))?;
    let reading = || format!("reading {}", folder.display());
    let mut files = Vec::new();
    for entry in fs::read_dir(&folder).with_context(reading)? {
        let path = entry.with_context(reading)?.path();
        let file = path.file_name().unwrap_or_default().to_string_lossy();
        if path.is_file() && is_licence(&file) {
            files.push((file.into_owned(), text_of(&path)?));
        }
    }
    files.sort();
    Ok(files)
}

fn is_licence(file: &str) -> bool {
    let file = file.to_uppercase();
    [
        "LICENSE",
        "LICENCE",
        "COPYING",
        "COPYRIGHT",
        "NOTICE",
        "UNLICENSE",
    ]
    .iter()
    .any(|start| file.starts_with(start))
}

fn text_of(path: &Path) -> Result<String> {
    let bytes = fs::read(path).with_context(|| format!("reading {}", path.display()))?;
    Ok(String::from_utf8_lossy(&bytes).replace("\r\n", "\n"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn our_own_crates_and_repetitions_are_left_out() {
        let listing = "\
capture-daemon v0.1.0 (/home/someone/paws/capture-daemon)|Apache-2.0 OR MIT
zstd-sys v2.1.2+zstd.1.5.7|MIT/Apache-2.0
calib v0.1.0 (/home/someone/paws/calib)|Apache-2.0 OR MIT (*)
approx v0.5.1|Apache-2.0
approx v0.5.1|Apache-2.0 (*)
";
        let found: Vec<String> = registry_crates(listing)
            .into_iter()
            .map(|found| format!("{} {} {}", found.name, found.version, found.licence))
            .collect();
        assert_eq!(
            found,
            [
                "approx 0.5.1 Apache-2.0",
                "zstd-sys 2.1.2+zstd.1.5.7 MIT/Apache-2.0"
            ]
        );
    }
}
