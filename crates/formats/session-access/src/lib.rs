//! What programs on the host share to read a session.
//!
//! * [`SessionFolder`]: the folder of a session, and whether a library lists it.
//! * [`open`] and [`read_or_build`]: its reader and its index.
//! * [`decode`]: its images, decoded; [`decode_check`]: whether all of them can be.
//! * [`Frames`]: the transforms between its coordinate frames.
//!
//! Nothing here writes, and nothing reads the catalogue of a library.

pub mod decode;
pub mod decode_check;
mod folder;
mod frame_tree;
mod index;

pub use folder::{CATALOGUE, INCOMING, SESSIONS, SessionFolder, is_session, mcap_note};
pub use frame_tree::Frames;
pub use index::{build, open, read_or_build};
