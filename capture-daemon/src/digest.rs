//! Digests of the inputs of a recording in virtual time, from which its identifier is made
//! (`run/identity.rs`).
//!
//! Image files, bags and videos contribute their names, lengths, first and last [`EDGE_BYTES`]
//! bytes; calibration files and ground truth all their bytes. The folders of files do not count.

use std::fmt::Debug;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

/// Number of bytes at both ends of a large file that enter the digest: the end of a PNG contains
/// the checksum of its pixels.
const EDGE_BYTES: u64 = 4096;

/// Input of an identifier. Each part is preceded by its length, so that different partitions of the
/// same bytes differ.
pub(crate) struct Digest(blake3::Hasher);

impl Digest {
    pub(crate) fn new(domain: &str) -> Self {
        let mut digest = Self(blake3::Hasher::new());
        digest.bytes(domain.as_bytes());
        digest
    }

    pub(crate) fn bytes(&mut self, bytes: &[u8]) {
        self.0.update(&(bytes.len() as u64).to_le_bytes());
        self.0.update(bytes);
    }

    /// Adds a value by its fields; floating-point numbers are printed as the shortest text that
    /// parses to the same value.
    pub(crate) fn value(&mut self, value: &impl Debug) {
        self.bytes(format!("{value:?}").as_bytes());
    }

    /// Adds a file by name, length and both ends. An unreadable file contributes its name only, and
    /// fails where it is used.
    pub(crate) fn file(&mut self, path: &Path) {
        let name = path.file_name().unwrap_or_default();
        self.bytes(name.as_encoded_bytes());
        match edges(path) {
            Ok((length, bytes)) => {
                self.value(&length);
                self.bytes(&bytes);
            }
            Err(_) => self.bytes(b"unreadable"),
        }
    }

    pub(crate) fn finish(self) -> [u8; 32] {
        *self.0.finalize().as_bytes()
    }
}

/// Length of a file, and its first and last bytes.
fn edges(path: &Path) -> io::Result<(u64, Vec<u8>)> {
    let mut file = File::open(path)?;
    let length = file.metadata()?.len();
    let mut bytes = Vec::new();
    Read::by_ref(&mut file)
        .take(EDGE_BYTES)
        .read_to_end(&mut bytes)?;
    if length > EDGE_BYTES {
        file.seek(SeekFrom::Start((length - EDGE_BYTES).max(EDGE_BYTES)))?;
        file.take(EDGE_BYTES).read_to_end(&mut bytes)?;
    }
    Ok((length, bytes))
}

#[cfg(test)]
mod tests {
    use std::fs;

    use super::*;

    fn digest(path: &Path) -> [u8; 32] {
        let mut digest = Digest::new("test");
        digest.file(path);
        digest.finish()
    }

    #[test]
    fn file_digest_covers_name_length_and_both_ends_but_not_the_folder() {
        let [a, b] = [(); 2].map(|()| tempfile::tempdir().expect("folder"));
        let put = |folder: &tempfile::TempDir, name: &str, bytes: &[u8]| {
            let path = folder.path().join(name);
            fs::write(&path, bytes).expect("file");
            path
        };
        let mut bytes = vec![7; 10_000];
        let one = digest(&put(&a, "1.png", &bytes));
        assert_eq!(digest(&put(&b, "1.png", &bytes)), one);
        assert_ne!(digest(&put(&b, "2.png", &bytes)), one);
        for at in [0, 4095, 5904, 9999] {
            bytes[at] = 8;
            assert_ne!(digest(&put(&b, "1.png", &bytes)), one, "byte {at}");
            bytes[at] = 7;
        }
        bytes.push(7);
        assert_ne!(digest(&put(&b, "1.png", &bytes)), one);
        // Shorter than two edges: every byte counts once.
        let (length, read) = edges(&put(&a, "s", &[1; 5000])).expect("file");
        assert_eq!((length, read.len()), (5000, 5000));
    }

    #[test]
    fn parts_are_delimited() {
        let of = |parts: [&[u8]; 2]| {
            let mut digest = Digest::new("test");
            for part in parts {
                digest.bytes(part);
            }
            digest.finish()
        };
        assert_ne!(of([b"ab", b"c"]), of([b"a", b"bc"]));
    }
}
