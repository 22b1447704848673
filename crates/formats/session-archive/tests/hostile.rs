//! Session folders from strangers on a real disk: what is no file is never opened, and no length
//! that a file states is trusted. What must not take memory runs in a process that has little.

use std::fs;
use std::os::unix::fs::symlink;
use std::process::Command;
use std::sync::Arc;

use session_archive::index::{FrameEntry, Index, IndexError};
use session_archive::manifest;
use session_archive::reader::{ReadError, SessionReader};
use session_archive::storage::{DiskStorage, Storage, read_all, read_up_to};

/// Says that this process is the one with little memory.
const LITTLE: &str = "SESSION_ARCHIVE_TEST_WITH_LITTLE_MEMORY";

/// Runs the test of this name again in a process of at most 512 MiB of addresses; true in that
/// process.
fn with_little_memory(test: &str) -> bool {
    if std::env::var_os(LITTLE).is_some() {
        return true;
    }
    let output = Command::new("sh")
        .args(["-c", "ulimit -v 524288 && exec \"$0\" \"$@\""])
        .arg(std::env::current_exe().expect("this program"))
        .args(["--exact", test, "--nocapture", "--test-threads=1"])
        .env(LITTLE, "1")
        .output()
        .expect("a shell");
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(
        output.status.success() && text.contains("1 passed"),
        "{}: {text}{}",
        output.status,
        String::from_utf8_lossy(&output.stderr)
    );
    false
}

/// `index.bin` with this content.
fn packed(plain: &[u8], claimed: u64) -> Vec<u8> {
    let packed = zstd::bulk::compress(plain, 1).expect("compressed");
    let mut out = b"PAWSIDX2".to_vec();
    out.extend(crc32fast::hash(&packed).to_le_bytes());
    out.extend(claimed.to_le_bytes());
    out.extend(packed);
    out
}

fn refused(bytes: &[u8]) -> String {
    match Index::from_bytes(bytes) {
        Err(e @ (IndexError::Unreadable(_) | IndexError::Io(_))) => format!("{e:?}"),
        other => panic!("{:?}", other.map(|index| index.session_id)),
    }
}

#[test]
fn an_index_that_claims_to_be_huge_takes_no_memory() {
    if !with_little_memory("an_index_that_claims_to_be_huge_takes_no_memory") {
        return;
    }
    // A valid one is read.
    let index = Index {
        session_id: "s".to_owned(),
        segments: vec![(0, 5)],
        cameras: Vec::new(),
        imus: Vec::new(),
        sets: Vec::new(),
        damaged: 0,
    };
    let bytes = index.to_bytes().expect("bytes");
    assert_eq!(Index::from_bytes(&bytes).expect("an index"), index);
    // Long when unpacked, or said to be.
    let zeros = vec![0; 60 << 20];
    for claimed in [60 << 20, 1 << 29, 1 << 30, 1 << 31, u64::MAX] {
        refused(&packed(&zeros, claimed));
    }
    // Short, with a list in it that claims to be long: identifier "s", then this number of
    // segments.
    for count in [
        1 << 20,
        (1 << 30) / size_of::<(u32, u64)>() as u64,
        1 << 40,
        u64::MAX,
    ] {
        let mut plain = vec![1, b's', 253];
        plain.extend(count.to_le_bytes());
        plain.resize(2000, 0);
        refused(&packed(&plain, plain.len() as u64));
    }
    // One camera with this number of frames.
    let count = (1_u64 << 30) / size_of::<FrameEntry>() as u64 - 1;
    let mut plain = vec![1, b's', 0, 1, 1, b'c', 253];
    plain.extend(count.to_le_bytes());
    plain.resize(2000, 0);
    refused(&packed(&plain, plain.len() as u64));
}

#[test]
fn files_that_are_longer_than_their_kind_are_not_read() {
    if !with_little_memory("files_that_are_longer_than_their_kind_are_not_read") {
        return;
    }
    let folder = tempfile::tempdir().expect("a folder");
    let file = fs::File::create(folder.path().join("session.json")).expect("a file");
    file.set_len(1 << 42).expect("a sparse file");
    let disk = DiskStorage::new(folder.path());
    let error = read_all(&disk, "session.json").expect_err("refused");
    assert!(plain_file::is_refusal(&error), "{error}");
    assert!(
        error.to_string().contains("expected at most 67108864"),
        "{error}"
    );
    let error = manifest::Manifest::read(&disk).expect_err("refused");
    let error = format!("{error:?}");
    assert!(error.contains(&manifest::MAX_BYTES.to_string()), "{error}");
    // Within its limit, and still more than there is.
    let error = read_up_to(&disk, "session.json", u64::MAX).expect_err("refused");
    assert_eq!(error.kind(), std::io::ErrorKind::OutOfMemory);
    assert!(matches!(
        SessionReader::open(Arc::new(disk)),
        Err(ReadError::NoSession)
    ));
}

#[test]
fn below_a_sessions_folder_no_link_is_followed() {
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name);
    fs::create_dir_all(at("session/segments")).expect("a folder");
    fs::create_dir(at("elsewhere")).expect("a folder");
    fs::write(at("elsewhere/000000.mcap"), b"x").expect("a file");
    fs::write(at("secret"), b"x").expect("a file");
    symlink("../secret", at("session/session.json")).expect("a link");
    symlink("session", at("latest")).expect("a link");
    let disk = DiskStorage::new(at("latest"));
    assert_eq!(disk.list("segments").expect("names"), Vec::<String>::new());
    assert_eq!(disk.list("rig").expect("none"), Vec::<String>::new());
    for path in ["session.json", "../secret"] {
        let error = disk.open(path).err().expect("refused");
        assert_eq!(error.kind(), std::io::ErrorKind::InvalidInput, "{error}");
    }
    let opened = SessionReader::open(Arc::new(disk.clone()));
    match opened.err().expect("refused") {
        ReadError::Io { path, error } => {
            assert_eq!(path, "session.json");
            assert_eq!(
                error.to_string(),
                "found a symbolic link, expected a regular file"
            );
        }
        other => panic!("{other}"),
    }
    fs::remove_dir(at("session/segments")).expect("removed");
    symlink("../elsewhere", at("session/segments")).expect("a link");
    let error = disk.list("segments").expect_err("refused");
    assert_eq!(
        error.to_string(),
        "found a symbolic link, expected a folder"
    );
    disk.open("segments/000000.mcap").err().expect("refused");
}
