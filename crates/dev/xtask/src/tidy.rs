//! Checks of the repository by its text alone: words, layers, circles of modules, sizes.
#![allow(dead_code, reason = "the verb that uses these parts follows")]

mod charts;
mod circles;
mod comments;
mod dependencies;
mod files;
mod layers;
mod manifest;
mod modules;
mod outline;
mod patterns;
mod place;
mod prose;
mod size;
mod source;
mod strings;
mod test_code;
mod uses;
