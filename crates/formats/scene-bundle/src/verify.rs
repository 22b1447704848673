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

/// Checks every file of every output, those in listings too. `progress` is called with the bytes
/// read.
///
/// # Errors
/// [`BundleError::Io`] when the bundle's folder cannot be listed. Problems of files are in the
/// result.
///
/// ```
/// use scene_bundle::verify::verify;
/// # use scene_bundle::{Bundle, Scene};
/// # let folder = tempfile::tempdir()?;
/// # let path = folder.path().join("walk.scene");
/// # let provenance = scene_bundle::Provenance {
/// #     session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
/// #     handoff_blake3: "ab".repeat(32),
/// #     judgement: None,
/// #     rig: scene_bundle::RigRevision { name: "chest".to_owned(), revision: "B".to_owned() },
/// #     program: "example".to_owned(),
/// #     program_version: "1.0".to_owned(),
/// #     started_civil_ns: 1_790_000_000_000_000_000,
/// #     ended_civil_ns: None,
/// # };
/// # let record = scene_bundle::Record {
/// #     stage: "example".to_owned(),
/// #     stage_version: 1,
/// #     settings: serde_json::json!({ "step": 2 }),
/// #     inputs: std::collections::BTreeMap::new(),
/// # };
/// # let bundle = Bundle::create_or_open(&path, provenance)?;
/// # let draft = bundle.begin("notes")?;
/// # draft.write("notes.txt", b"stairs")?;
/// # draft.commit(record)?;
/// # drop(bundle);
///
/// let scene = Scene::open(&path)?;
/// let report = verify(&scene, |_| {})?;
/// assert!(report.is_whole());
/// assert_eq!((report.outputs[0].files, report.outputs[0].bytes), (1, 6));
///
/// std::fs::write(scene.output("notes")?.file_path("notes.txt"), b"Stairs")?;
/// let report = verify(&scene, |_| {})?;
/// assert!(!report.is_whole());
/// assert_eq!(report.outputs[0].problems.len(), 1);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn verify(scene: &Scene, mut progress: impl FnMut(u64)) -> Result<VerifyReport, BundleError> {
    let mut checked = VerifyReport::default();
    let known = [
        layout::MANIFEST,
        layout::LOCK,
        layout::STAGE_TIMINGS,
        layout::PAGE,
        layout::CAMERA_IMAGES,
        layout::FILM,
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
        if named.contains(&path) || layout::is_splats_checkpoint(&path) {
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
