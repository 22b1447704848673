//! Copying the files of a session.
//!
//! Two threads: one reads, hashes and writes; the other syncs and records finished files in the
//! journal. At most [`MAX_OUTSTANDING_SYNCS`] syncs are outstanding, so the copy never runs far
//! ahead of the disk, and the disk never waits for the end of a file.

use std::fs::{self, File};
use std::io::{self, Read, Write};
use std::num::NonZeroU64;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;

use console_output::Progress;
use rustix::fs::{Advice, fadvise};

use super::error::{ImportError, failed};
use super::file_record::FileRecord;
use super::growing_copy::CopyProgress;
use super::journal::Journal;
use super::source::SourceFile;
use super::step::{Hook, Step};

/// Bytes read, hashed and written at a time.
const BLOCK: usize = 1 << 20;
/// Read-ahead of the source, bytes, so that its disk reads while this program hashes and writes.
const PREFETCH_BYTES: u64 = 16 << 20;
/// Bytes per read-ahead request.
const PREFETCH_STEP_BYTES: u64 = 4 << 20;
/// Bytes after which a growing file is synced, so that the disk is always busy.
const SYNC_INTERVAL_BYTES: u64 = 32 << 20;
/// Maximum number of outstanding syncs.
const MAX_OUTSTANDING_SYNCS: usize = 2;

/// Result of a copy.
pub(super) struct CopyResult {
    /// Bytes copied.
    pub(super) bytes: u64,
    /// All files of the session, reused and copied, in order.
    pub(super) records: Vec<FileRecord>,
}

/// Job of the sync thread.
enum Job {
    /// Sync the file as written so far.
    Flush(Arc<File>),
    /// The file is complete: sync it and record it.
    Finish(Arc<File>, FileRecord),
}

/// Copies all files that are not reused. Copied files remain if it fails.
#[expect(
    clippy::too_many_arguments,
    reason = "one call, and a struct would only repeat the names"
)]
pub(super) fn copy_all(
    source: &Path,
    incoming: &Path,
    files: &[SourceFile],
    kept: &[FileRecord],
    journal: &mut Journal,
    copy_progress: &CopyProgress,
    progress: &Progress,
    hook: Hook<'_>,
) -> Result<CopyResult, ImportError> {
    thread::scope(|scope| {
        let (jobs, queue) = sync_channel(MAX_OUTSTANDING_SYNCS);
        let syncing = scope.spawn(|| sync(queue, incoming, journal, hook));
        let mut copy = Copy {
            source,
            incoming,
            jobs,
            copy_progress,
            progress,
            hook,
            block: vec![0; BLOCK],
        };
        let mut bytes = 0;
        let mut result = Ok(());
        for file in files {
            if kept.iter().any(|k| k.path == file.path) {
                continue;
            }
            match copy.file(file) {
                Ok(true) => bytes += file.bytes,
                // The sync thread has ended with an error.
                Ok(false) => break,
                Err(e) => {
                    result = Err(e);
                    break;
                }
            }
        }
        drop(copy);
        let finished = match syncing.join() {
            Ok(finished) => finished,
            Err(panic) => std::panic::resume_unwind(panic),
        };
        result?;
        let mut records = finished?;
        records.extend_from_slice(kept);
        records.sort_by_key(|r| files.iter().position(|f| f.path == r.path));
        Ok(CopyResult { bytes, records })
    })
}

struct Copy<'a> {
    source: &'a Path,
    incoming: &'a Path,
    jobs: SyncSender<Job>,
    copy_progress: &'a CopyProgress,
    progress: &'a Progress,
    hook: Hook<'a>,
    block: Vec<u8>,
}

impl Copy<'_> {
    /// Copies one file; false if the sync thread has ended.
    fn file(&mut self, file: &SourceFile) -> Result<bool, ImportError> {
        let (from, to) = (self.source.join(&file.path), self.incoming.join(&file.path));
        if let Some(folder) = to.parent() {
            fs::create_dir_all(folder).map_err(failed("making the folder", folder))?;
        }
        let mut input = plain_file::open_below(self.source, Path::new(&file.path))
            .map_err(failed("reading", &from))?;
        let mut asked = 0;
        let output = Arc::new(File::create(&to).map_err(failed("creating", &to))?);
        self.copy_progress.ready(&file.path, 0);
        let mut hasher = blake3::Hasher::new();
        let (mut at, mut synced) = (0, 0);
        loop {
            while asked < file.bytes.min(at + PREFETCH_BYTES) {
                // Only a hint; file systems without support ignore it.
                let _ = fadvise(
                    &input,
                    asked,
                    NonZeroU64::new(PREFETCH_STEP_BYTES),
                    Advice::WillNeed,
                );
                asked += PREFETCH_STEP_BYTES;
            }
            let n = match input.read(&mut self.block) {
                Ok(0) => break,
                Ok(n) => n,
                Err(e) if e.kind() == io::ErrorKind::Interrupted => continue,
                Err(e) => return Err(failed("reading", &from)(e)),
            };
            let block = &self.block[..n];
            (self.hook)(&Step::Write(file.path.clone())).map_err(failed("writing", &to))?;
            (&*output)
                .write_all(block)
                .map_err(failed("writing", &to))?;
            at += n as u64;
            self.copy_progress.ready(&file.path, at.min(file.bytes));
            hasher.update(block);
            self.progress.add(n as u64);
            if at - synced >= SYNC_INTERVAL_BYTES {
                synced = at;
                if self.jobs.send(Job::Flush(output.clone())).is_err() {
                    return Ok(false);
                }
            }
        }
        if at != file.bytes {
            return Err(ImportError::Changed {
                what: file.path.clone(),
                path: self.source.to_owned(),
            });
        }
        let record = FileRecord {
            path: file.path.clone(),
            bytes: at,
            modified_ns: file.modified_ns,
            blake3: hasher.finalize().to_hex().to_string(),
        };
        Ok(self.jobs.send(Job::Finish(output, record)).is_ok())
    }
}

fn sync(
    queue: Receiver<Job>,
    incoming: &Path,
    journal: &mut Journal,
    hook: Hook<'_>,
) -> Result<Vec<FileRecord>, ImportError> {
    let mut finished = Vec::new();
    for job in queue {
        match job {
            Job::Flush(file) => file.sync_data().map_err(failed("syncing", incoming))?,
            Job::Finish(file, record) => {
                let path = incoming.join(&record.path);
                hook(&Step::Sync(record.path.clone())).map_err(failed("syncing", &path))?;
                file.sync_data().map_err(failed("syncing", &path))?;
                hook(&Step::Note(record.path.clone())).map_err(failed("noting", &path))?;
                journal.note(&record).map_err(failed("noting", &path))?;
                finished.push(record);
            }
        }
    }
    Ok(finished)
}
