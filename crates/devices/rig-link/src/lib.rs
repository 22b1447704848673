//! Both ends of the network link to the rig: the phone's page, and sessions pulled by hosts.
//!
//! * [`server`] is a small HTTPS server on a thread of its own. It serves a [`rig::Rig`] to a phone
//!   and its sessions to a host. It does not depend on the recorder: the daemon implements the
//!   trait.
//! * [`client`] is the host's end: certificate pinning, resumption, verification.
//! * [`link`] is the protocol, *rig link v1*, specified in `docs/reference/rig-link.md`.
//! * [`store`] is the folder of sessions as served: listing, hashes, receipts, freeing.
//! * [`identity`] and [`token`] authenticate both ends: a self-signed certificate pinned by its
//!   fingerprint, and a shared secret.
//! * [`preview`] computes preview images, [`fake`] is a rig without hardware for tests and for the
//!   demo.
//!
//! Guarantees of the server: it never serves the session that is being recorded, never a file that
//! is not in its own listing, never frees a session without a stored receipt that matches the files
//! on disk, and never blocks the recorder. Off loopback it uses TLS 1.3 and requires the token.

pub mod client;
mod clock;
pub mod fake;
pub mod identity;
pub mod link;
pub mod preview;
pub mod range;
pub mod rig;
pub mod server;
pub mod store;
pub mod token;
