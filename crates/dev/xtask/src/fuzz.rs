//! `cargo xtask fuzz`: the fuzz targets of the file formats, each for a while.
//!
//! They are workspaces of their own in the folder `fuzz` of each crate, because they need libFuzzer
//! and the sanitizers, which the compiler has behind unstable flags.

use std::path::Path;

use anyhow::{Context, Result, bail, ensure};

use crate::process::{self, cargo, root};
use crate::setup::{self, Purpose};

/// Crates with fuzz targets.
const CRATES: [&str; 3] = [
    "crates/formats/session-archive",
    "crates/formats/scene-bundle",
    "crates/support/gaussians",
];

/// Runs every target for `seconds`. A crash is an error; cargo-fuzz has said by then which input
/// does it and where that input lies.
pub(crate) fn run(install: bool, seconds: u32) -> Result<()> {
    if !process::succeeds(cargo()?.args(["fuzz", "--version"])) {
        bail!(
            "cargo-fuzz is not here. Install it with:\n\n    cargo install --locked cargo-fuzz\n"
        );
    }
    setup::system_packages(&[Purpose::Build, Purpose::Fuzzing], install)?;
    for package in CRATES {
        run_targets(&root()?.join(package), seconds)?;
    }
    Ok(())
}

/// Runs the targets of a crate.
fn run_targets(package: &Path, seconds: u32) -> Result<()> {
    let fuzz = |arguments: &[&str]| -> Result<std::process::Command> {
        let mut command = cargo()?;
        command
            .arg("fuzz")
            .args(arguments)
            .current_dir(package)
            // Sanitizers are unstable flags; this lets a stable compiler take them.
            .env("RUSTC_BOOTSTRAP", "1");
        Ok(command)
    };
    let listing = fuzz(&["list"])?
        .output()
        .context("listing the fuzz targets")?;
    ensure!(
        listing.status.success(),
        "listing the fuzz targets: {}",
        String::from_utf8_lossy(&listing.stderr).trim()
    );
    for target in String::from_utf8_lossy(&listing.stdout).lines() {
        let name = package.file_name().unwrap_or_default().display();
        println!("\n== fuzz {target} of {name} for {seconds} s");
        let limit = format!("-max_total_time={seconds}");
        process::run(&mut fuzz(&["run", target, "--", &limit])?)?;
    }
    Ok(())
}
