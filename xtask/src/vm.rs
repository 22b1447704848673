//! `cargo xtask vm-test`: the tests on real kernel drivers, in virtual machines.
//!
//! Builds the programs, then the package `vm` does the rest. Where its kernel cannot be had the tests are skipped with the
//! reason, which is no failure.

use std::ffi::OsString;

use anyhow::{Context, Result, bail};

use crate::process::{self, cargo, command, program_folder, target_folder};
use crate::setup::{self, Purpose};

/// Exit code of `vm` when it has no kernel.
const NO_KERNEL: i32 = 4;

/// What came of it, if nothing failed.
pub(crate) enum Ran {
    /// All cases that were chosen have passed.
    Passed,
    /// There is no kernel, or no guest starts on this machine; why was printed.
    Skipped,
}

/// Runs the cases with these names, or all.
pub(crate) fn run(
    install: bool,
    quick: bool,
    qemu: bool,
    cached: bool,
    names: &[OsString],
) -> Result<Ran> {
    let mut purposes = vec![Purpose::Build, Purpose::Video, Purpose::Machines];
    if qemu {
        purposes.push(Purpose::Qemu);
    }
    setup::system_packages(&purposes, install)?;
    let mut build = cargo()?;
    build.args(["build", "--locked", "--bins"]);
    for package in ["vm", "capture-daemon", "collector"] {
        build.args(["--package", package]);
    }
    process::run(&mut build)?;

    let mut vm = command(program_folder()?.join("vm"))?;
    vm.arg("run").arg("--out").arg(target_folder()?.join("vm"));
    for (flag, wanted) in [("--quick", quick), ("--qemu", qemu), ("--cached", cached)] {
        if wanted {
            vm.arg(flag);
        }
    }
    vm.args(names);
    let status = vm
        .status()
        .with_context(|| format!("starting `{}`", process::line(&vm)))?;
    match status.code() {
        Some(0) => Ok(Ran::Passed),
        Some(NO_KERNEL) => Ok(Ran::Skipped),
        _ => bail!("`{}` ended with {status}", process::line(&vm)),
    }
}
