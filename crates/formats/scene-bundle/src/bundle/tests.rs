use std::collections::BTreeMap;
use std::io::Write;

use super::*;
use crate::manifest::{Record, RigRevision};
use crate::storage::memory::{Crash, Memory};
use crate::verify::{VerifyReport, verify};

pub(crate) fn provenance() -> Provenance {
    Provenance {
        session_id: "01890a5d-ac96-774b-bcce-b302099a8057".to_owned(),
        handoff_blake3: "ab".repeat(32),
        judgement: None,
        rig: RigRevision {
            name: "chest".to_owned(),
            revision: "B".to_owned(),
        },
        program: "paws-reconstruct".to_owned(),
        program_version: "0.1.0".to_owned(),
        started_civil_ns: 1_795_000_000_000_000_000,
        ended_civil_ns: None,
    }
}

pub(crate) fn record(version: u32) -> Record {
    Record {
        stage: "test".to_owned(),
        stage_version: version,
        settings: serde_json::json!({ "quality": "high" }),
        inputs: BTreeMap::from([("handoff".to_owned(), "ab".repeat(32))]),
    }
}

fn open(disk: &Memory) -> Result<Bundle, BundleError> {
    Bundle::open_on(Arc::new(disk.clone()), provenance(), None)
}

fn checked(disk: &Memory) -> VerifyReport {
    let scene = Scene::open_on(Arc::new(disk.clone())).expect("the bundle opens");
    verify(&scene, |_| {}).expect("the bundle can be listed")
}

/// An output of this content: a file written in parts with its start patched, one in a folder, two
/// in the listing.
fn make(bundle: &Bundle, name: &str, content: &str) -> Result<(), BundleError> {
    let draft = bundle.begin(name)?;
    let mut file = draft.create("table.bin")?;
    for part in ["????", content, content] {
        file.write_all(part.as_bytes())
            .map_err(doing("writing", "table.bin"))?;
    }
    file.overwrite_start(b"good")
        .map_err(doing("writing", "table.bin"))?;
    file.finish()?;
    draft.write("a/b/text.txt", content.as_bytes())?;
    for number in 0..2 {
        draft.write_listed(
            &format!("many/{number}.png"),
            format!("{number}{content}").as_bytes(),
        )?;
    }
    draft.commit(record(content.len() as u32)).map(|_| ())
}

fn table(scene: &Scene, name: &str) -> Option<String> {
    let reader = scene.output(name).ok()?;
    Some(String::from_utf8(reader.read("table.bin").unwrap()).unwrap())
}

#[test]
fn committed_outputs_can_be_read() {
    let disk = Memory::new();
    let bundle = open(&disk).unwrap();
    make(&bundle, "rig", "one").unwrap();
    let scene = bundle.scene();
    assert_eq!(table(&scene, "rig").unwrap(), "goodoneone");
    let reader = scene.output("rig").unwrap();
    assert_eq!(reader.read("a/b/text.txt").unwrap(), b"one");
    assert_eq!(reader.read("many/1.png").unwrap(), b"1one");
    let output = reader.output();
    assert!(output.is_made_by(&record(3)) && !output.is_made_by(&record(4)));
    let paths: Vec<&str> = output.files.iter().map(|f| f.path.as_str()).collect();
    assert_eq!(paths, ["a/b/text.txt", "files.b3", "table.bin"]);
    assert!(
        reader
            .read("many/2.png")
            .unwrap_err()
            .to_string()
            .contains("nothing names")
    );
    assert!(scene.output("depth").is_err());

    bundle.finish(5).unwrap();
    let manifest = Scene::open_on(Arc::new(disk.clone()))
        .unwrap()
        .manifest()
        .clone();
    assert_eq!(manifest.provenance.ended_civil_ns, Some(5));
    let found = checked(&disk);
    assert!(found.is_whole() && found.unnamed.is_empty());
    assert_eq!(found.outputs[0].files, 5);
}

#[test]
fn identical_content_has_the_same_path_whatever_preceded_it() {
    let (once, often) = (Memory::new(), Memory::new());
    make(&open(&once).unwrap(), "rig", "two").unwrap();
    let bundle = open(&often).unwrap();
    for content in ["two", "one", "two", "two"] {
        make(&bundle, "rig", content).unwrap();
    }
    assert_eq!(once.paths(), often.paths());
    let read =
        |disk: &Memory| storage::read_all(disk, layout::MANIFEST, layout::MANIFEST_LIMIT).unwrap();
    assert_eq!(read(&once), read(&often));
}

#[test]
fn a_damaged_output_is_detected_and_replaced() {
    let disk = Memory::new();
    let bundle = open(&disk).unwrap();
    make(&bundle, "rig", "one").unwrap();
    make(&bundle, "depth", "one").unwrap();
    let file = disk
        .paths()
        .into_iter()
        .find(|p| p.starts_with("depth") && p.ends_with("many/1.png"));
    disk.damage(&file.unwrap(), 0);
    let found = checked(&disk);
    assert!(!found.is_whole());
    assert_eq!(found.outputs[0].name, "depth");
    assert_eq!(found.outputs[0].files, 4);
    let [problem] = &found.outputs[0].problems[..] else {
        panic!("one problem expected: {found:?}");
    };
    assert!(
        problem.contains("found content with the hash") && problem.ends_with("many/1.png"),
        "{problem}"
    );
    assert!(found.outputs[1].problems.is_empty());
    assert!(
        bundle
            .scene()
            .output("depth")
            .unwrap()
            .read("many/1.png")
            .is_err()
    );

    make(&bundle, "depth", "one").unwrap();
    assert!(checked(&disk).is_whole());
}

#[test]
fn invalid_calls_are_refused() {
    let disk = Memory::new();
    let bundle = open(&disk).unwrap();
    let message = |error: BundleError| error.to_string();
    assert!(message(bundle.begin("../x").err().unwrap()).contains("an output called \"../x\""));
    let draft = bundle.begin("rig").unwrap();
    assert!(message(bundle.begin("rig").err().unwrap()).contains("a second draft of output rig"));
    for path in ["../x", "files.b3", "a//b"] {
        assert!(message(draft.create(path).err().unwrap()).contains("a file called"));
    }
    draft.write("a", b"1").unwrap();
    assert!(message(draft.write("a", b"2").err().unwrap()).contains("each path once"));
    let unfinished = draft.create("b").unwrap();
    assert!(message(draft.commit(record(1)).err().unwrap()).contains("b not finished"));
    drop(unfinished);
    let draft = bundle.begin("rig").unwrap();
    let mut bad = record(1);
    bad.inputs.insert("x".to_owned(), "12".to_owned());
    assert!(message(draft.commit(bad).err().unwrap()).contains("\"12\" as the hash of input x"));
    assert_eq!(disk.paths(), ["scene.json"], "dropped drafts leave nothing");
}

/// The work of two runs; the second one replaces one output, adds one and leaves one alone.
fn work(disk: &Memory) -> Result<(), BundleError> {
    let bundle = open(disk)?;
    make(&bundle, "rig", "one")?;
    make(&bundle, "depth", "one")?;
    bundle.finish(1)?;
    let bundle = open(disk)?;
    make(&bundle, "rig", "second")?;
    make(&bundle, "cloud", "one")?;
    bundle.finish(2)
}

/// Outputs that may be visible after a cut: each line one committed state.
const STATES: [[Option<&str>; 3]; 5] = [
    // rig, depth, cloud
    [None, None, None],
    [Some("goodoneone"), None, None],
    [Some("goodoneone"), Some("goodoneone"), None],
    [Some("goodsecondsecond"), Some("goodoneone"), None],
    [
        Some("goodsecondsecond"),
        Some("goodoneone"),
        Some("goodoneone"),
    ],
];

#[test]
fn a_cut_at_any_step_leaves_the_committed_state() {
    let whole = Memory::new();
    work(&whole).unwrap();
    let steps = whole.steps();
    assert!(steps > 100, "{steps}");
    let mut seen = BTreeSet::new();
    for cut in 0..=steps {
        let disk = Memory::new();
        disk.cut_at(cut);
        assert_eq!(work(&disk).is_ok(), cut == steps);
        let mut last = 0;
        for crash in [
            Crash::Forgotten,
            Crash::LastNameFirst,
            Crash::NamesFirst,
            Crash::Killed,
        ] {
            let left = disk.crash(crash);
            let Ok(scene) = Scene::open_on(Arc::new(left.clone())) else {
                // Before the first manifest there is no bundle yet; afterwards there always is one.
                assert!(seen.is_empty(), "step {cut} {crash:?}");
                continue;
            };
            let found = verify(&scene, |_| {}).unwrap();
            assert!(found.is_whole(), "step {cut} {crash:?}: {found:?}");
            let state = ["rig", "depth", "cloud"].map(|name| table(&scene, name));
            let state = STATES
                .iter()
                .position(|s| s.map(|t| t.map(str::to_owned)) == state);
            let state =
                state.unwrap_or_else(|| panic!("step {cut} {crash:?}: a state that never was"));
            // Durable state never goes back, and the state of a live system is never behind it.
            assert!(state >= last, "step {cut} {crash:?}");
            last = state;
            seen.insert(state);

            // The next writer succeeds, and nothing is left of the one before.
            work(&left).unwrap_or_else(|e| panic!("step {cut} {crash:?}: {e}"));
            let found = checked(&left);
            assert!(
                found.is_whole() && found.unnamed.is_empty(),
                "step {cut} {crash:?}: {found:?}"
            );
            assert_eq!(left.paths(), whole.paths(), "step {cut} {crash:?}");
        }
    }
    assert_eq!(seen.len(), STATES.len(), "every state is seen: {seen:?}");
}

#[test]
fn one_writer_at_a_time_and_one_source_per_bundle() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("new/walk.scene");
    let bundle = Bundle::create_or_open(&path, provenance()).unwrap();
    make(&bundle, "rig", "one").unwrap();
    let second = Bundle::create_or_open(&path, provenance()).err().unwrap();
    assert!(matches!(second, BundleError::Locked { .. }), "{second}");
    // Reading needs no lock; the manifest can be named itself.
    let scene = Scene::open(&path.join("scene.json")).unwrap();
    assert_eq!(table(&scene, "rig").unwrap(), "goodoneone");
    // An output of no files.
    bundle.begin("masks").unwrap().commit(record(1)).unwrap();
    drop(bundle);

    let other = Provenance {
        handoff_blake3: "cd".repeat(32),
        ..provenance()
    };
    let error = Bundle::create_or_open(&path, other).err().unwrap();
    assert!(matches!(error, BundleError::OtherSource { .. }), "{error}");

    let stale = path.join("rig.0123456789abcdef/deep");
    std::fs::create_dir_all(&stale).unwrap();
    std::fs::write(stale.join("file"), "left over").unwrap();
    std::fs::create_dir(path.join(".draft-depth")).unwrap();
    std::fs::write(path.join("notes.txt"), "mine").unwrap();
    // Known files that are not part of the bundle.
    for beside in [
        layout::STAGE_TIMINGS,
        layout::PAGE,
        layout::CAMERA_IMAGES,
        layout::FILM,
    ] {
        std::fs::write(path.join(beside), "").unwrap();
    }
    let found = verify(&Scene::open(&path).unwrap(), |_| {}).unwrap();
    assert_eq!(
        found.unnamed,
        [".draft-depth", "notes.txt", "rig.0123456789abcdef"]
    );
    let bundle = Bundle::create_or_open(&path, provenance()).unwrap();
    assert!(bundle.scene().has("rig"));
    let found = verify(&bundle.scene(), |_| {}).unwrap();
    assert!(found.is_whole());
    assert_eq!(found.unnamed, ["notes.txt"], "foreign files are kept");
}

#[test]
fn a_folder_of_something_else_is_left_alone() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("thesis.tex"), "years of work").unwrap();
    let error = Bundle::create_or_open(folder.path(), provenance())
        .err()
        .unwrap();
    assert!(
        error.to_string().contains("holds \"thesis.tex\""),
        "{error}"
    );
    std::fs::write(folder.path().join("scene.json"), "{}").unwrap();
    let error = Bundle::create_or_open(folder.path(), provenance())
        .err()
        .unwrap();
    assert!(matches!(error, BundleError::NotABundle { .. }), "{error}");
    assert_eq!(
        std::fs::read(folder.path().join("scene.json")).unwrap(),
        b"{}"
    );
    let missing = Scene::open(&folder.path().join("nowhere")).err().unwrap();
    assert!(
        missing.to_string().contains("found no scene.json"),
        "{missing}"
    );
}
