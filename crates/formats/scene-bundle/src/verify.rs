//! Checking every byte of a bundle against its hashes.

use std::collections::BTreeSet;

use crate::error::BundleError;
use crate::error_chain;
use crate::layout;
use crate::scene::{OutputReader, Scene};

/// Result of a verification.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct VerifyReport {
    /// Every output, by name.
    pub outputs: Vec<OutputReport>,
    /// Files and folders that nothing names: drafts and old versions left by a writer, or foreign
    /// files. They are harmless.
    pub unnamed: Vec<String>,
}

/// Result of the verification of one output.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OutputReport {
    /// Its name.
    pub name: String,
    /// Number of intact files.
    pub files: u64,
    /// Their bytes.
    pub bytes: u64,
    /// Problems of the others, a sentence each.
    pub problems: Vec<String>,
}

impl VerifyReport {
    /// Whether everything is as it was written.
    pub fn is_whole(&self) -> bool {
        self.outputs.iter().all(|o| o.problems.is_empty())
    }
}

/// Checks every file of every output, those in listings too. `progress` is called with the bytes read.
///
/// # Errors
/// [`BundleError::Io`] when the bundle's folder cannot be listed. Problems of files are in the
/// result.
pub fn verify(scene: &Scene, mut progress: impl FnMut(u64)) -> Result<VerifyReport, BundleError> {
    let mut checked = VerifyReport::default();
    let known = [
        layout::MANIFEST,
        layout::LOCK,
        layout::STAGE_TIMINGS,
        layout::PAGE,
    ];
    let mut named = BTreeSet::from(known.map(str::to_owned));
    for (name, output) in &scene.manifest().outputs {
        let mut found = OutputReport {
            name: name.clone(),
            files: 0,
            bytes: 0,
            problems: Vec::new(),
        };
        let folder = layout::folder(name, &output.hash);
        match scene.output(name) {
            Ok(reader) => {
                check(&reader, &mut found, &mut progress);
                named.extend(reader.paths().map(|path| format!("{folder}/{path}")));
                // An output may have no files.
                if reader.paths().next().is_none() {
                    named.insert(folder);
                }
            }
            Err(error) => {
                found.problems.push(error_chain(&error));
                // Its files cannot be distinguished from others.
                named.insert(folder);
            }
        }
        checked.outputs.push(found);
    }
    find_unnamed(scene, "", &named, &mut checked.unnamed)?;
    Ok(checked)
}

fn check(reader: &OutputReader, found: &mut OutputReport, progress: &mut dyn FnMut(u64)) {
    for path in reader.paths() {
        match reader.check(path, progress) {
            Ok(bytes) => {
                found.files += 1;
                found.bytes += bytes;
            }
            Err(error) => found.problems.push(error_chain(&error)),
        }
    }
}

/// If a folder holds no named file, only the folder is listed.
fn find_unnamed(
    scene: &Scene,
    dir: &str,
    named: &BTreeSet<String>,
    unnamed: &mut Vec<String>,
) -> Result<(), BundleError> {
    for (name, is_dir) in scene.list(dir)? {
        let path = if dir.is_empty() {
            name
        } else {
            format!("{dir}/{name}")
        };
        if named.contains(&path) {
            continue;
        }
        let inside = format!("{path}/");
        let leads_to_named = named.range(inside.clone()..).next();
        if is_dir && leads_to_named.is_some_and(|next| next.starts_with(&inside)) {
            find_unnamed(scene, &path, named, unnamed)?;
        } else {
            unnamed.push(path);
        }
    }
    Ok(())
}
