//! The way to the rig, both ends: the phone's page, and sessions pulled over the network.
//!
//! * [`server`] is a small HTTPS server on a thread of its own. It shows a [`rig::Rig`] to a phone and
//!   its sessions to a host, and knows nothing of recording: the daemon implements the trait.
//! * [`client`] is the host's end: certificate pinning, resumption, verification.
//! * [`link`] is what goes over the wire, *rig link v1*, written down in `docs/rig-link.md`.
//! * [`store`] is the folder of sessions as the server shows it: listing, hashes, receipts, freeing.
//! * [`identity`] and [`token`] say who is who: a self-signed certificate known by its fingerprint, and
//!   a shared secret.
//! * [`preview`] makes the small images, [`fake`] a rig without hardware for tests and for the demo.
//!
//! What the server promises: it never serves the session that is being recorded, never a file that is
//! not in its own listing, never frees a session without a stored receipt that fits what is on disk,
//! and never makes the recorder wait. Off the machine itself it speaks TLS 1.3 and asks for the token.

pub mod client;
pub mod fake;
pub mod identity;
pub mod link;
pub mod preview;
pub mod range;
pub mod rig;
pub mod server;
pub mod store;
pub mod token;
