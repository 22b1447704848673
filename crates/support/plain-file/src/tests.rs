use std::os::unix::fs::symlink;
use std::os::unix::net::UnixListener;

use rustix::fs::{CWD, FileType, Mode, mknodat};

use super::*;

fn fifo(path: &Path) {
    let mode = Mode::from_raw_mode(0o644);
    mknodat(CWD, path, FileType::Fifo, mode, 0).expect("a FIFO");
}

fn kind(result: io::Result<impl Sized>) -> Option<Kind> {
    let error = result.err().expect("refused");
    assert!(is_refusal(&error) && is_not_plain(&error), "{error}");
    let inner = error.get_ref().expect("a reason");
    let file = inner.downcast_ref::<NotPlain>().map(|e| e.0);
    file.or_else(|| inner.downcast_ref::<NotFolder>().map(|e| e.0))
}

#[test]
fn only_files_are_opened_and_the_rest_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("file"), b"content").unwrap();
    symlink("file", at("link")).unwrap();
    symlink("pipe", at("link to a pipe")).unwrap();
    fifo(&at("pipe"));
    let _listener = UnixListener::bind(at("socket")).unwrap();
    fs::create_dir(at("folder")).unwrap();

    assert_eq!(read(&at("file"), 7).unwrap(), b"content");
    assert_eq!(read_to_string(&at("link"), 7).unwrap(), "content");
    open_no_link(&at("file")).unwrap();
    for (name, expected) in [
        ("pipe", Kind::Fifo),
        ("link to a pipe", Kind::Fifo),
        ("socket", Kind::Socket),
        ("folder", Kind::Folder),
    ] {
        assert_eq!(kind(open(&at(name))), Some(expected), "{name}");
    }
    assert_eq!(
        kind(open(Path::new("/dev/zero"))),
        Some(Kind::CharacterDevice)
    );
    for (name, expected) in [
        ("link", Kind::Link),
        ("link to a pipe", Kind::Link),
        ("pipe", Kind::Fifo),
    ] {
        assert_eq!(kind(open_no_link(&at(name))), Some(expected), "{name}");
    }
    let missing = open(&at("none")).unwrap_err();
    assert_eq!(missing.kind(), io::ErrorKind::NotFound);
    assert!(!is_refusal(&missing));
    assert_eq!(
        open(&at("pipe")).unwrap_err().to_string(),
        "found a FIFO (named pipe), expected a regular file"
    );
}

#[test]
fn below_a_folder_no_link_is_followed() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir_all(at("session/segments")).unwrap();
    fs::write(at("session/segments/0"), b"zero").unwrap();
    fs::write(at("secret"), b"secret").unwrap();
    symlink("../secret", at("session/manifest")).unwrap();
    symlink("segments", at("session/rig")).unwrap();
    symlink("session", at("latest")).unwrap();
    fifo(&at("session/pipe"));

    let below = |path: &str| read_below(&at("latest"), Path::new(path), 100);
    assert_eq!(below("segments/0").unwrap(), b"zero");
    assert_eq!(below("./segments/0").unwrap(), b"zero");
    assert_eq!(kind(below("manifest")), Some(Kind::Link));
    assert_eq!(kind(below("rig/0")), Some(Kind::Link));
    assert_eq!(kind(below("pipe")), Some(Kind::Fifo));
    assert_eq!(kind(below("segments")), Some(Kind::Folder));
    assert_eq!(kind(below("")), Some(Kind::Folder));
    for out in ["../secret", "segments/../../secret", "/etc/hostname"] {
        let error = below(out).unwrap_err();
        assert!(error.to_string().contains("leads out"), "{error}");
    }
    let missing = below("segments/1").unwrap_err();
    assert_eq!(missing.kind(), io::ErrorKind::NotFound);
    let missing = below("none/1").unwrap_err();
    assert_eq!(missing.kind(), io::ErrorKind::NotFound);
    let through = below("segments/0/1").unwrap_err();
    assert_eq!(through.kind(), io::ErrorKind::NotADirectory);
    check_folder_below(&at("latest"), Path::new("segments")).unwrap();
    let link = check_folder_below(&at("latest"), Path::new("rig"));
    assert_eq!(kind(link), Some(Kind::Link));
}

#[test]
fn lengths_are_weighed_before_memory_is_taken() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("huge");
    // Sparse: it takes no room on the disk.
    let file = File::create(&path).unwrap();
    file.set_len(1 << 42).unwrap();
    let error = read(&path, TEXT_LIMIT).unwrap_err();
    assert!(is_refusal(&error) && !is_not_plain(&error));
    assert_eq!(
        error.to_string(),
        "found 4398046511104 bytes, expected at most 1048576"
    );
    // A reader that says that it holds less than it does.
    let endless = read_known(io::repeat(1), 3, 10).unwrap_err();
    assert!(is_refusal(&endless), "{endless}");
    assert_eq!(read_known(&b"more"[..], 0, 4).unwrap(), b"more");
    assert_eq!(read_known(&b"less"[..], 100, 100).unwrap(), b"less");
    // Files of /proc are said to be empty.
    assert!(
        !read(Path::new("/proc/self/status"), TEXT_LIMIT)
            .unwrap()
            .is_empty()
    );
    let memory = reserve(u64::MAX).unwrap_err();
    assert_eq!(memory.kind(), io::ErrorKind::OutOfMemory);
}
