//! Reads a manifest line by line as it arrives, and checks its consistency.

use std::time::Duration;

use bytes::{Buf, BytesMut};
use hyper::body::Incoming;

use super::{Failure, next};
use crate::link::{self, FileEntry, Line, MAX_LINE, Manifest, Problem};

/// Maximum number of files of a session.
const MAX_FILES: usize = 1 << 20;

/// Failure of reading a manifest.
pub(super) enum ManifestFailure {
    Failure(Failure),
    Malformed(String),
    Refused(Problem),
}

impl From<Failure> for ManifestFailure {
    fn from(failure: Failure) -> Self {
        Self::Failure(failure)
    }
}

/// The lines of a body. An empty line is a keepalive.
pub(super) struct Lines {
    body: Incoming,
    buffer: BytesMut,
    silence: Duration,
}

impl Lines {
    pub(super) fn new(body: Incoming, silence: Duration) -> Self {
        Self {
            body,
            buffer: BytesMut::new(),
            silence,
        }
    }

    async fn next(&mut self) -> Result<Option<Line>, ManifestFailure> {
        loop {
            if let Some(end) = self.buffer.iter().position(|b| *b == b'\n') {
                let line = self.buffer.split_to(end);
                self.buffer.advance(1);
                if line.is_empty() {
                    continue;
                }
                let line = serde_json::from_slice(&line);
                return line
                    .map(Some)
                    .map_err(|e| ManifestFailure::Malformed(e.to_string()));
            }
            if self.buffer.len() > MAX_LINE {
                let reason = format!("a line of the manifest is longer than {MAX_LINE} bytes");
                return Err(ManifestFailure::Malformed(reason));
            }
            match next(&mut self.body, self.silence).await? {
                Some(piece) => self.buffer.extend_from_slice(&piece),
                None => return Ok(None),
            }
        }
    }
}

pub(super) async fn read_manifest(
    mut lines: Lines,
    on_file: &mut impl FnMut(&FileEntry),
) -> Result<Manifest, ManifestFailure> {
    let mut files = Vec::new();
    loop {
        match lines.next().await? {
            Some(Line::File(entry)) if files.len() < MAX_FILES => {
                on_file(&entry);
                files.push(entry);
            }
            Some(Line::File(_)) => {
                return Err(ManifestFailure::Malformed(format!(
                    "more than {MAX_FILES} files"
                )));
            }
            Some(Line::Total(total)) => return Ok(Manifest { files, total }),
            Some(Line::Error(problem)) => return Err(ManifestFailure::Refused(problem)),
            None => {
                let cut = Failure::Retry("the manifest was cut off".to_owned(), None);
                return Err(cut.into());
            }
        }
    }
}

/// Checks a manifest: paths inside the folder, no duplicates, and correct totals.
pub(super) fn check(manifest: Manifest) -> Result<Manifest, String> {
    let mut paths: Vec<&str> = manifest.files.iter().map(|f| f.path.as_str()).collect();
    if let Some(odd) = paths.iter().find(|path| !link::is_file_path(path)) {
        return Err(format!("{odd:?} is not a path of a session's file"));
    }
    paths.sort_unstable();
    if let Some(twice) = paths.windows(2).find(|two| two[0] == two[1]) {
        return Err(format!("{:?} is there twice", twice[0]));
    }
    if let Some(odd) = manifest.files.iter().find(|f| !link::is_hash(&f.blake3)) {
        return Err(format!("{:?} is not a hash", odd.blake3));
    }
    let mut bytes = manifest.files.iter().map(|f| f.bytes);
    if bytes.try_fold(0_u64, |sum, b| sum.checked_add(b)).is_none() {
        return Err("its files are longer than any disk".to_owned());
    }
    let total = link::total(&manifest.files);
    if total != manifest.total {
        return Err(format!(
            "its last line has {:?}, expected {total:?} from its files",
            manifest.total
        ));
    }
    Ok(manifest)
}
