//! A request to a rig failed.

use std::io;
use std::path::PathBuf;

use super::Address;
use crate::identity::Fingerprint;
use crate::link::{Problem, VERSION};

/// A request to a rig failed.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// Write it as `https://HOST:8077`.
    #[error("{found:?} is not a rig address: {reason}; expected https://HOST[:PORT]")]
    Address {
        /// The given text.
        found: String,
        /// The reason.
        reason: &'static str,
    },
    /// Use https.
    #[error("{address} is not on this machine; over a network only https is allowed")]
    PlainText {
        /// The address.
        address: Address,
    },
    /// Compare it with the one that `pawsd` shows on the rig, then pass it.
    #[error(
        "the rig's certificate has the fingerprint {found}; if that is what `pawsd` shows on the rig, give it with --fingerprint: {address}"
    )]
    NoFingerprint {
        /// The fingerprint of the rig's certificate.
        found: Fingerprint,
        /// The address.
        address: Address,
    },
    /// Another server is at this address, or the rig has a new identity. Compare with the
    /// fingerprint that `pawsd` shows on the rig.
    #[error(
        "not the expected rig: its certificate has the fingerprint {found}, expected {expected}: {address}"
    )]
    WrongFingerprint {
        /// The fingerprint of the server's certificate.
        found: Fingerprint,
        /// The expected fingerprint.
        expected: Fingerprint,
        /// The address.
        address: Address,
    },
    /// Is the rig on, and in the same network?
    #[error("{doing}: no answer after {tries} tries ({reason}): {address}")]
    NoResponse {
        /// The attempted operation.
        doing: String,
        /// Tries in a row that brought nothing.
        tries: u32,
        /// Failure of the last attempt.
        reason: String,
        /// The address.
        address: Address,
    },
    /// The rig rejects the request; the code states what to do.
    #[error("{doing}: the rig reports: {}", .problem.message)]
    Rejected {
        /// The attempted operation.
        doing: String,
        /// The rig's error.
        problem: Problem,
    },
    /// The server is not a rig, or one of another version.
    #[error("{doing}: the answer is not one of rig link v{VERSION}: {reason}: {address}")]
    Malformed {
        /// The attempted operation.
        doing: String,
        /// The reason.
        reason: String,
        /// The address.
        address: Address,
    },
    /// The file does not match the manifest, even when fetched again from the start: fetch the
    /// manifest again. If the error persists, the rig's disk or memory is faulty.
    #[error("{path} has the hash {found}, expected {expected} from the rig's manifest")]
    Corrupt {
        /// The file's path in the session.
        path: String,
        /// Hash of the received bytes.
        found: String,
        /// Hash in the manifest.
        expected: String,
    },
    /// An I/O error of the host.
    #[error("{doing}: {}", .path.display())]
    Disk {
        /// The attempted operation.
        doing: &'static str,
        /// What failed.
        #[source]
        source: io::Error,
        /// The file.
        path: PathBuf,
    },
    /// The system provides no thread, socket or random numbers.
    #[error("preparing to ask a rig")]
    System(#[source] io::Error),
}
