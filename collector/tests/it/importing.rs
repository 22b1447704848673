//! Import: complete, repeated, stopped at every step, damaged, changed.

use std::fs;
use std::io;
use std::path::Path;
use std::sync::Mutex;

use collector::condition::Condition;
use collector::import::{Hook, ImportError, ImportRecord, ImportResult, Step, import, no_hook};
use collector::library::Library;
use console_output::{Clock, Progress};

use crate::support::{ID, Session, tree};

fn import_with(root: &Path, source: &Path, hook: Hook<'_>) -> Result<ImportResult, ImportError> {
    let mut library = Library::create(root).unwrap();
    import(
        &mut library,
        source,
        Clock::STILL,
        &Progress::hidden(),
        hook,
    )
}

fn import_plainly(root: &Path, source: &Path) -> Result<ImportResult, ImportError> {
    import_with(root, source, &no_hook)
}

/// Checks a listed session's folder: the source byte for byte, and the record.
fn assert_is_copy(root: &Path, source: &Path) {
    let mut copy = tree(&root.join("sessions").join(ID));
    let record = copy.remove("import.json").expect("it has a record");
    assert!(!record.is_empty());
    assert_eq!(copy, tree(source));
}

#[test]
fn session_is_copied_verified_and_listed() {
    let folder = tempfile::tempdir().unwrap();
    let (root, source) = (folder.path().join("library"), folder.path().join("walk-1"));
    Session::good(2.0).write(&source);
    fs::write(source.join("notes.txt"), b"rain").unwrap();
    let before = tree(&source);
    // Files derived by another host are not part of the recording.
    fs::write(source.join("index.bin"), b"old").unwrap();

    let imported = import_plainly(&root, &source).unwrap();
    assert_eq!(
        (imported.key.as_str(), imported.condition),
        (ID, Condition::Ok)
    );
    assert_eq!(
        imported.copied,
        before.values().map(|v| v.len() as u64).sum::<u64>()
    );
    assert!(imported.report.is_sound() && !imported.already_imported);
    fs::remove_file(source.join("index.bin")).unwrap();
    assert_is_copy(&root, &source);
    assert_eq!(tree(&source), before);

    let record = ImportRecord::read(&root.join("sessions").join(ID)).unwrap();
    for file in &record.files {
        let hash = blake3::hash(&before[&file.path]).to_hex().to_string();
        assert_eq!(file.blake3, hash, "{}", file.path);
    }
    assert_eq!(record.files.len(), before.len());

    let library = Library::open(&root).unwrap();
    let rows = library.rows().unwrap();
    assert_eq!(rows.len(), 1);
    assert_eq!(rows[0].cameras, "left_shoulder,right_shoulder,feet");
    assert_eq!(rows[0].condition, Condition::Ok);
    assert_eq!(rows[0].samples, 61 + 60 + 30 + 400);
    for text in [ID, &ID[..6], "walk", "walk-1"] {
        assert_eq!(library.find(text).unwrap(), ID, "{text}");
    }
    let error = library.find("run").unwrap_err().to_string();
    assert!(error.contains("none of the 1"), "{error}");
    assert_eq!(tree(&root.join(".incoming")).len(), 0);
}

#[test]
fn repeated_import_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let (root, source) = (folder.path().join("library"), folder.path().join("a"));
    Session::good(1.0).write(&source);
    import_plainly(&root, &source).unwrap();
    let sessions = tree(&root.join("sessions"));
    let again = import_plainly(&root, &source).unwrap();
    assert!(again.already_imported);
    assert_eq!((again.copied, again.condition), (0, Condition::Ok));
    assert_eq!(tree(&root.join("sessions")), sessions);
}

#[test]
fn differing_session_is_rejected_and_nothing_is_overwritten() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("library");
    let source = folder.path().join("first");
    Session::good(1.0).write(&source);
    import_plainly(&root, &source).unwrap();
    let sessions = tree(&root.join("sessions"));
    let check = |name: &str, what: &str, change: &dyn Fn(&Path)| {
        let other = folder.path().join(name);
        Session::good(1.0).write(&other);
        change(&other);
        match import_plainly(&root, &other) {
            Err(e @ ImportError::Differs { .. }) => {
                assert!(e.to_string().contains(what), "{e}");
            }
            other => panic!("{other:?}"),
        }
        assert_eq!(tree(&root.join("sessions")), sessions);
    };
    check("longer", " bytes, in the library ", &|other| {
        fs::remove_dir_all(other).unwrap();
        Session::good(2.0).write(other);
    });
    check("more", "extra.txt is not in the library", &|other| {
        fs::write(other.join("extra.txt"), b"x").unwrap();
    });
    check("less", "rig/rig.toml is only in the library", &|other| {
        fs::remove_file(other.join("rig/rig.toml")).unwrap();
    });
    check("changed", "session.json has another content", &|other| {
        fs::remove_dir_all(other).unwrap();
        let mut session = Session::good(1.0);
        session.spec.name = "talk".to_owned();
        session.write(other);
        // The name is also in the segment's header, with the same length.
    });
}

#[test]
fn import_stopped_at_any_step_is_atomic_and_resumes() {
    let folder = tempfile::tempdir().unwrap();
    let source = folder.path().join("source");
    Session::with_units(1.0, 40_000).write(&source);
    let steps = Mutex::new(Vec::new());
    import_with(&folder.path().join("whole"), &source, &|step| {
        steps.lock().unwrap().push(step.clone());
        Ok(())
    })
    .unwrap();
    let steps = steps.into_inner().unwrap();
    let segment = || "segments/000000.mcap".to_owned();
    for step in [
        Step::Begin,
        Step::Write(segment()),
        Step::Sync(segment()),
        Step::Publish,
    ] {
        assert!(steps.contains(&step), "{step:?} of {steps:?}");
    }
    assert!(
        steps
            .iter()
            .filter(|s| **s == Step::Write(segment()))
            .count()
            > 2
    );

    let mut resumed = 0;
    for stop_at in 0..steps.len() {
        let root = folder.path().join(format!("library-{stop_at}"));
        let seen = Mutex::new(0);
        let killed = import_with(&root, &source, &|_| {
            let mut seen = seen.lock().unwrap();
            *seen += 1;
            if *seen > stop_at {
                return Err(io::Error::other("killed"));
            }
            Ok(())
        });
        assert!(killed.is_err(), "step {stop_at}");
        let mut library = Library::open(&root).unwrap();
        let rows = library.rows().unwrap();
        if rows.is_empty() {
            assert_eq!(tree(&root.join("sessions")).len(), 0, "step {stop_at}");
        } else {
            assert_is_copy(&root, &source);
        }
        let (_, failed) = library.rebuild().unwrap();
        assert!(failed.is_empty());
        drop(library);

        let again = import_plainly(&root, &source).unwrap();
        assert_eq!(again.already_imported, !rows.is_empty(), "step {stop_at}");
        resumed += u64::from(again.resumed > 0);
        assert_is_copy(&root, &source);
        assert_eq!(Library::open(&root).unwrap().rows().unwrap().len(), 1);
        assert_eq!(tree(&root.join(".incoming")).len(), 0, "step {stop_at}");
    }
    assert!(resumed > 0, "no import went on from an earlier one");
}

#[test]
fn remains_of_an_interrupted_import_are_verified() {
    let folder = tempfile::tempdir().unwrap();
    let (root, source) = (folder.path().join("library"), folder.path().join("source"));
    Session::with_units(1.0, 20_000).write(&source);
    let stop = |step: &Step| match step {
        Step::SyncFolders => Err(io::Error::other("killed")),
        _ => Ok(()),
    };
    import_with(&root, &source, &stop).unwrap_err();
    let incoming = root.join(".incoming").join(ID);
    // A byte of the copy is wrong, the journal has a torn line, and there is an unknown file.
    let segment = incoming.join("segments/000000.mcap");
    let mut bytes = fs::read(&segment).unwrap();
    bytes[5000] ^= 1;
    fs::write(&segment, bytes).unwrap();
    let journal = root.join(format!(".incoming/{ID}.journal"));
    let mut lines = fs::read(&journal).unwrap();
    lines.extend(b"{\"path\": \"rig/ri");
    fs::write(&journal, lines).unwrap();
    fs::write(incoming.join("segments/000009.mcap"), b"?").unwrap();

    let imported = import_plainly(&root, &source).unwrap();
    assert!(imported.resumed > 0 && imported.copied > 0);
    assert_eq!(imported.condition, Condition::Ok);
    assert_is_copy(&root, &source);
}

#[test]
fn damaged_and_unclosed_sessions_are_imported_as_such() {
    let folder = tempfile::tempdir().unwrap();
    let check = |name: &str, expected: Condition, spoil: &dyn Fn(&Path)| {
        let root = folder.path().join(format!("library-{name}"));
        let source = folder.path().join(name);
        Session::with_units(2.0, 2000).write(&source);
        spoil(&source);
        let imported = import_plainly(&root, &source).unwrap();
        assert_eq!(imported.condition, expected, "{:?}", imported.report);
        assert_is_copy(&root, &source);
        let row = &Library::open(&root).unwrap().rows().unwrap()[0];
        assert_eq!(row.condition, expected);
    };
    let segment = |source: &Path| source.join("segments/000000.mcap");
    check("flipped", Condition::Damaged, &|source| {
        let mut bytes = fs::read(segment(source)).unwrap();
        let middle = bytes.len() / 2;
        bytes[middle] ^= 1;
        fs::write(segment(source), bytes).unwrap();
    });
    check("no manifest", Condition::Damaged, &|source| {
        fs::remove_file(source.join("session.json")).unwrap();
    });
    check("cut", Condition::Unclosed, &|source| {
        fs::remove_dir_all(source).unwrap();
        let mut session = Session::with_units(2.0, 2000);
        session.closed = false;
        session.write(source);
        let file = fs::OpenOptions::new()
            .write(true)
            .open(segment(source))
            .unwrap();
        let length = file.metadata().unwrap().len();
        file.set_len(length - 100).unwrap();
    });
}

#[test]
fn session_still_being_recorded_is_not_listed() {
    let folder = tempfile::tempdir().unwrap();
    let (root, source) = (folder.path().join("library"), folder.path().join("source"));
    Session::with_units(1.0, 20_000).write(&source);
    let grow = |step: &Step| {
        if *step == Step::Sync("segments/000000.mcap".to_owned()) {
            fs::write(source.join("segments/000001.mcap"), b"more")?;
        }
        Ok(())
    };
    match import_with(&root, &source, &grow) {
        Err(ImportError::Changed { what, .. }) => assert_eq!(what, "segments/000001.mcap"),
        other => panic!("{other:?}"),
    }
    assert!(Library::open(&root).unwrap().rows().unwrap().is_empty());
    fs::remove_file(source.join("segments/000001.mcap")).unwrap();
    assert!(import_plainly(&root, &source).unwrap().resumed > 0);
}

#[test]
fn identifier_that_is_a_path_is_rejected() {
    let folder = tempfile::tempdir().unwrap();
    let (root, source) = (folder.path().join("library"), folder.path().join("source"));
    let mut session = Session::good(1.0);
    session.spec.session_id = "../../escaped".to_owned();
    session.write(&source);
    match import_plainly(&root, &source) {
        Err(ImportError::Identifier { id, .. }) => assert_eq!(id, "../../escaped"),
        other => panic!("{other:?}"),
    }
}
