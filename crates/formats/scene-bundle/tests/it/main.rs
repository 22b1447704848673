//! The crate from outside: outputs written and read, exports read by other readers, the command
//! line.

mod colmap;
mod command;
mod contacts;
mod export;
mod ground;
mod ground_exports;
mod ground_interop;
mod ground_outputs;
mod hostile;
mod interop;
mod outputs;
mod physics_interop;
mod sample;
mod splats;
mod tracks;
mod version1;
