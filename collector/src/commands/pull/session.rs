//! Pulling one session.

use std::fs;
use std::path::Path;
use std::sync::Mutex;

use anyhow::{Context, Result, bail, ensure};
use console_output::{Clock, Progress};
use rig_link::client::{Client, LinkError};
use rig_link::link::{
    Code, FileEntry, Manifest, RECEIPT_FORMAT, Receipt, SessionSummary, Total, VERSION, list_hash,
};

use super::shared::{locked, of_session};
use crate::condition::Condition;
use crate::import::existing::{self, CopyQuality, ExistingCopy};
use crate::import::{FileRecord, ImportError, ImportRecord, ImportResult, publish};
use crate::library::Library;
use crate::session_key::is_key;

/// State shared by all pulls.
pub(super) struct Puller<'a> {
    pub(super) library: Mutex<Library>,
    pub(super) clock: Clock,
    pub(super) progress: &'a Progress,
    /// Name of this host.
    pub(super) host: String,
    pub(super) free: bool,
}

/// A session that has been pulled.
pub(super) struct PullResult {
    pub(super) imported: ImportResult,
    /// Message sent to the rig, as text; an error if the rig rejected it.
    pub(super) rig: Result<&'static str>,
}

impl Puller<'_> {
    /// Pulls a session, sends the receipt, and has it freed if requested.
    pub(super) fn pull(&self, client: &mut Client, summary: &SessionSummary) -> Result<PullResult> {
        let name = &summary.name;
        let key = summary.session_id.as_deref().unwrap_or_default();
        ensure!(
            is_key(key),
            "pulling {name}: its identifier {key:?} cannot be the name of a folder"
        );
        let folder = locked(&self.library).folder(key);
        let there = if folder.exists() {
            of_session(name, self.already_in_library(client, summary, key, &folder))?
        } else {
            ExistingCopy::Absent
        };
        let imported = match there {
            ExistingCopy::Same(imported) => *imported,
            ExistingCopy::Absent => of_session(name, self.fetch(client, summary, key, None))?,
            ExistingCopy::Worse(old) => {
                of_session(name, self.fetch(client, summary, key, Some(old)))?
            }
        };
        let rig = self.send_receipt(client, summary, key, &imported);
        Ok(PullResult { imported, rig })
    }

    /// Downloads all files, verifies and publishes the session. `old` is the quality of the copy
    /// that it replaces.
    fn fetch(
        &self,
        client: &mut Client,
        summary: &SessionSummary,
        key: &str,
        old: Option<CopyQuality>,
    ) -> Result<ImportResult> {
        let name = &summary.name;
        let manifest = client.manifest(name, |_| {})?;
        let incoming = locked(&self.library).incoming(key);
        let records: Vec<FileRecord> = manifest.files.iter().map(record).collect();
        publish::prepare(&incoming, &records)?;
        let (mut fetched, mut resumed) = (0, 0);
        for entry in &manifest.files {
            let path = incoming.join(&entry.path);
            if let Some(folder) = path.parent() {
                fs::create_dir_all(folder)
                    .with_context(|| format!("making the folder: {}", folder.display()))?;
            }
            let done = client.download(name, entry, &path, |n| self.progress.add(n))?;
            fetched += done.fetched;
            resumed += done.resumed;
        }
        let source = format!("{}/{name}", client.address());
        let source = Path::new(&source);
        let checked = publish::check(&incoming, key, source, self.clock, records)?;
        let mut imported = publish::publish(&mut locked(&self.library), checked, source, old)?;
        (imported.copied, imported.resumed) = (fetched, resumed);
        Ok(imported)
    }

    /// Compares a session of the library with the rig's. If the library's is damaged, the rig's may
    /// be better, which only downloading shows.
    fn already_in_library(
        &self,
        client: &mut Client,
        summary: &SessionSummary,
        key: &str,
        folder: &Path,
    ) -> Result<ExistingCopy> {
        let worth = existing::quality_in_library(&locked(&self.library), key);
        let condition = worth.condition;
        let Some(record) = ImportRecord::read(folder) else {
            ensure!(
                condition.needs_recovery(),
                "session {key} is in the library already and has no import record: {}",
                folder.display()
            );
            return Ok(ExistingCopy::Worse(worth));
        };
        let held = total(&record.files);
        let receipt = summary.receipt.as_ref();
        // A stored receipt for the same content means that the library's copy was compared. It is
        // compared again if it is known to have been damaged since, and before the rig's is freed:
        // that may be the last copy.
        let is_known = receipt.is_some_and(|r| r.list == held.list) && !condition.needs_recovery();
        if !is_known {
            let manifest = client.manifest(&summary.name, |_| {})?;
            if let Some(what) = difference(&manifest, &record.files) {
                if condition.needs_recovery() {
                    return Ok(ExistingCopy::Worse(worth));
                }
                bail!(
                    "session {key} is in the library already and differs ({what}); nothing was changed: {}",
                    folder.display()
                );
            }
        }
        if !is_known || self.free {
            match publish::verify_files(folder, &record.files, self.progress) {
                // Damage by the library's disk since then.
                Err(ImportError::Changed { what, .. }) => {
                    log::warn!(
                        "{what} of session {key} is damaged in the library; it is fetched again"
                    );
                    return Ok(ExistingCopy::Worse(CopyQuality::DAMAGED));
                }
                other => other?,
            }
        } else {
            self.progress.add(held.bytes);
        }
        Ok(ExistingCopy::Same(Box::new(publish::already_imported(
            &locked(&self.library),
            key,
            record,
        )?)))
    }

    /// Sends the receipt, and requests to free the session.
    fn send_receipt(
        &self,
        client: &mut Client,
        summary: &SessionSummary,
        key: &str,
        imported: &ImportResult,
    ) -> Result<&'static str> {
        if imported.condition == Condition::Damaged {
            return Ok("no receipt, the rig keeps it");
        }
        let name = &summary.name;
        let folder = locked(&self.library).folder(key);
        let record = ImportRecord::read(&folder)
            .with_context(|| format!("reading the import record: {}", folder.display()))?;
        let held = total(&record.files);
        if summary.receipt.as_ref().is_none_or(|r| r.list != held.list) {
            let receipt = Receipt {
                format: RECEIPT_FORMAT.to_owned(),
                version: VERSION,
                session_id: key.to_owned(),
                list: held.list,
                files: held.files,
                bytes: held.bytes,
                host: self.host.clone(),
                verified_ns: (self.clock.civil_ns)(),
            };
            hashed(client, name, |client| client.put_receipt(name, &receipt))?;
        }
        if !self.free {
            return Ok("receipt sent");
        }
        hashed(client, name, |client| client.free(name))?;
        Ok("freed on the rig")
    }
}

/// Sends a request that needs the session's hashes; a restarted rig computes them again for the
/// manifest.
fn hashed(
    client: &mut Client,
    session: &str,
    ask: impl Fn(&mut Client) -> Result<(), LinkError>,
) -> Result<(), LinkError> {
    match ask(client) {
        Err(LinkError::Rejected { problem, .. }) if problem.code == Code::ManifestFirst => {
            client.manifest(session, |_| {})?;
            ask(client)
        }
        other => other,
    }
}

fn record(entry: &FileEntry) -> FileRecord {
    FileRecord {
        path: entry.path.clone(),
        bytes: entry.bytes,
        modified_ns: entry.modified_ns,
        blake3: entry.blake3.clone(),
    }
}

/// Totals of these files for a receipt.
fn total(files: &[FileRecord]) -> Total {
    let lines = files
        .iter()
        .map(|f| (f.path.as_str(), f.bytes, f.blake3.as_str()));
    Total {
        list: list_hash(lines),
        files: files.len() as u64,
        bytes: files.iter().map(|f| f.bytes).sum(),
    }
}

/// The first difference between the rig's and the library's session.
fn difference(rig: &Manifest, library: &[FileRecord]) -> Option<String> {
    for entry in &rig.files {
        match library.iter().find(|f| f.path == entry.path) {
            None => return Some(format!("{} is not in the library", entry.path)),
            Some(known) if known.blake3 != entry.blake3 => {
                return Some(format!("{} has another content", entry.path));
            }
            Some(_) => {}
        }
    }
    let extra = library
        .iter()
        .find(|known| rig.files.iter().all(|f| f.path != known.path));
    extra.map(|extra| format!("{} is only in the library", extra.path))
}
