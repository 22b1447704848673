//! Writes the session that is checked in under `tests/fixtures/v1`:
//! `cargo run -p session-archive --example write_fixture -- DIR`. The same bytes every time.

#[path = "../tests/support/mod.rs"]
mod support;

use std::path::PathBuf;
use std::sync::Arc;

use session_archive::storage::DiskStorage;

fn main() {
    let Some(folder) = std::env::args_os().nth(1).map(PathBuf::from) else {
        eprintln!("usage: write_fixture DIR");
        std::process::exit(2);
    };
    std::fs::create_dir_all(&folder).expect("make the folder");
    let storage = Arc::new(DiskStorage::new(folder));
    support::record(storage, &support::samples(1.0), 24).expect("record");
}
