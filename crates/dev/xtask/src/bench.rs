//! `cargo xtask bench NAME`: runs a benchmark in release mode.

use std::ffi::OsString;

use anyhow::Result;

use crate::process::{self, cargo};
use crate::setup::{self, Purpose};
use crate::test::python;

/// Benchmarks beside OpenCV.
const WITH_OPENCV: [&str; 5] = ["calib", "depth", "odometry", "rectify", "sim_images"];

/// Runs the benchmarks one after the other; the first that fails ends the run.
pub(crate) fn run(install: bool, names: &[&str], arguments: &[OsString]) -> Result<()> {
    let mut purposes = vec![Purpose::Build, Purpose::Video];
    let needs_python = names.iter().any(|name| WITH_OPENCV.contains(name));
    if needs_python {
        purposes.push(Purpose::Interoperability);
    }
    if names.contains(&"power_cuts") || names.contains(&"vm_cost") {
        purposes.push(Purpose::Machines);
    }
    setup::system_packages(&purposes, install)?;
    let python = match needs_python {
        true => Some(python::interpreter()?),
        false => None,
    };
    for name in names {
        let mut command = cargo()?;
        command
            .args(["run", "--release", "--locked", "--package", "bench", "--"])
            .arg(name)
            .args(arguments);
        if let Some(data) = process::data_folder()? {
            command.env("PAWS_DATA", data);
        }
        if let Some(python) = &python {
            command.env("PAWS_PYTHON", python);
        }
        println!("\n== bench {name}");
        process::run(&mut command)?;
    }
    Ok(())
}
