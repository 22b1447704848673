//! Copies of one session in different condition, in either order: the better one is published, and
//! none is lost.

use std::fs;
use std::io;
use std::path::Path;
use std::sync::Arc;

use collector::condition::Condition;
use collector::import::{Hook, ImportError, ImportResult, Step, import, no_hook};
use collector::library::Library;
use console_output::{Clock, Progress};
use session_archive::reader::SessionReader;
use session_archive::recover::{close_cut_off, recover};
use session_archive::storage::DiskStorage;

use crate::support::{ID, Session, tree};

fn import_with(root: &Path, source: &Path, hook: Hook<'_>) -> Result<ImportResult, ImportError> {
    let mut library = Library::create(root).unwrap();
    let _lock = library.lock().unwrap();
    let hidden = Progress::hidden();
    import(&mut library, source, Clock::STILL, &hidden, hook)
}

fn rows(root: &Path) -> Vec<(String, Condition)> {
    let rows = Library::open(root).unwrap().rows().unwrap();
    let mut rows: Vec<_> = rows.into_iter().map(|r| (r.key, r.condition)).collect();
    rows.sort_by(|a, b| a.0.cmp(&b.0));
    rows
}

/// Checks that the session under this key equals the one in `source`, byte for byte.
fn assert_is(root: &Path, key: &str, source: &Path) {
    let mut there = tree(&root.join("sessions").join(key));
    there.remove("import.json").expect("it has a record");
    there.remove("validation.json");
    assert!(there == tree(source), "{key} is not {}", source.display());
}

fn copy(from: &Path, to: &Path) {
    for (path, content) in tree(from) {
        let path = to.join(path);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, content).unwrap();
    }
}

/// A complete session, and damaged copies of it, with their condition.
fn copies(folder: &Path) -> Vec<(&'static str, Condition)> {
    let whole = folder.join("whole");
    Session::with_units(2.0, 2000).write(&whole);
    let segment = |name: &str| folder.join(name).join("segments/000000.mcap");
    // The lengths of all files are unchanged.
    copy(&whole, &folder.join("flipped"));
    let mut bytes = fs::read(segment("flipped")).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(segment("flipped"), &bytes).unwrap();
    copy(&whole, &folder.join("shortened"));
    let bytes = fs::read(segment("whole")).unwrap();
    fs::write(segment("shortened"), &bytes[..bytes.len() / 2]).unwrap();
    copy(&whole, &folder.join("without a segment"));
    fs::remove_file(segment("without a segment")).unwrap();
    copy(&whole, &folder.join("without a manifest"));
    fs::remove_file(folder.join("without a manifest/session.json")).unwrap();
    vec![
        ("flipped", Condition::Damaged),
        ("shortened", Condition::Damaged),
        ("without a segment", Condition::Damaged),
        ("without a manifest", Condition::Damaged),
    ]
}

#[test]
fn damaged_copy_never_shadows_a_later_complete_one() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let aside = format!("{ID}.damaged");
    for (name, condition) in copies(folder.path()) {
        let root = at(&format!("library {name}"));
        let first = import_with(&root, &at(name), &no_hook).unwrap();
        assert_eq!(first.condition, condition, "{name}");
        let again = import_with(&root, &at(name), &no_hook).unwrap();
        assert!(again.already_imported, "{name}");

        let whole = import_with(&root, &at("whole"), &no_hook).unwrap();
        assert_eq!(whole.condition, Condition::Ok, "{name}");
        assert_eq!(whole.replaced.as_ref(), Some(&aside), "{name}");
        assert_is(&root, ID, &at("whole"));
        assert_is(&root, &aside, &at(name));
        let both = [(ID.to_owned(), Condition::Ok), (aside.clone(), condition)];
        assert_eq!(rows(&root), both, "{name}");
        // Every name selects the complete copy.
        let library = Library::open(&root).unwrap();
        for text in [ID, &ID[..8], "walk"] {
            assert_eq!(library.find(text).unwrap(), ID, "{text}");
        }
        assert_eq!(library.find(&aside).unwrap(), aside);
        drop(library);
        assert_eq!(tree(&root.join(".incoming")).len(), 0);

        // Importing again changes nothing.
        assert!(
            import_with(&root, &at("whole"), &no_hook)
                .unwrap()
                .already_imported
        );
        let _ = import_with(&root, &at(name), &no_hook);
        assert_eq!(rows(&root), both, "{name}");
        assert_is(&root, ID, &at("whole"));
    }
}

#[test]
fn damaged_copy_never_replaces_a_complete_one() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for (name, _) in copies(folder.path()) {
        let root = at(&format!("library {name}"));
        import_with(&root, &at("whole"), &no_hook).unwrap();
        match import_with(&root, &at(name), &no_hook) {
            // With the same lengths and the same manifest it counts as the same session.
            Ok(imported) => assert!(imported.already_imported && name == "flipped", "{name}"),
            Err(e) => assert!(matches!(e, ImportError::Differs { .. }), "{name}: {e}"),
        }
        assert_eq!(rows(&root), [(ID.to_owned(), Condition::Ok)], "{name}");
        assert_is(&root, ID, &at("whole"));
    }
}

#[test]
fn damaged_copy_neither_replaces_another_nor_is_lost() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    copies(folder.path());
    let root = at("library");
    import_with(&root, &at("shortened"), &no_hook).unwrap();
    let error = import_with(&root, &at("flipped"), &no_hook).unwrap_err();
    assert!(matches!(error, ImportError::Differs { .. }), "{error}");
    assert_is(&root, ID, &at("shortened"));
}

#[test]
fn cut_off_replaces_damaged_and_complete_replaces_cut_off() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let mut session = Session::with_units(2.0, 2000);
    session.closed = false;
    session.write(&at("cut"));
    let segment = at("cut/segments/000000.mcap");
    let bytes = fs::read(&segment).unwrap();
    copy(&at("cut"), &at("damaged"));
    let mut flipped = bytes.clone();
    flipped[bytes.len() / 2] ^= 1;
    fs::write(at("damaged/segments/000000.mcap"), flipped).unwrap();
    fs::write(&segment, &bytes[..bytes.len() - 100]).unwrap();
    Session::with_units(2.0, 2000).write(&at("whole"));
    let root = at("library");
    for (name, replaced) in [
        ("damaged", None),
        ("cut", Some(format!("{ID}.damaged"))),
        ("whole", Some(format!("{ID}.damaged-2"))),
    ] {
        let imported = import_with(&root, &at(name), &no_hook).unwrap();
        assert_eq!(imported.replaced, replaced, "{name}");
        assert_is(&root, ID, &at(name));
    }
    assert_is(&root, &format!("{ID}.damaged"), &at("damaged"));
    assert_is(&root, &format!("{ID}.damaged-2"), &at("cut"));
    assert_eq!(Library::open(&root).unwrap().find(&ID[..8]).unwrap(), ID);
}

/// A session that was cut off, one that was also damaged, one that the rig closed, and one
/// recovered from the damaged one.
fn cut_off(folder: &Path) {
    let at = |name: &str| folder.join(name);
    let mut session = Session::with_units(2.0, 2000);
    session.closed = false;
    session.write(&at("cut"));
    let segment = at("cut/segments/000000.mcap");
    let mut bytes = fs::read(&segment).unwrap();
    bytes.truncate(bytes.len() - 100);
    fs::write(&segment, &bytes).unwrap();
    copy(&at("cut"), &at("closed"));
    let storage = |name: &str| Arc::new(DiskStorage::new(at(name)));
    assert!(close_cut_off(storage("closed")).unwrap().is_some());
    copy(&at("cut"), &at("damaged"));
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(at("damaged/segments/000000.mcap"), &bytes).unwrap();
    let damaged = SessionReader::open(storage("damaged")).unwrap();
    recover(&damaged, storage("saved"), |_| {}).unwrap();
}

#[test]
fn closed_session_is_better_than_its_cut_off_copy_in_either_order() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    cut_off(folder.path());
    let aside = format!("{ID}.damaged");

    let root = at("library");
    let first = import_with(&root, &at("cut"), &no_hook).unwrap();
    assert_eq!(first.condition, Condition::Unclosed);
    let closed = import_with(&root, &at("closed"), &no_hook).unwrap();
    assert_eq!(closed.condition, Condition::Recovered);
    assert_eq!(closed.replaced.as_ref(), Some(&aside));
    assert_is(&root, ID, &at("closed"));
    assert_is(&root, &aside, &at("cut"));

    let root = at("other library");
    import_with(&root, &at("closed"), &no_hook).unwrap();
    let error = import_with(&root, &at("cut"), &no_hook).unwrap_err();
    assert!(matches!(error, ImportError::Differs { .. }), "{error}");
    let error = import_with(&root, &at("damaged"), &no_hook).unwrap_err();
    assert!(matches!(error, ImportError::Differs { .. }), "{error}");
    assert_eq!(rows(&root), [(ID.to_owned(), Condition::Recovered)]);
    assert_is(&root, ID, &at("closed"));
}

#[test]
fn recovered_copy_does_not_replace_a_cut_off_one_with_more_samples() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    cut_off(folder.path());

    let root = at("library");
    let first = import_with(&root, &at("saved"), &no_hook).unwrap();
    assert_eq!(first.condition, Condition::Recovered);
    let cut = import_with(&root, &at("cut"), &no_hook).unwrap();
    assert_eq!(cut.replaced, Some(format!("{ID}.damaged")));
    assert_is(&root, ID, &at("cut"));

    let root = at("other library");
    import_with(&root, &at("cut"), &no_hook).unwrap();
    let error = import_with(&root, &at("saved"), &no_hook).unwrap_err();
    assert!(matches!(error, ImportError::Differs { .. }), "{error}");
    assert_is(&root, ID, &at("cut"));
}

#[test]
fn both_copies_survive_a_stop_at_any_step_of_replacing() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    copies(folder.path());
    let mut stopped = 0;
    for step in [
        Step::Begin,
        Step::SyncFolders,
        Step::Record,
        Step::Publish,
        Step::SyncPublished,
        Step::List,
    ] {
        let root = at(&format!("library {step:?}"));
        import_with(&root, &at("flipped"), &no_hook).unwrap();
        let stop = |now: &Step| match *now == step {
            true => Err(io::Error::other("killed")),
            false => Ok(()),
        };
        import_with(&root, &at("whole"), &stop).unwrap_err();
        stopped += 1;
        let there = rows(&root);
        let is_flipped = |key: &str| {
            let file = root.join("sessions").join(key).join("segments/000000.mcap");
            fs::read(file).unwrap() == fs::read(at("flipped/segments/000000.mcap")).unwrap()
        };
        let damaged = there.iter().filter(|(key, _)| is_flipped(key));
        assert_eq!(damaged.count(), 1, "{step:?}: {there:?}");
        for (key, condition) in &there {
            let is_damaged = *condition == Condition::Damaged;
            assert_eq!(is_damaged, is_flipped(key), "{step:?}: {there:?}");
        }
        let _ = import_with(&root, &at("whole"), &no_hook).unwrap();
        assert_is(&root, ID, &at("whole"));
        assert_is(&root, &format!("{ID}.damaged"), &at("flipped"));
        let both = [
            (ID.to_owned(), Condition::Ok),
            (format!("{ID}.damaged"), Condition::Damaged),
        ];
        assert_eq!(rows(&root), both, "{step:?}");
    }
    assert_eq!(stopped, 6);
}

#[test]
fn remains_of_a_damaged_copy_do_not_corrupt_the_complete_one() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    copies(folder.path());
    // Copies that keep the times, as `cp -p` and disks do.
    for path in tree(&at("whole")).keys() {
        let whole = fs::metadata(at("whole").join(path)).unwrap();
        let flipped = fs::File::options()
            .write(true)
            .open(at("flipped").join(path))
            .unwrap();
        flipped.set_modified(whole.modified().unwrap()).unwrap();
    }
    let root = at("library");
    let stop = |step: &Step| match step {
        Step::SyncFolders => Err(io::Error::other("killed")),
        _ => Ok(()),
    };
    import_with(&root, &at("flipped"), &stop).unwrap_err();
    // Only differing files are copied; the old one is not removed before the new one is complete.
    let stop = |step: &Step| match step {
        Step::Note(_) => Err(io::Error::other("killed")),
        _ => Ok(()),
    };
    import_with(&root, &at("whole"), &stop).unwrap_err();
    let left = root.join(".incoming").join(ID);
    assert!(tree(&left) == tree(&at("flipped")));
    let imported = import_with(&root, &at("whole"), &no_hook).unwrap();
    assert_eq!(imported.condition, Condition::Ok);
    let segment = fs::metadata(at("whole/segments/000000.mcap")).unwrap();
    assert_eq!(imported.copied, segment.len());
    assert!(imported.resumed > 0);
    assert_is(&root, ID, &at("whole"));
    assert_eq!(fs::read_dir(root.join(".incoming")).unwrap().count(), 0);
}

#[test]
fn copied_files_are_kept_when_the_source_disk_fails() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    cut_off(folder.path());
    let root = at("library");
    let stop = |step: &Step| match step {
        Step::SyncFolders => Err(io::Error::other("killed")),
        _ => Ok(()),
    };
    import_with(&root, &at("cut"), &stop).unwrap_err();
    let recorded = tree(&at("cut"));
    let bytes: usize = recorded.values().map(Vec::len).sum();
    // From here on the segment is unreadable.
    let die = |step: &Step| match step {
        Step::SyncFolders => fs::remove_file(at("cut/segments/000000.mcap")),
        _ => Ok(()),
    };
    let imported = import_with(&root, &at("cut"), &die).unwrap();
    assert_eq!(imported.condition, Condition::Unclosed);
    assert_eq!((imported.copied, imported.resumed), (0, bytes as u64));
    let mut there = tree(&root.join("sessions").join(ID));
    assert!(there.remove("import.json").is_some());
    assert!(there == recorded);
}

#[test]
fn replaced_copy_with_the_longest_identifier_is_listed() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    let id = "x".repeat(100);
    let mut session = Session::with_units(2.0, 2000);
    session.spec.session_id = id.clone();
    session.write(&at("whole"));
    copy(&at("whole"), &at("flipped"));
    let segment = at("flipped/segments/000000.mcap");
    let mut bytes = fs::read(&segment).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&segment, bytes).unwrap();
    let root = at("library");
    import_with(&root, &at("flipped"), &no_hook).unwrap();
    let aside = import_with(&root, &at("whole"), &no_hook).unwrap().replaced;
    let aside = aside.unwrap();
    let both = [
        (format!("{}.damaged", "x".repeat(92)), Condition::Damaged),
        (id.clone(), Condition::Ok),
    ];
    assert_eq!(rows(&root), both);
    let library = Library::open(&root).unwrap();
    assert_eq!(library.find("xxx").unwrap(), id);
    assert_eq!(library.find(&aside).unwrap(), aside);
}

#[test]
fn session_corrupted_in_the_library_is_replaced_once_detected() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    copies(folder.path());
    let root = at("library");
    import_with(&root, &at("whole"), &no_hook).unwrap();
    let there = root.join("sessions").join(ID);
    fs::copy(
        at("flipped/segments/000000.mcap"),
        there.join("segments/000000.mcap"),
    )
    .unwrap();
    let target = collector::target::Target::find(ID, Some(&root)).unwrap();
    let options = collector::commands::validate::Options::default();
    let (outcome, text) = crate::support::capture(|console| {
        collector::commands::validate::run(&[target], &options, console)
    });
    outcome.unwrap();
    assert_eq!(rows(&root), [(ID.to_owned(), Condition::Damaged)], "{text}");
    let imported = import_with(&root, &at("whole"), &no_hook).unwrap();
    assert!(!imported.already_imported && imported.replaced.is_some());
    assert_is(&root, ID, &at("whole"));
}
