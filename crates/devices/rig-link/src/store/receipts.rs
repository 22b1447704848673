//! The hosts' receipts, on disk.

use session_archive::storage::{self, DiskStorage, Storage};

use super::{Session, Store, problem, unreadable};
use crate::link::{Code, Problem, RECEIPT_FORMAT, Receipt, VERSION, is_hash, is_session_name};

/// Folder of the receipts, beside the sessions.
pub const RECEIPTS: &str = "receipts";
/// Maximum length of a host's name, bytes.
const MAX_HOST: usize = 255;

impl Store {
    /// The stored receipt of a session, if readable. It may be for an earlier content.
    pub fn receipt(&self, name: &str) -> Option<Receipt> {
        if !is_session_name(name) {
            return None;
        }
        let text = plain_file::read(&self.root.join(path(name)), plain_file::TEXT_LIMIT).ok()?;
        let receipt: Receipt = serde_json::from_slice(&text).ok()?;
        is_valid(&receipt).then_some(receipt)
    }

    /// Stores and syncs a host's receipt. A later one replaces it.
    ///
    /// # Errors
    /// It is not a receipt of this version, or not for the files on disk ([`Code::ListDiffers`],
    /// [`Code::ManifestFirst`]), or an I/O error occurs.
    pub fn put_receipt(&self, session: &Session, receipt: &Receipt) -> Result<(), Problem> {
        if !is_valid(receipt) {
            return Err(problem(
                Code::BadRequest,
                &format!(
                    "not a receipt; expected format {RECEIPT_FORMAT:?}, version {VERSION}, a list hash of 64 hex digits and the name of the host"
                ),
            ));
        }
        let summary = self.summary(session, false).map_err(|e| unreadable(&e))?;
        if let Some(id) = summary.session_id.filter(|id| *id != receipt.session_id) {
            return Err(problem(
                Code::ListDiffers,
                &format!(
                    "the receipt is for session {:?}, this is {id:?}",
                    receipt.session_id
                ),
            ));
        }
        self.fits(session, receipt)?;
        let storage = DiskStorage::new(&self.root);
        let text = serde_json::to_vec_pretty(receipt).map_err(|e| unreadable(&e.into()))?;
        storage.create_dir(RECEIPTS).map_err(|e| unreadable(&e))?;
        storage::replace(&storage, &path(&session.name), &text).map_err(|e| unreadable(&e))
    }

    /// Whether a receipt matches the files on disk.
    pub(super) fn fits(&self, session: &Session, receipt: &Receipt) -> Result<(), Problem> {
        let total = self.known_total(session)?;
        if (total.list.as_str(), total.files, total.bytes)
            == (receipt.list.as_str(), receipt.files, receipt.bytes)
        {
            return Ok(());
        }
        Err(problem(
            Code::ListDiffers,
            &format!(
                "the receipt is for {} files, {} bytes, list {}; on disk are {} files, {} bytes, list {}",
                receipt.files, receipt.bytes, receipt.list, total.files, total.bytes, total.list
            ),
        ))
    }
}

fn path(name: &str) -> String {
    format!("{RECEIPTS}/{name}.json")
}

fn is_valid(receipt: &Receipt) -> bool {
    receipt.format == RECEIPT_FORMAT
        && receipt.version == VERSION
        && is_hash(&receipt.list)
        && (1..=MAX_HOST).contains(&receipt.host.len())
        && !receipt.host.contains(char::is_control)
        && receipt.session_id.len() <= 100
}
