//! The crate and its program from outside, on sessions created here: encoded, written, indexed and
//! sealed by the production crates.

mod command;
mod evaluate;
mod frame_set_reader;
mod full_disk;
mod gaussian_view;
mod ground;
mod hostile;
mod incomplete_walks;
mod judged;
mod read_back;
mod refuse;
mod session;
mod splats;
mod stages;
mod walk;
