//! One segment file: the scan is total, what it yields lies in the file, and every record parses
//! or is an error.

#![no_main]

use std::sync::Arc;

use libfuzzer_sys::fuzz_target;
use session_archive::mcap::{Record, RecordIter};
use session_archive::scan::{Item, Scan};

mod edits;

fuzz_target!(|data: &[u8]| {
    let Some((mode, data)) = data.split_first() else {
        return;
    };
    let bytes = if mode & 1 == 0 {
        data.to_vec()
    } else {
        let mut files = edits::fixture();
        files.remove(2);
        files.remove(0);
        edits::edit(&mut files, data);
        files.swap_remove(0).1
    };
    for record in RecordIter::new(bytes.get(8..).unwrap_or_default()) {
        if let Ok(record) = record {
            let _ = record.opcode();
        }
    }
    for opcode in 0..=16 {
        let _ = Record::parse(opcode, data);
    }
    let limit = (mode & 2 != 0).then_some(bytes.len() as u64 / 2);
    let length = bytes.len() as u64;
    let mut scan = Scan::new(Arc::new(bytes), limit, length).expect("scan");
    let mut position = 0;
    while let Some(item) = scan.next_item().expect("memory does not fail") {
        if let Item::Chunk(chunk) = item {
            assert!(chunk.offset >= position);
            position = chunk.offset + chunk.length;
            assert!(position <= length);
            assert!(chunk.messages().all(|m| m.is_ok()));
        }
    }
    assert!(scan.end().is_some());
});
