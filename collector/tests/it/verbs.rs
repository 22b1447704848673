//! The commands of a library: list, show, recover, prune, rebuild, index, hand off.

use std::fs;
use std::path::{Path, PathBuf};

use collector::commands::validate::Options;
use collector::commands::{
    handoff, import, index, list, prune, rebuild, recover, report, show, validate,
};
use collector::condition::Condition;
use collector::library::Library;
use collector::target::Target;
use console_output::Outcome;
use session_archive::handoff::{Check, HandOff, HandOffError, Verdict};
use session_archive::index::Index;
use session_archive::storage::DiskStorage;
use session_archive::text::{is_hidden, is_plain};

use crate::support::{ID, Session, capture, tree};

/// A library with the sessions that `sessions` writes.
struct Desk {
    folder: tempfile::TempDir,
}

impl Desk {
    fn with(sessions: &[&Session]) -> Self {
        let desk = Self {
            folder: tempfile::tempdir().unwrap(),
        };
        for (i, session) in sessions.iter().enumerate() {
            let source = desk.folder.path().join(format!("source-{i}"));
            session.write(&source);
            desk.import(&source);
        }
        desk
    }

    fn import(&self, source: &Path) -> (Outcome, String) {
        let sources = [source.to_owned()];
        let (outcome, text) = capture(|console| import::run(&sources, &self.root(), console));
        (outcome.unwrap(), text)
    }

    fn root(&self) -> PathBuf {
        self.folder.path().join("library")
    }

    fn session(&self, key: &str) -> PathBuf {
        self.root().join("sessions").join(key)
    }

    fn target(&self, text: &str) -> Target {
        Target::find(text, Some(&self.root())).unwrap()
    }
}

/// A session that is cut in its last chunk, or damaged in the middle.
fn spoilt(folder: &Path, cut: bool) {
    let mut session = Session::with_units(3.0, 2000);
    session.closed = !cut;
    session.write(folder);
    let segment = folder.join("segments/000000.mcap");
    let mut bytes = fs::read(&segment).unwrap();
    if cut {
        bytes.truncate(bytes.len() - 100);
    } else {
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
    }
    fs::write(&segment, bytes).unwrap();
}

#[test]
fn catalogue_can_be_rebuilt_from_the_folders() {
    let mut other = Session::good(1.0);
    other.spec.session_id = "0192aa00-0000-7000-8000-000000000002".to_owned();
    other.spec.started_civil.0 -= 5;
    let desk = Desk::with(&[&Session::good(1.0), &other]);
    let targets = [desk.target(ID)];
    capture(|console| validate::run(&targets, &Options::default(), console))
        .0
        .unwrap();
    let rows = Library::open(&desk.root()).unwrap().rows().unwrap();
    assert_eq!(rows.len(), 2);
    assert_eq!(rows[0].session_id, other.spec.session_id);
    assert_eq!(rows[1].verdict, Some(Verdict::Pass));

    // Synthetic rows, a missing row, no catalogue: the folders decide.
    let catalogue = desk.root().join("catalogue.sqlite");
    let rebuilt = || {
        let (outcome, text) = capture(|console| rebuild::run(&desk.root(), console));
        assert_eq!(outcome.unwrap(), Outcome::Fine, "{text}");
        Library::open(&desk.root()).unwrap().rows().unwrap()
    };
    assert_eq!(rebuilt(), rows);
    for suffix in ["", "-wal", "-shm"] {
        let _ = fs::remove_file(format!("{}{suffix}", catalogue.display()));
    }
    assert_eq!(Library::open(&desk.root()).unwrap().rows().unwrap(), rows);
    assert_eq!(rebuilt(), rows);
    fs::write(&catalogue, b"not a database".repeat(100)).unwrap();
    assert_eq!(Library::open(&desk.root()).unwrap().rows().unwrap(), rows);

    // A session that was removed manually is no longer listed.
    fs::remove_dir_all(desk.session(ID)).unwrap();
    assert_eq!(
        Library::open(&desk.root()).unwrap().rows().unwrap().len(),
        1
    );
    // A folder that is not a session is reported.
    fs::create_dir(desk.root().join("sessions/junk")).unwrap();
    let (outcome, text) = capture(|console| rebuild::run(&desk.root(), console));
    assert_eq!(outcome.unwrap(), Outcome::Failed);
    assert!(
        text.starts_with("junk: not listed: no session here"),
        "{text}"
    );
}

/// Clears the screen, reverses the text direction, and forges a line.
const HOSTILE: &str = "walk\u{1b}[2J\u{9b}2J\u{202e}\nverdict    PASS";

#[test]
fn session_texts_are_escaped_on_the_terminal() {
    let mut session = Session::good(1.0);
    session.spec.name = HOSTILE.to_owned();
    session.spec.software = HOSTILE.to_owned();
    for camera in &mut session.spec.cameras {
        (camera.source, camera.encoder) = (HOSTILE.to_owned(), HOSTILE.to_owned());
    }
    for imu in &mut session.spec.imus {
        imu.source = HOSTILE.to_owned();
    }
    for (_, event) in &mut session.events {
        (event.source, event.text) = (HOSTILE.to_owned(), HOSTILE.to_owned());
    }
    // A recorder accepted this name: the session is imported, and displayed safely.
    let desk = Desk::with(&[&session]);
    let target = desk.target(ID);
    let check = |what: &str, text: &str| {
        assert!(text.contains("\\u001b[2J"), "{what}: {text}");
        assert!(text.lines().all(is_plain), "{what}: {text:?}");
        let forged = text.lines().any(|l| l == "verdict    PASS");
        assert!(!forged, "{what}: {text}");
    };
    let (outcome, text) = capture(|console| list::run(&desk.root(), console));
    assert_eq!(outcome.unwrap(), Outcome::Fine);
    assert_eq!(text.lines().count(), 2, "{text}");
    check("list", &text);
    let (_, text) = capture(|console| show::run(&target, console));
    check("show", &text);
    let html = desk.folder.path().join("report.html");
    let (outcome, _) =
        capture(|console| report::run(&target, &Options::default(), Some(&html), console));
    assert!(outcome.is_ok());
    let page = fs::read_to_string(html).unwrap();
    let bad = page.chars().find(|c| is_hidden(*c) && *c != '\n');
    assert_eq!(bad, None);
}

#[test]
fn list_and_show_print_the_essentials() {
    let mut session = Session::good(4.0);
    session.drop_frames(0, 120, 122, true);
    let desk = Desk::with(&[&session]);
    let shown = || {
        let (outcome, text) = capture(|console| show::run(&desk.target(ID), console));
        outcome.unwrap();
        text
    };
    assert!(
        shown().contains("none yet; `paws validate` gives one"),
        "{}",
        shown()
    );
    let targets = [desk.target(ID)];
    let (outcome, text) = capture(|console| validate::run(&targets, &Options::default(), console));
    assert_eq!(outcome.unwrap(), Outcome::Failed, "{text}");
    let text = shown();
    for part in [
        "2026-09-21T",
        "4.0 s",
        "left_shoulder: 128x48 grey h264, 30 Hz, measured 30.00 Hz",
        "feet/imu: 200 Hz",
        "FAIL",
        "3 samples of 1101",
        "left_shoulder: 3 samples in 1 gap, encoder overload",
        "mark by control  the \"stairs\", up",
        "source-0",
    ] {
        assert!(text.contains(part), "{part:?} is not in\n{text}");
    }
    assert!(text.lines().count() <= 40, "more than a screen:\n{text}");
    let (_, text) = capture(|console| list::run(&desk.root(), console));
    let row = text.lines().nth(1).unwrap();
    for part in [
        ID,
        "ok",
        "FAIL",
        "left_shoulder,right_shoulder,feet",
        "walk",
        "4.0 s",
    ] {
        assert!(row.contains(part), "{part:?} is not in {row}");
    }
}

#[test]
fn recovery_writes_an_undamaged_copy_and_keeps_the_original() {
    for cut in [true, false] {
        let desk = Desk::with(&[]);
        let source = desk.folder.path().join("source");
        spoilt(&source, cut);
        let (outcome, text) = desk.import(&source);
        assert_eq!(outcome, Outcome::Loss);
        assert!(text.contains("`paws recover"), "{text}");
        let original = tree(&desk.session(ID));

        let (outcome, text) = capture(|console| recover::run(&desk.target(ID), None, console));
        let expected = if cut { Outcome::Fine } else { Outcome::Loss };
        assert_eq!(outcome.unwrap(), expected, "{text}");
        assert_eq!(tree(&desk.session(ID)), original);
        let rows = Library::open(&desk.root()).unwrap().rows().unwrap();
        assert_eq!(rows.len(), 2);
        assert_eq!(rows[1].key, format!("{ID}.recovered"));
        assert_eq!(rows[1].condition, Condition::Recovered);
        assert_eq!(tree(&desk.root().join(".incoming")).len(), 0);
        // A prefix selects the copy, the whole identifier the original.
        assert_eq!(desk.target(&ID[..8]).name(), rows[1].key);
        assert_eq!(desk.target(ID).name(), ID);

        let again = capture(|console| recover::run(&desk.target(ID), None, console)).0;
        let error = again.unwrap_err().to_string();
        assert!(error.contains("has been recovered before"), "{error}");
        let copy = desk.target(&rows[1].key);
        let (outcome, text) = capture(|console| recover::run(&copy, None, console));
        assert_eq!(outcome.unwrap(), Outcome::Fine);
        assert!(text.contains("undamaged, nothing to recover"), "{text}");
    }
}

#[test]
fn recovery_outside_a_library_writes_beside_the_original() {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("walk");
    spoilt(&source, true);
    let target = Target::find(source.to_str().unwrap(), None).unwrap();
    capture(|console| recover::run(&target, None, console))
        .0
        .unwrap();
    assert!(folder.path().join("walk.recovered/session.json").is_file());
    let error = capture(|console| recover::run(&target, None, console))
        .0
        .unwrap_err();
    assert!(
        error.to_string().contains("new or an empty folder"),
        "{error}"
    );
}

#[test]
fn prune_removes_only_derived_files() {
    let desk = Desk::with(&[&Session::good(1.0)]);
    let recorded = tree(&desk.session(ID));
    let targets = [desk.target(ID)];
    capture(|console| validate::run(&targets, &Options::default(), console))
        .0
        .unwrap();
    capture(|console| index::run(&targets, console)).0.unwrap();
    fs::create_dir_all(desk.root().join(".incoming/stopped/segments")).unwrap();
    fs::write(
        desk.root().join(".incoming/stopped/segments/000000.mcap"),
        b"x",
    )
    .unwrap();
    fs::write(desk.root().join(".incoming/stopped.journal"), b"{}").unwrap();
    // An unreadable folder that sorts before the session.
    fs::create_dir(desk.root().join("sessions/0-junk")).unwrap();
    assert_eq!(tree(&desk.session(ID)).len(), recorded.len() + 2);
    let (outcome, text) = capture(|console| prune::derived(&desk.root(), console));
    assert_eq!(outcome.unwrap(), Outcome::Fine);
    assert!(
        text.starts_with("removed 2 derived files and 2 left-overs"),
        "{text}"
    );
    assert_eq!(tree(&desk.session(ID)), recorded);
    assert_eq!(tree(&desk.root().join(".incoming")).len(), 0);
    assert_eq!(
        Library::open(&desk.root()).unwrap().rows().unwrap()[0].verdict,
        None
    );

    let refused = capture(|console| prune::session(&desk.root(), ID, false, console)).0;
    let error = refused.unwrap_err().to_string();
    assert!(error.contains("repeat it with --yes"), "{error}");
    assert_eq!(tree(&desk.session(ID)), recorded);
    capture(|console| prune::session(&desk.root(), ID, true, console))
        .0
        .unwrap();
    assert!(!desk.session(ID).exists());
    assert!(
        Library::open(&desk.root())
            .unwrap()
            .rows()
            .unwrap()
            .is_empty()
    );
    // The source is still there, and can be imported again.
    let (_, text) = desk.import(&desk.folder.path().join("source-0"));
    assert!(text.contains(": imported, 1.0 s"), "{text}");
}

#[test]
fn a_hand_off_is_sealed_renewed_and_withdrawn() {
    let desk = Desk::with(&[&Session::good(2.0)]);
    let hand_over = || capture(|console| handoff::run(&desk.target(ID), None, console));
    let (outcome, text) = hand_over();
    assert_eq!(outcome.unwrap(), Outcome::Fine);
    let path = desk
        .session(ID)
        .canonicalize()
        .unwrap()
        .join("handoff.json");
    assert_eq!(text.trim_end(), path.to_str().unwrap());
    let storage = DiskStorage::new(desk.session(ID));
    let opened = || HandOff::open(&storage, Check::Content, |_| {});
    let sealed = opened().unwrap();
    let paths: Vec<&str> = sealed.files.iter().map(|f| f.path.as_str()).collect();
    assert_eq!(
        paths,
        ["session.json", "rig/rig.toml", "segments/000000.mcap"]
    );
    assert_eq!(sealed.derived[0].path, "index.bin");
    assert_eq!(sealed.verdict, Verdict::Pass);
    // A validation does not affect the seal.
    let targets = [desk.target(ID)];
    capture(|console| validate::run(&targets, &Options::default(), console))
        .0
        .unwrap();
    opened().unwrap();

    // A changed session is detected, validated again and not handed over.
    let segment = desk.session(ID).join("segments/000000.mcap");
    let mut bytes = fs::read(&segment).unwrap();
    bytes.truncate(bytes.len() / 2);
    fs::write(&segment, bytes).unwrap();
    assert!(matches!(opened(), Err(HandOffError::Changed { .. })));
    let (outcome, text) = hand_over();
    assert_eq!(outcome.unwrap(), Outcome::Failed);
    assert!(text.contains("not handed over"), "{text}");
    assert!(!path.exists());
}

/// A bit flipped after the validation, and an edited rig file: lengths show neither.
#[test]
fn session_changed_since_validation_is_not_sealed() {
    let change = |path: &Path| {
        let mut bytes = fs::read(path).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        fs::write(path, bytes).unwrap();
    };
    for file in ["segments/000000.mcap", "rig/rig.toml"] {
        let desk = Desk::with(&[&Session::good(2.0)]);
        let targets = [desk.target(ID)];
        let validate = || {
            let options = Options::default();
            capture(|console| validate::run(&targets, &options, console))
                .0
                .unwrap()
        };
        let listed = || {
            Library::open(&desk.root())
                .unwrap()
                .rows()
                .unwrap()
                .remove(0)
        };
        assert_eq!(validate(), Outcome::Fine);
        change(&desk.session(ID).join(file));
        let (outcome, text) = capture(|console| handoff::run(&targets[0], None, console));
        assert_eq!(outcome.unwrap(), Outcome::Failed, "{file}: {text}");
        assert!(!desk.session(ID).join("handoff.json").exists());
        // The import's report is older.
        assert_eq!(listed().condition, Condition::Damaged);
        let (_, text) = capture(|console| show::run(&targets[0], console));
        assert!(text.contains("condition  damaged"), "{text}");
        // An index of the damaged session is replaced after the repair.
        capture(|console| index::run(&targets, console)).0.unwrap();
        change(&desk.session(ID).join(file));
        assert_eq!(validate(), Outcome::Fine);
        let (outcome, text) = capture(|console| handoff::run(&targets[0], None, console));
        assert_eq!(outcome.unwrap(), Outcome::Fine, "{text}");
        let reader = session_access::open(&desk.session(ID)).unwrap();
        assert_eq!(Index::read(&reader).unwrap().damaged, 0);
        assert_eq!(listed().condition, Condition::Ok);
    }
}

/// Custom limits are for inspection; hand-offs are validated by the default limits.
#[test]
fn custom_limits_do_not_apply_to_a_hand_off() {
    let desk = Desk::with(&[]);
    let source = desk.folder.path().join("source");
    spoilt(&source, false);
    desk.import(&source);
    let targets = [desk.target(ID)];
    let mut options = Options::default();
    for limit in [
        "session.damage=99,99",
        "camera.dropped=1,1",
        "imu.dropped=1,1",
    ] {
        options.limits.set(limit).unwrap();
    }
    for metric in ["camera.longest_gap", "imu.longest_gap"] {
        options
            .limits
            .set(&format!("{metric}=never,never"))
            .unwrap();
    }
    let (outcome, text) = capture(|console| validate::run(&targets, &options, console));
    assert_ne!(outcome.unwrap(), Outcome::Failed, "{text}");
    let path = desk.session(ID).join("validation.json");
    let moved = fs::read(&path).unwrap();
    // A report shows the validation with them, and does not change it.
    let default = Options::default();
    let (outcome, _) = capture(|console| report::run(&targets[0], &default, None, console));
    assert_ne!(outcome.unwrap(), Outcome::Failed);
    assert_eq!(fs::read(&path).unwrap(), moved);
    let (outcome, text) = capture(|console| handoff::run(&targets[0], None, console));
    assert_eq!(outcome.unwrap(), Outcome::Failed, "{text}");
}

/// The recorder's disk is only read.
#[test]
fn derived_files_are_written_only_in_libraries() {
    let folder = tempfile::tempdir().unwrap();
    Session::good(1.0).write(folder.path());
    let before = tree(folder.path());
    let target = Target::find(folder.path().to_str().unwrap(), None).unwrap();
    let targets = [target.clone()];
    let default = Options::default();
    let results = [
        capture(|console| index::run(&targets, console)).0,
        capture(|console| handoff::run(&target, None, console)).0,
        capture(|console| report::run(&target, &default, None, console)).0,
    ];
    for result in results {
        let error = result.unwrap_err().to_string();
        assert!(error.contains("this one is in none"), "{error}");
    }
    assert_eq!(tree(folder.path()), before);
}

#[test]
fn index_is_built_once_and_again_when_outdated() {
    let desk = Desk::with(&[&Session::good(1.0)]);
    let index = || capture(|console| index::run(&[desk.target(ID)], console)).1;
    assert!(
        index().ends_with("3 cameras, 31 frame sets, indexed\n"),
        "{}",
        index()
    );
    assert!(index().ends_with("indexed already\n"));
    let path = desk.session(ID).join("index.bin");
    let good = fs::read(&path).unwrap();
    fs::write(&path, &good[..good.len() - 1]).unwrap();
    assert!(index().ends_with("indexed\n"));
    assert_eq!(fs::read(&path).unwrap(), good);
}
