//! A whole session folder: opening, reading, verifying and recovering it never panics, a recovered
//! copy holds what the source gave, and every loss in it is reported.

#![no_main]

use std::sync::Arc;

use libfuzzer_sys::fuzz_target;
use session_archive::layout;
use session_archive::reader::{Entry, SessionReader};
use session_archive::recover::{RecoverError, recover};
use session_archive::storage::FaultStorage;
use session_archive::verify::verify;

mod edits;

fuzz_target!(|data: &[u8]| {
    let Some((mode, data)) = data.split_first() else {
        return;
    };
    let files = if mode & 1 == 0 {
        split(data)
    } else {
        let mut files = edits::fixture();
        edits::edit(&mut files, data);
        files
    };
    let disk = FaultStorage::new();
    for (path, content) in files {
        disk.set_content(&path, content);
    }
    let Ok(reader) = SessionReader::open(Arc::new(disk)) else {
        return;
    };
    let report = verify(&reader, |_| {}).expect("memory does not fail");
    let target = FaultStorage::new();
    match recover(&reader, Arc::new(target.clone()), |_| {}) {
        Ok(recovered) => {
            assert_eq!(recovered.source, report);
            assert_eq!(
                (recovered.copy.lost.len(), recovered.copy.damage.len()),
                (0, 0)
            );
            let copy = SessionReader::open(Arc::new(target)).expect("open the copy");
            assert!(count(&copy) >= count(&reader));
        }
        // A manifest that somebody else made and signed may lack the streams that recovery needs.
        Err(RecoverError::NotSound(_)) if lacks_streams(&reader) => {}
        Err(e) => panic!("{e}"),
    }
});

fn lacks_streams(reader: &SessionReader) -> bool {
    use session_archive::record::{Event, Gap, Segment};
    let manifest = reader.manifest();
    manifest.stream::<Gap>("").is_none()
        || manifest.stream::<Event>("").is_none()
        || manifest.stream::<Segment>("").is_none()
}

fn count(reader: &SessionReader) -> usize {
    let entries = reader.entries().map(|e| e.expect("memory does not fail"));
    entries.filter(|e| matches!(e, Entry::Message(_))).count()
}

/// A manifest and up to three segments, divided by their lengths.
fn split(mut data: &[u8]) -> Vec<(String, Vec<u8>)> {
    let paths = [
        layout::MANIFEST.to_owned(),
        layout::segment(0),
        layout::segment(1),
        layout::segment(2),
    ];
    let mut files = Vec::new();
    for path in paths {
        let Some((length, rest)) = data.split_first_chunk() else {
            break;
        };
        let n = usize::from(u16::from_le_bytes(*length)).min(rest.len());
        let (content, rest) = rest.split_at(n);
        files.push((path, content.to_vec()));
        data = rest;
    }
    files
}
