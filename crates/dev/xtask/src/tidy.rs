//! Checks of the repository by its text alone: words, layers, circles of modules, sizes.
#![allow(dead_code, reason = "the verb that uses these parts follows")]

mod files;
mod source;
mod test_code;
