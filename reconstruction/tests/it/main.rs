//! The crate and its program as their users see them, on sessions made here: encoded, written,
//! indexed and sealed by the crates that do it in earnest.

mod command;
mod evaluate;
mod frame_set_reader;
mod hostile;
mod judged;
mod read_back;
mod refuse;
mod session;
mod stages;
mod walk;
