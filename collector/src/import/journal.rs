//! Journal of finished files of an import: one JSON line each, written after the file is synced. A
//! torn line is ignored; a file without a line is copied again. The journal is beside the session's
//! folder (`.incoming/ID.journal`), so that the folder holds the session and nothing else.

use std::collections::BTreeMap;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use console_output::Progress;

use super::error::{ImportError, failed};
use super::file_record::FileRecord;
use super::hash::hash_file;
use super::source::SourceFile;

/// The journal of one import.
pub(super) struct Journal {
    file: File,
    finished: BTreeMap<String, FileRecord>,
}

impl Journal {
    /// Opens or creates the journal of the folder `incoming`.
    pub(super) fn open(incoming: &Path) -> Result<Self, ImportError> {
        let path = path_for(incoming);
        let text = match plain_file::read(&path, plain_file::DOCUMENT_LIMIT) {
            Ok(text) => text,
            Err(e) if e.kind() == io::ErrorKind::NotFound => Vec::new(),
            Err(e) => return Err(failed("reading the journal", &path)(e)),
        };
        let lines = text.split(|b| *b == b'\n');
        let finished = lines
            .filter_map(|line| serde_json::from_slice::<FileRecord>(line).ok())
            .map(|record| (record.path.clone(), record))
            .collect();
        let mut file = OpenOptions::new()
            .append(true)
            .create(true)
            .open(&path)
            .map_err(failed("opening the journal", &path))?;
        // A torn last line must not merge with the next one.
        file.write_all(b"\n")
            .map_err(failed("writing the journal", &path))?;
        Ok(Self { file, finished })
    }

    /// The files that need not be copied again: recorded, unchanged in the source since, and with
    /// the recorded hash on disk.
    pub(super) fn still_good(
        &self,
        incoming: &Path,
        files: &[SourceFile],
        progress: &Progress,
    ) -> Result<Vec<FileRecord>, ImportError> {
        let mut good = Vec::new();
        for file in files {
            let Some(noted) = self.finished.get(&file.path) else {
                continue;
            };
            let path = incoming.join(&file.path);
            if (noted.bytes, noted.modified_ns) != (file.bytes, file.modified_ns) {
                continue;
            }
            match hash_file(&path) {
                Ok((bytes, hash)) if bytes == noted.bytes && hash == noted.blake3 => {
                    progress.add(bytes);
                    good.push(noted.clone());
                }
                Ok(_) => {}
                Err(e) if e.kind() == io::ErrorKind::NotFound => {}
                Err(e) => return Err(failed("reading", &path)(e)),
            }
        }
        Ok(good)
    }

    /// Records a synced file.
    pub(super) fn note(&mut self, record: &FileRecord) -> io::Result<()> {
        let mut line = serde_json::to_vec(record).map_err(io::Error::other)?;
        line.push(b'\n');
        self.file.write_all(&line)
    }
}

/// Removes the journal of the folder `incoming`.
pub(super) fn remove(incoming: &Path) -> Result<(), ImportError> {
    let path = path_for(incoming);
    match fs::remove_file(&path) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => {
            Err(failed("removing the journal", &path)(e))
        }
        _ => Ok(()),
    }
}

fn path_for(incoming: &Path) -> PathBuf {
    let mut path = incoming.as_os_str().to_owned();
    path.push(".journal");
    path.into()
}
