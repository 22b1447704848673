//! `cargo xtask wheel`: the Python package of the simulators, and its tests.
//!
//! maturin compiles the library into the workspace's target folder and packs it. One wheel fits
//! every Python from 3.10 on. Tests are installed from a wheel too, of the profile that the other
//! tests have, into an environment with gymnasium and numpy only; those of MuJoCo run from the
//! sources, with the readers' environment. How a user installs it is checked by [`fresh`].

mod fresh;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};

use crate::process::{self, command, root, target_folder};
use crate::setup::{self, Purpose};
use crate::test::python::{READERS, SIMULATION, WHEEL};

const PACKAGE: &str = "simulation/python";

/// Builds the wheel in release mode into a folder, `wheels` in the target folder without one, and
/// prints how it is installed.
pub(crate) fn run(install: bool, out: Option<PathBuf>) -> Result<()> {
    setup::system_packages(&[Purpose::Build, Purpose::Interoperability], install)?;
    let out = match out {
        Some(out) => std::path::absolute(&out)
            .with_context(|| format!("finding the folder {}", out.display()))?,
        None => target_folder()?.join("wheels"),
    };
    let wheel = build("release", &WHEEL.interpreter()?, &out)?;
    println!("{}", fresh::check(&wheel)?);
    println!("\n{}", wheel.display());
    println!(
        "\nInstall it into an environment of Python 3.10 or later, and step the demo's scene:\n"
    );
    println!(
        "  python3 -m venv sim && sim/bin/pip install {}",
        wheel.display()
    );
    println!(
        "  sim/bin/python -c 'import paws_sim; env = paws_sim.make(\"target/demo/walk.scene\"); \
         env.reset(seed=0); print(env.step(env.action_space.sample()))'"
    );
    Ok(())
}

/// The interpreters of maturin and of the tests. The error says why there is none.
pub(crate) fn interpreters() -> Result<[PathBuf; 2]> {
    Ok([WHEEL.interpreter()?, SIMULATION.interpreter()?])
}

/// Builds, installs and tests the package; the text says what was tested.
pub(crate) fn test([maturin, python]: &[PathBuf; 2]) -> Result<String> {
    let wheel = build("dev", maturin, &target_folder()?.join("wheels-of-tests"))?;
    install_into(python, &wheel)?;
    let mut tests = command(python)?;
    // Not from the folder of the sources, whose package has no library.
    tests.args(["-I", "-m", "unittest", "discover", "--start-directory"]);
    tests.arg(root()?.join(PACKAGE).join("tests"));
    process::run(&mut tests)?;
    let physics = match READERS.interpreter() {
        Ok(readers) => {
            test_physics(&readers)?;
            "its physics with MuJoCo"
        }
        Err(reason) => {
            println!("left out, the tests of its physics: {reason:#}");
            "its physics left out, without MuJoCo"
        }
    };
    let fresh = fresh::check(&wheel)?;
    Ok(format!(
        "paws_sim with gymnasium and numpy; {physics}; {fresh}"
    ))
}

/// Tests the physics from the sources: an environment with MuJoCo has no gymnasium.
fn test_physics(readers: &Path) -> Result<()> {
    let mut tests = command(readers)?;
    tests.args(["-I", "-B"]);
    tests.arg(root()?.join(PACKAGE).join("tests/test_physics.py"));
    tests.env("PAWS_MUJOCO_REQUIRED", "1");
    process::run(&mut tests)
}

/// Installs a wheel, and nothing that it depends on, in place of one before.
pub(crate) fn install_into(python: &Path, wheel: &Path) -> Result<()> {
    // Environments have no installer of their own.
    process::run(command(python)?.args(["-m", "ensurepip", "--default-pip"]))
        .context("adding the installer to a Python environment")?;
    let mut pip = command(python)?;
    pip.args([
        "-m",
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
    ]);
    pip.args(["--no-index", "--no-deps", "--force-reinstall"])
        .arg(wheel);
    process::run(&mut pip).context("installing the wheel")
}

/// The wheel of a profile, alone in a folder of wheels of this package.
pub(crate) fn build(profile: &str, maturin: &Path, out: &Path) -> Result<PathBuf> {
    for old in wheels(out)? {
        std::fs::remove_file(&old).with_context(|| format!("removing {}", old.display()))?;
    }
    let mut build = command(maturin)?;
    build.args(["-m", "maturin", "build", "--locked", "--profile", profile]);
    build.args(["--auditwheel", "skip", "--manifest-path"]);
    build.arg(root()?.join(PACKAGE).join("Cargo.toml"));
    build
        .arg("--interpreter")
        .arg(maturin)
        .arg("--target-dir")
        .arg(target_folder()?);
    build.arg("--out").arg(out);
    process::run(&mut build).context("building the wheel")?;
    let mut made = wheels(out)?;
    ensure!(
        made.len() == 1,
        "{} wheels in {}, expected one",
        made.len(),
        out.display()
    );
    Ok(made.remove(0))
}

/// Wheels of this package in a folder, which may not exist.
fn wheels(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = match std::fs::read_dir(folder) {
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        entries => entries.with_context(|| format!("reading the folder {}", folder.display()))?,
    };
    let mut found = Vec::new();
    for entry in entries {
        let path = entry
            .with_context(|| format!("reading the folder {}", folder.display()))?
            .path();
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if name.starts_with("paws_sim-") && name.ends_with(".whl") {
            found.push(path);
        }
    }
    Ok(found)
}
