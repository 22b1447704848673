//! `cargo xtask schemas`: the code of the session format's schemas, made of
//! `crates/formats/session-archive/proto`.
//!
//! The generator is a workspace of its own in `crates/formats/session-archive/schemas`: a protobuf
//! compiler and its parsers would take a tenth of every cold build, for files that change a few
//! times a year. What it makes is in the repository, and a test of `session-archive` says when it
//! is of other schemas than those beside it.

use anyhow::Result;

use crate::process::{self, cargo, root, target_folder};

/// Runs the generator.
pub(crate) fn run() -> Result<()> {
    let package = root()?.join("crates/formats/session-archive/schemas/Cargo.toml");
    let mut command = cargo()?;
    command
        .args(["run", "--locked", "--quiet", "--manifest-path"])
        .arg(package)
        .arg("--target-dir")
        .arg(target_folder()?.join("schemas"));
    process::run(&mut command)
}
