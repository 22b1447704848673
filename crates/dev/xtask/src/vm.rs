//! `cargo xtask vm-test`: the tests on real kernel drivers, in virtual machines.
//!
//! Builds the programs, then the package `vm` does the rest. Where its kernel cannot be had the
//! tests are skipped with the reason, which is no failure.

use std::ffi::OsString;
use std::process::Stdio;

use anyhow::{Context, Result, bail};

use crate::process::{self, cargo, command, program_folder, target_folder};
use crate::setup::{self, Purpose};

/// Exit code of `vm` when it has no kernel.
const NO_KERNEL: i32 = 4;

/// Outcome, if nothing failed.
pub(crate) enum Ran {
    /// All cases that were chosen have passed.
    Passed,
    /// There is no kernel, or no guest starts on this machine; why was printed.
    Skipped,
}

/// Runs the cases with these names, or all. `features`: those with which the workspace was just
/// built, so that nothing is compiled twice.
pub(crate) fn run(
    install: bool,
    quick: bool,
    qemu: bool,
    cached: bool,
    features: Option<&str>,
    names: &[OsString],
) -> Result<Ran> {
    let mut purposes = vec![Purpose::Build, Purpose::Video, Purpose::Machines];
    if qemu {
        purposes.push(Purpose::Qemu);
    }
    setup::system_packages(&purposes, install)?;
    let mut build = cargo()?;
    // All of the workspace: with some of its packages alone Cargo would choose other features for
    // what they depend on, and compile most of it again.
    build.args(["build", "--locked", "--workspace", "--bins"]);
    build.args(features.into_iter().flat_map(|list| ["--features", list]));
    if features.is_some() {
        // What dependencies of tests ask for counts where tests are built, as they were.
        build.arg("--tests");
    }
    process::run(&mut build)?;
    driver_tests(features)?;

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

/// Builds the tests of the crate `v4l2` that need real cameras, and puts them where the guests find
/// them.
fn driver_tests(features: Option<&str>) -> Result<()> {
    let mut build = cargo()?;
    build.args(["test", "--locked", "--no-run", "--workspace"]);
    build.args(features.into_iter().flat_map(|list| ["--features", list]));
    build.args([
        "--test",
        "vivid",
        "--message-format=json-render-diagnostics",
    ]);
    let output = build
        .stderr(Stdio::inherit())
        .output()
        .with_context(|| format!("starting `{}`", process::line(&build)))?;
    let text = String::from_utf8_lossy(&output.stdout);
    let built = text
        .lines()
        .filter_map(|line| line.split_once(r#""executable":""#)?.1.split_once('"'))
        .next_back();
    let Some((built, _)) = built.filter(|_| output.status.success()) else {
        bail!("`{}` ended with {}", process::line(&build), output.status);
    };
    let program = program_folder()?.join("v4l2-vivid");
    std::fs::copy(built, &program)
        .with_context(|| format!("copying {built} to {}", program.display()))?;
    Ok(())
}
