//! Checks of the repository by its text alone: words, layers, circles of modules, sizes.
#![allow(dead_code, reason = "the verb that uses these parts follows")]

mod charts;
mod comments;
mod files;
mod patterns;
mod prose;
mod source;
mod strings;
mod test_code;
