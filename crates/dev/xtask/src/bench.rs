//! `cargo xtask bench NAME`: runs a benchmark in release mode.

use std::ffi::OsString;
use std::path::PathBuf;

use anyhow::Result;

use crate::process::{self, cargo, root, target_folder};
use crate::setup::{self, Purpose};
use crate::test::python::{self, Environment};
use crate::wheel;

/// Benchmarks beside OpenCV, or the reference implementation of AprilTag.
const WITH_READERS: [&str; 7] = [
    "calib",
    "depth",
    "foreign",
    "odometry",
    "rectify",
    "sim_images",
    "tag_detectors",
];

/// OpenUSD and its validators on an export of the ground.
const USD_TEST: [&str; 6] = [
    "test",
    "--locked",
    "--package=scene-bundle",
    "open_usd_sees",
    "--",
    "--show-output",
];

/// Runs the benchmarks one after the other; the first that fails ends the run.
pub(crate) fn run(install: bool, names: &[&str], arguments: &[OsString]) -> Result<()> {
    let mut purposes = vec![Purpose::Build, Purpose::Video];
    let mut environments: Vec<&Environment> = Vec::new();
    if names.iter().any(|name| WITH_READERS.contains(name)) {
        environments.push(&python::READERS);
    }
    if names.contains(&"gtsam") {
        environments.push(&python::GTSAM);
    }
    if names.contains(&"sim_learn") {
        environments.push(&python::LEARNING);
    }
    if names.contains(&"sim_physics") {
        environments.push(&python::PHYSICS);
    }
    if names.contains(&"usd") {
        environments.push(&python::USD);
    }
    if names.contains(&"foreign") {
        environments.push(&python::RENDERER);
        purposes.push(Purpose::Rendering);
    }
    let with_open3d = names.contains(&"terrain");
    if !environments.is_empty() || with_open3d {
        purposes.push(Purpose::Interoperability);
    }
    if names.contains(&"power_cuts") || names.contains(&"vm_cost") {
        purposes.push(Purpose::Machines);
    }
    setup::system_packages(&purposes, install)?;
    let mut interpreters = Vec::new();
    for environment in environments {
        interpreters.push((environment.variable, environment.interpreter()?));
    }
    if with_open3d {
        // The other parts of the benchmark do without it.
        match python::OPEN3D.interpreter() {
            Ok(python) => interpreters.push((python::OPEN3D.variable, python)),
            Err(reason) => eprintln!("no Open3D, its part is left out: {reason:#}"),
        }
    }
    if let Some((_, python)) = interpreters
        .iter()
        .find(|(variable, _)| *variable == python::LEARNING.variable)
    {
        let out = target_folder()?.join("wheels");
        let wheel = wheel::build("release", &python::WHEEL.interpreter()?, &out)?;
        wheel::install_into(python, &wheel)?;
    }
    let kornia = match names.contains(&"tag_detectors") {
        true => kornia_apriltag(),
        false => None,
    };
    for name in names {
        let mut command = cargo()?;
        match *name {
            // No measurement: the test that skips itself where the package is not installed.
            "usd" => command.args(USD_TEST),
            _ => command
                .args(["run", "--release", "--locked", "--package", "bench", "--"])
                .arg(name)
                .args(arguments),
        };
        if let Some(data) = process::data_folder()? {
            command.env("PAWS_DATA", data);
        }
        for (variable, python) in &interpreters {
            command.env(variable, python);
        }
        if let Some(program) = &kornia {
            command.env("PAWS_KORNIA_APRILTAG", program);
        }
        println!("\n== bench {name}");
        process::run(&mut command)?;
    }
    Ok(())
}

/// Builds the program of kornia-apriltag, a workspace of its own. Without it the other detectors
/// are still compared.
fn kornia_apriltag() -> Option<PathBuf> {
    let build = || -> Result<PathBuf> {
        let package = root()?.join("crates/dev/bench/kornia-apriltag/Cargo.toml");
        let target = target_folder()?.join("kornia-apriltag");
        let mut command = cargo()?;
        command
            .args(["build", "--release", "--locked", "--manifest-path"])
            .arg(package)
            .arg("--target-dir")
            .arg(&target);
        process::run(&mut command)?;
        Ok(target.join("release/bench-kornia-apriltag"))
    };
    let built = build();
    if let Err(reason) = &built {
        eprintln!("no kornia-apriltag, it is left out: {reason:#}");
    }
    built.ok()
}
