use std::os::unix::fs::symlink;

use super::*;
use crate::fake::write_session;
use crate::link::{RECEIPT_FORMAT, Receipt, VERSION};

fn receipt(store: &Store, session: &Session) -> Receipt {
    for file in store.files(session).unwrap() {
        store.hash(session, &file, &|_| {}).unwrap();
    }
    let total = store.known_total(session).unwrap();
    Receipt {
        format: RECEIPT_FORMAT.to_owned(),
        version: VERSION,
        session_id: store.summary(session, false).unwrap().session_id.unwrap(),
        list: total.list,
        files: total.files,
        bytes: total.bytes,
        host: "desk".to_owned(),
        verified_ns: 1,
    }
}

#[test]
fn only_sessions_and_their_own_files_are_listed() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path().join("sessions");
    write_session(&root, "walk-1", 1, 3);
    fs::create_dir_all(root.join("receipts")).unwrap();
    fs::create_dir_all(root.join(".hidden/segments")).unwrap();
    fs::create_dir_all(root.join("a b/segments")).unwrap();
    symlink(root.join("walk-1"), root.join("linked")).unwrap();
    fs::write(folder.path().join("secret"), "s").unwrap();
    symlink(folder.path().join("secret"), root.join("walk-1/rig/link")).unwrap();
    symlink(folder.path(), root.join("walk-1/up")).unwrap();
    fs::write(root.join("walk-1/index.bin"), "derived").unwrap();

    let store = Store::new(root);
    let sessions = store.sessions().unwrap();
    let names: Vec<_> = sessions.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, ["walk-1"]);
    let files = store.files(&sessions[0]).unwrap();
    let paths: Vec<_> = files.iter().map(|f| f.path.as_str()).collect();
    assert!(paths.contains(&"session.json") && paths.contains(&"segments/000000.mcap"));
    assert!(
        !paths
            .iter()
            .any(|p| p.contains("link") || p.contains("up") || *p == "index.bin")
    );
    for path in [
        "rig/link",
        "up/secret",
        "../secret",
        "/etc/passwd",
        "",
        "rig",
        "index.bin",
    ] {
        let problem = store.open(&sessions[0], path).unwrap_err();
        assert_eq!(problem.code, Code::NotFound, "{path}");
    }
    for name in [
        "",
        ".",
        "..",
        "linked",
        "receipts",
        "walk-1/",
        "Walk-1",
        "walk-1/../walk-1",
    ] {
        assert_eq!(
            store.session(name).unwrap_err().code,
            Code::NotFound,
            "{name}"
        );
    }
    // An unlistable entry cannot be pulled, so it prevents freeing the session.
    assert_eq!(
        store.known_total(&sessions[0]).unwrap_err().code,
        Code::NotListed
    );
}

#[test]
fn session_states_are_reported() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let store = Store::new(root.to_owned());
    assert_eq!(Store::new(root.join("none")).sessions().unwrap(), []);
    write_session(root, "walk-1", 1, 1);
    let session = store.session("walk-1").unwrap();
    let summary = store.summary(&session, false).unwrap();
    assert_eq!(summary.state, SessionState::Closed);
    assert_eq!(
        store.summary(&session, true).unwrap().state,
        SessionState::Recording
    );
    assert!(summary.bytes > 0 && summary.files > 1 && summary.started_ns.is_some());
    let id = summary.session_id;
    assert!(id.is_some());

    let path = session.folder.join("session.json");
    let mut manifest = Manifest::from_bytes(&fs::read(&path).unwrap()).unwrap();
    manifest.state = State::Recording;
    fs::write(&path, manifest.to_bytes()).unwrap();
    assert_eq!(
        store.summary(&session, false).unwrap().state,
        SessionState::Interrupted
    );
    manifest.state = State::Recovered;
    fs::write(&path, manifest.to_bytes()).unwrap();
    assert_eq!(
        store.summary(&session, false).unwrap().state,
        SessionState::Recovered
    );
    fs::write(&path, "{}").unwrap();
    let damaged = store.summary(&session, false).unwrap();
    assert_eq!(
        (damaged.state, damaged.session_id),
        (SessionState::Damaged, id)
    );
}

#[test]
fn session_is_freed_only_with_a_matching_receipt() {
    let folder = tempfile::tempdir().unwrap();
    write_session(folder.path(), "walk-1", 1, 2);
    let store = Store::new(folder.path().to_owned());
    let session = store.session("walk-1").unwrap();
    let code = |result: Result<(), Problem>| result.unwrap_err().code;
    assert_eq!(code(store.free(&session)), Code::NoReceipt);

    let good = receipt(&store, &session);
    let other = |change: &dyn Fn(&mut Receipt)| {
        let mut receipt = good.clone();
        change(&mut receipt);
        code(store.put_receipt(&session, &receipt))
    };
    assert_eq!(other(&|r| r.list = "0".repeat(64)), Code::ListDiffers);
    assert_eq!(other(&|r| r.bytes += 1), Code::ListDiffers);
    assert_eq!(
        other(&|r| r.session_id = "other".to_owned()),
        Code::ListDiffers
    );
    assert_eq!(other(&|r| r.list = "../..".to_owned()), Code::BadRequest);
    assert_eq!(other(&|r| r.version += 1), Code::BadRequest);
    assert_eq!(other(&|r| r.format.clear()), Code::BadRequest);
    assert_eq!(other(&|r| r.host = "a\nb".to_owned()), Code::BadRequest);
    assert_eq!(code(store.free(&session)), Code::NoReceipt);

    store.put_receipt(&session, &good).unwrap();
    assert_eq!(store.receipt("walk-1").as_ref(), Some(&good));
    // With one byte more on disk the receipt no longer matches; the hash is unknown.
    let notes = session.folder.join("rig/notes.txt");
    fs::write(&notes, "rain").unwrap();
    assert_eq!(code(store.free(&session)), Code::ManifestFirst);
    receipt(&store, &session);
    assert_eq!(code(store.free(&session)), Code::ListDiffers);
    fs::remove_file(&notes).unwrap();
    // The same content, written again: hashed again, and the receipt fits again.
    let segment = session.folder.join("segments/000000.mcap");
    let bytes = fs::read(&segment).unwrap();
    fs::write(&segment, &bytes).unwrap();
    assert_eq!(code(store.free(&session)), Code::ManifestFirst);
    receipt(&store, &session);
    // A socket in the folder was not pulled.
    let socket = std::os::unix::net::UnixListener::bind(session.folder.join("s")).unwrap();
    assert_eq!(code(store.free(&session)), Code::NotListed);
    drop(socket);
    fs::remove_file(session.folder.join("s")).unwrap();
    assert!(session.folder.exists());

    // After a restart the receipt is kept, the hashes are not.
    let store = Store::new(folder.path().to_owned());
    assert_eq!(code(store.free(&session)), Code::ManifestFirst);
    receipt(&store, &session);
    store.free(&session).unwrap();
    assert!(!session.folder.exists());
    assert!(store.session("walk-1").is_err());
    assert_eq!(store.receipt("walk-1"), Some(good));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn interrupted_removals_are_finished_at_the_next_start() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir_all(folder.path().join(".freeing-walk-1/segments")).unwrap();
    fs::create_dir_all(folder.path().join(".other/segments")).unwrap();
    Store::new(folder.path().to_owned());
    assert!(!folder.path().join(".freeing-walk-1").exists());
    assert!(folder.path().join(".other").exists());
}
