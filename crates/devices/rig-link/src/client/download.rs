//! Download of one file of a session.

use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Read, Seek, SeekFrom, Write};
use std::path::Path;

use super::{Client, LinkError};
use crate::link::FileEntry;

/// Bytes written and hashed at a time.
const BLOCK: usize = 1 << 20;

/// Result of a download.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct DownloadStats {
    /// Bytes received over the network.
    pub fetched: u64,
    /// Bytes reused from an earlier, interrupted download.
    pub resumed: u64,
    /// Bytes received and discarded because of a wrong hash.
    pub wasted: u64,
}

impl Client {
    /// Downloads a file to `path`: reuses the bytes of an earlier download, fetches the rest,
    /// compares the hash and syncs the file (not its name). If the hash is wrong, the file is
    /// fetched once more from the start. `progress` counts every byte once, including reused ones.
    ///
    /// # Errors
    /// See [`LinkError`]; received bytes remain in the file and are reused by the next call.
    pub fn download(
        &mut self,
        session: &str,
        entry: &FileEntry,
        path: &Path,
        mut progress: impl FnMut(u64),
    ) -> Result<DownloadStats, LinkError> {
        let failed = |doing| {
            move |source| LinkError::Disk {
                doing,
                source,
                path: path.to_owned(),
            }
        };
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .map_err(failed("opening"))?;
        let mut done = DownloadStats::default();
        // Progress that was reported already and is not repeated for the second attempt.
        let mut reported = 0;
        for retry_or_fail in [false, true] {
            let mut hasher = blake3::Hasher::new();
            let there = file.metadata().map_err(failed("reading"))?.len();
            if there > entry.bytes || retry_or_fail {
                file.set_len(0).map_err(failed("emptying"))?;
            }
            let kept = hash_existing(&mut file, &mut hasher).map_err(failed("reading"))?;
            let mut at = kept;
            let mut report = |at: u64| {
                if at > reported {
                    progress(at - reported);
                    reported = at;
                }
            };
            report(at);
            let mut out = BufWriter::with_capacity(BLOCK, &file);
            let fetched = self.fetch(session, &entry.path, kept, entry.bytes, |piece| {
                hasher.update(piece);
                out.write_all(piece).map_err(failed("writing"))?;
                at += piece.len() as u64;
                report(at);
                Ok(())
            });
            // Keep the bytes received before the connection was lost.
            let flushed = out.flush().map_err(failed("writing"));
            drop(out);
            done.fetched += at - kept;
            fetched?;
            flushed?;
            let found = hasher.finalize().to_hex().to_string();
            if found == entry.blake3 {
                file.sync_data().map_err(failed("syncing"))?;
                done.resumed = kept;
                return Ok(done);
            }
            done.wasted += at - kept;
            log::warn!("{} of {session} has a wrong hash", entry.path);
            if retry_or_fail {
                file.set_len(0).map_err(failed("emptying"))?;
                return Err(LinkError::Corrupt {
                    path: entry.path.clone(),
                    found,
                    expected: entry.blake3.clone(),
                });
            }
        }
        Ok(done)
    }
}

/// Hashes the content of the file, and seeks to its end.
fn hash_existing(file: &mut File, hasher: &mut blake3::Hasher) -> io::Result<u64> {
    file.seek(SeekFrom::Start(0))?;
    let mut block = vec![0; BLOCK];
    let mut kept = 0;
    loop {
        match file.read(&mut block) {
            Ok(0) => return Ok(kept),
            Ok(n) => {
                hasher.update(&block[..n]);
                kept += n as u64;
            }
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(e) => return Err(e),
        }
    }
}
