//! `scene.json`: provenance of the bundle, and its outputs with their hashes.
//!
//! Contract: a manifest that was read is of this version and leads to no file outside the bundle.
//! Unknown fields are an error, so that writing a manifest again never loses anything of it.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::error::BundleError;
use crate::judgement::Judgement;
use crate::layout;

/// Value of [`Manifest::format`].
pub const FORMAT: &str = "paws-scene";
/// The version that this crate writes. It reads version 1 too, which has no verdict on the session.
pub const VERSION: u32 = 2;

/// The manifest of a bundle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// [`FORMAT`].
    pub format: String,
    /// [`VERSION`], or 1 as long as it was not written to again.
    pub version: u32,
    /// Source of the bundle, and the program that wrote it.
    pub provenance: Provenance,
    /// Outputs by name.
    pub outputs: BTreeMap<String, Output>,
}

/// Source of a bundle, and the program that wrote it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Provenance {
    /// The session.
    pub session_id: String,
    /// BLAKE3 of all of the session's files, hex: the seal of its hand-off.
    pub handoff_blake3: String,
    /// Verdict that the session was handed over with; absent in version 1, or where it is not
    /// known.
    #[serde(default)]
    pub judgement: Option<Judgement>,
    /// The rig that recorded it.
    pub rig: RigRevision,
    /// The program that last wrote to the bundle, and its version.
    pub program: String,
    /// Version of the program.
    pub program_version: String,
    /// When that program began, ns of UTC since 1970, as well as the host knew.
    pub started_civil_ns: i64,
    /// When it ended; absent while it runs, and after it was stopped.
    pub ended_civil_ns: Option<i64>,
}

/// A rig, as its file calls it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RigRevision {
    /// Its name.
    pub name: String,
    /// Which build of it.
    pub revision: String,
}

/// Provenance of an output.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// The stage that wrote it.
    pub stage: String,
    /// The stage's version. A stage counts it up when the same input gives another output.
    pub stage_version: u32,
    /// All settings that the output depends on, defaults included.
    pub settings: serde_json::Value,
    /// Hashes of what went in, by name: outputs of this bundle, or what the provenance names.
    /// BLAKE3, hex.
    pub inputs: BTreeMap<String, String>,
}

/// An output: its provenance and its files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Output {
    /// As [`Record::stage`].
    pub stage: String,
    /// As [`Record::stage_version`].
    pub stage_version: u32,
    /// As [`Record::settings`].
    pub settings: serde_json::Value,
    /// As [`Record::inputs`].
    pub inputs: BTreeMap<String, String>,
    /// Its files, sorted by path.
    pub files: Vec<FileEntry>,
    /// [`content_hash`] of the files.
    pub hash: String,
}

/// A file of an output.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileEntry {
    /// Path in the output's folder.
    pub path: String,
    /// Length, bytes.
    pub bytes: u64,
    /// BLAKE3 of the content, hex.
    pub blake3: String,
}

impl Output {
    pub(crate) fn new(record: Record, files: Vec<FileEntry>) -> Self {
        Self {
            stage: record.stage,
            stage_version: record.stage_version,
            settings: record.settings,
            inputs: record.inputs,
            hash: content_hash(&files),
            files,
        }
    }

    /// Whether it was made with this record, so that running the stage again would give the same.
    pub fn is_made_by(&self, record: &Record) -> bool {
        self.stage == record.stage
            && self.stage_version == record.stage_version
            && self.settings == record.settings
            && self.inputs == record.inputs
    }
}

/// Content hash of an output: BLAKE3, hex, of a line `HASH BYTES PATH\n` for each file, in the
/// order of the bytes of their paths.
///
/// The order of the files does not matter, their paths do:
///
/// ```
/// use scene_bundle::manifest::{FileEntry, content_hash};
///
/// let file = |path: &str, digit: &str| FileEntry {
///     path: path.to_owned(),
///     bytes: 4,
///     blake3: digit.repeat(64),
/// };
/// let hash = content_hash(&[file("a.npy", "1"), file("b.json", "2")]);
/// assert_eq!(hash, content_hash(&[file("b.json", "2"), file("a.npy", "1")]));
/// assert_ne!(hash, content_hash(&[file("a.npy", "2"), file("b.json", "1")]));
/// assert_eq!(hash.len(), 64);
/// ```
pub fn content_hash(files: &[FileEntry]) -> String {
    let mut files: Vec<&FileEntry> = files.iter().collect();
    files.sort_by(|a, b| a.path.cmp(&b.path));
    let mut hasher = blake3::Hasher::new();
    for file in files {
        hasher.update(format!("{} {} {}\n", file.blake3, file.bytes, file.path).as_bytes());
    }
    hasher.finalize().to_hex().to_string()
}

impl Manifest {
    pub(crate) fn new(provenance: Provenance) -> Self {
        Self {
            format: FORMAT.to_owned(),
            version: VERSION,
            provenance,
            outputs: BTreeMap::new(),
        }
    }

    /// Outputs made from an input that was recomputed since, with the name of that input: they do
    /// not belong to the others.
    ///
    /// ```
    /// # use scene_bundle::Bundle;
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
    /// let write = |name: &str, content: &[u8], input: Option<(&str, &str)>| {
    ///     let draft = bundle.begin(name)?;
    ///     draft.write("data.txt", content)?;
    ///     let inputs = input.into_iter().map(|(name, hash)| (name.to_owned(), hash.to_owned()));
    ///     draft.commit(scene_bundle::Record { inputs: inputs.collect(), ..record.clone() })
    /// };
    /// let trajectory = write("trajectory", b"first", None)?;
    /// write("keyframes", b"of the first", Some(("trajectory", &trajectory.hash)))?;
    /// assert!(bundle.manifest().outdated().is_empty());
    ///
    /// write("trajectory", b"second", None)?;
    /// assert_eq!(bundle.manifest().outdated().get("keyframes"), Some(&"trajectory"));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn outdated(&self) -> BTreeMap<&str, &str> {
        let mut outdated = BTreeMap::new();
        // An output made from an outdated one is itself outdated: each round finds at least one
        // more, or ends.
        for _ in 0..self.outputs.len() {
            for (name, output) in &self.outputs {
                let other = output.inputs.iter().find(|(input, hash)| {
                    let now = self.outputs.get(*input);
                    now.is_some_and(|now| now.hash != **hash)
                        || outdated.contains_key(input.as_str())
                });
                if let Some((input, _)) = other {
                    outdated.entry(name.as_str()).or_insert(input.as_str());
                }
            }
        }
        outdated
    }

    /// Parses the bytes of a file. `path` is for messages.
    pub(crate) fn parse(bytes: &[u8], path: &Path) -> Result<Self, BundleError> {
        #[derive(Deserialize)]
        struct Header {
            format: String,
            version: u32,
        }
        let wrong = |found: String, expected: &str| BundleError::NotABundle {
            path: path.to_owned(),
            found,
            expected: expected.to_owned(),
        };
        let expected = format!("a manifest of {FORMAT} version 1 or {VERSION}");
        let header: Header = serde_json::from_slice(bytes)
            .map_err(|e| wrong(format!("JSON where {e}"), &expected))?;
        if header.format != FORMAT || !(1..=VERSION).contains(&header.version) {
            let found = format!("{} version {}", header.format, header.version);
            return Err(wrong(found, &format!("{FORMAT} version 1 or {VERSION}")));
        }
        let manifest: Self = serde_json::from_slice(bytes)
            .map_err(|e| wrong(format!("JSON where {e}"), &expected))?;
        for (name, output) in &manifest.outputs {
            if !layout::is_output_name(name) {
                return Err(wrong(
                    format!("an output called {name:?}"),
                    "a name of the format",
                ));
            }
            if let Some(file) = output.files.iter().find(|f| !layout::is_file_path(&f.path)) {
                let found = format!("a file {:?} of output {name}", file.path);
                return Err(wrong(found, "a path in the output's folder"));
            }
            if output.hash != content_hash(&output.files) {
                let found = format!("the hash {} of output {name}", output.hash);
                return Err(wrong(
                    found,
                    "the hash of its files (the manifest was edited)",
                ));
            }
        }
        Ok(manifest)
    }

    pub(crate) fn to_json(&self) -> Vec<u8> {
        let mut text = serde_json::to_vec_pretty(self).unwrap_or_default();
        text.push(b'\n');
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bundle::tests::provenance;

    fn entry(path: &str, content: &[u8]) -> FileEntry {
        FileEntry {
            path: path.to_owned(),
            bytes: content.len() as u64,
            blake3: blake3::hash(content).to_hex().to_string(),
        }
    }

    fn manifest() -> Manifest {
        let record = Record {
            stage: "odometry".to_owned(),
            stage_version: 3,
            settings: serde_json::json!({ "rate_hz": 0.1 }),
            inputs: BTreeMap::new(),
        };
        let mut manifest = Manifest::new(provenance());
        let files = vec![entry("a", b"1"), entry("b/c", b"")];
        manifest
            .outputs
            .insert("rig".to_owned(), Output::new(record, files));
        manifest
    }

    #[test]
    fn the_hash_is_of_sorted_lines() {
        let (a, b) = (entry("a", b"1"), entry("b", b""));
        let text = format!("{} 1 a\n{} 0 b\n", a.blake3, b.blake3);
        let expected = blake3::hash(text.as_bytes()).to_hex().to_string();
        assert_eq!(content_hash(&[a.clone(), b.clone()]), expected);
        assert_eq!(content_hash(&[b, a]), expected);
    }

    #[test]
    fn outputs_of_recomputed_inputs_are_outdated() {
        let mut manifest = Manifest::new(provenance());
        let make = |manifest: &mut Manifest, name: &str, of: &[&str], content: &[u8]| {
            let hash = |input: &&str| {
                let made = manifest.outputs.get(*input).map(|o| o.hash.clone());
                (
                    (*input).to_owned(),
                    made.unwrap_or_else(|| "5ea1".to_owned()),
                )
            };
            let record = Record {
                stage: name.to_owned(),
                stage_version: 1,
                settings: serde_json::Value::Null,
                inputs: of.iter().map(hash).collect(),
            };
            let output = Output::new(record, vec![entry("a", content)]);
            manifest.outputs.insert(name.to_owned(), output);
        };
        make(&mut manifest, "rig", &["handoff"], b"1");
        make(&mut manifest, "trajectory", &["handoff", "rig"], b"2");
        make(&mut manifest, "cloud", &["trajectory"], b"3");
        make(&mut manifest, "masks", &["handoff"], b"4");
        assert_eq!(manifest.outdated(), BTreeMap::new());
        // The same again is the same.
        make(&mut manifest, "rig", &["handoff"], b"1");
        assert_eq!(manifest.outdated(), BTreeMap::new());
        make(&mut manifest, "rig", &["handoff"], b"another");
        let expected = BTreeMap::from([("trajectory", "rig"), ("cloud", "trajectory")]);
        assert_eq!(manifest.outdated(), expected);
        make(&mut manifest, "trajectory", &["handoff", "rig"], b"5");
        assert_eq!(
            manifest.outdated(),
            BTreeMap::from([("cloud", "trajectory")])
        );
    }

    #[test]
    fn a_written_manifest_reads_back() {
        let manifest = manifest();
        let path = Path::new("scene.json");
        assert_eq!(
            Manifest::parse(&manifest.to_json(), path).unwrap(),
            manifest
        );
    }

    #[test]
    fn a_malformed_manifest_is_refused_with_its_cause() {
        let good = String::from_utf8(manifest().to_json()).unwrap();
        let check = |from: &str, to: &str, expected: &str| {
            assert!(good.contains(from), "{from}");
            let text = good.replacen(from, to, 1);
            let error = Manifest::parse(text.as_bytes(), Path::new("scene.json")).unwrap_err();
            let error = error.to_string();
            assert!(error.contains(expected), "{error}");
            assert!(error.ends_with(": scene.json"), "{error}");
        };
        check(
            "\"version\": 2",
            "\"version\": 3",
            "found paws-scene version 3, expected paws-scene version 1 or 2",
        );
        check("paws-scene", "paws-session", "found paws-session version 2");
        check(
            "\"outputs\"",
            "\"more\": 1, \"outputs\"",
            "unknown field `more`",
        );
        check(
            "\"rig\": {\n      \"stage\"",
            "\"../rig\": {\n      \"stage\"",
            "an output called \"../rig\"",
        );
        check(
            "\"b/c\"",
            "\"b/../../c\"",
            "a file \"b/../../c\" of output rig",
        );
        check("\"bytes\": 1", "\"bytes\": 2", "the manifest was edited");
        check("{", "", "found JSON where");
    }
}
