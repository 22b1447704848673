//! `session.json`: any bytes give a manifest or an error, and a manifest survives being written.

#![no_main]

use libfuzzer_sys::fuzz_target;
use session_archive::manifest::Manifest;

mod edits;

fuzz_target!(|data: &[u8]| {
    let Some((mode, data)) = data.split_first() else {
        return;
    };
    let bytes = if mode & 1 == 0 {
        data.to_vec()
    } else {
        let mut files = edits::fixture();
        files.truncate(1);
        edits::edit(&mut files, data);
        files.swap_remove(0).1
    };
    if let Ok(manifest) = Manifest::from_bytes(&bytes) {
        let again = Manifest::from_bytes(&manifest.to_bytes()).expect("what was written is read");
        assert_eq!(again, manifest);
        let identity = Manifest::from_identity(&manifest.identity()).expect("the identity");
        assert_eq!(identity.identity(), manifest.identity());
    }
    if let Ok(text) = std::str::from_utf8(&bytes) {
        let _ = Manifest::from_identity(text);
    }
});
