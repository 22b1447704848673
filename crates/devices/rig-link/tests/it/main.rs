//! The server and the client over real sockets: hostile clients, pulling, pinning, the page.

#![expect(
    clippy::disallowed_methods,
    reason = "sockets and browsers need a real clock, and hostile clients wait"
)]

mod hostile;
mod page;
mod pinning;
mod pulling;
mod support;
