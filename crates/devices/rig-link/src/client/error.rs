//! Why a rig could not be asked, or did not do what was asked.

use std::io;
use std::path::PathBuf;

use super::Address;
use crate::identity::Fingerprint;
use crate::link::{Problem, VERSION};

/// Why a rig could not be asked, or did not do what was asked.
#[derive(Debug, thiserror::Error)]
pub enum LinkError {
    /// Write it as `https://HOST:8077`.
    #[error("{found:?} is no address of a rig: {reason}; expected https://HOST[:PORT]")]
    Address {
        /// What was given.
        found: String,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// Use https.
    #[error("{address} is not on this machine; over a network a rig is asked with https only")]
    PlainText {
        /// The address.
        address: Address,
    },
    /// Compare it with what `pawsd` shows on the rig, then give it.
    #[error(
        "the rig's certificate has the fingerprint {found}; if that is what `pawsd` shows on the rig, give it with --fingerprint: {address}"
    )]
    NoFingerprint {
        /// The fingerprint that the rig showed.
        found: Fingerprint,
        /// The address.
        address: Address,
    },
    /// Something else answers at this address, or the rig has a new identity. Look at what `pawsd` shows
    /// on the rig.
    #[error(
        "this is not the rig that is meant: its certificate has the fingerprint {found}, expected {expected}: {address}"
    )]
    WrongFingerprint {
        /// The fingerprint that was shown.
        found: Fingerprint,
        /// The one that was given.
        expected: Fingerprint,
        /// The address.
        address: Address,
    },
    /// Is the rig on, and in the same network?
    #[error("{doing}: no answer after {tries} tries ({reason}): {address}")]
    Lost {
        /// What was being done.
        doing: String,
        /// Tries in a row that brought nothing.
        tries: u32,
        /// How the last one ended.
        reason: String,
        /// The address.
        address: Address,
    },
    /// The rig says no; its code says what to do.
    #[error("{doing}: the rig says: {}", .problem.message)]
    Refused {
        /// What was being done.
        doing: String,
        /// What the rig says.
        problem: Problem,
    },
    /// What answers is no rig, or one of another version.
    #[error("{doing}: the answer is not one of rig link v{VERSION}: {reason}: {address}")]
    Garbled {
        /// What was being done.
        doing: String,
        /// What is wrong with it.
        reason: String,
        /// The address.
        address: Address,
    },
    /// The file is not what the manifest said, even when fetched again from the start: fetch the manifest
    /// again. If it happens again, the rig's disk or memory is at fault.
    #[error("{path} came with the hash {found}, the rig's manifest says {expected}")]
    Corrupt {
        /// The file's path in the session.
        path: String,
        /// Hash of what came.
        found: String,
        /// Hash in the manifest.
        expected: String,
    },
    /// The host's disk says no.
    #[error("{doing}: {}", .path.display())]
    Disk {
        /// What was being done.
        doing: &'static str,
        /// What failed.
        #[source]
        source: io::Error,
        /// The file.
        path: PathBuf,
    },
    /// The system gives no thread, socket or randomness.
    #[error("preparing to ask a rig")]
    System(#[source] io::Error),
}
