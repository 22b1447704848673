//! `cargo xtask deb`: the Debian package of the recorder, for this machine or for the Jetson.
//!
//! The program is linked against a Debian root folder of its architecture ([`root`]), so both
//! architectures are built in the same manner and nothing depends on what is installed here.
//! Always: the system packages that it needs are worked out of its symbols ([`symbols`]), and one
//! that JetPack 6 does not have fails the verb; so does a program that is not hardened ([`elf`]).
//! With `--check`: lintian, the same bytes once more, and an installation that records ([`smoke`]).
//!
//! Nothing outside the target folder and the folder for the package is written.
//! docs/guides/packaging.md states what was run.

mod architecture;
mod changelog;
mod contents;
mod elf;
mod files;
mod package;
mod program;
mod root;
mod smoke;
mod symbols;
mod third_party;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, Result, bail, ensure};

pub(crate) use architecture::Architecture;
use files::{output, read};
use package::Commit;
use root::Root;
use symbols::{Libraries, Need, OLDEST_SYSTEM};

use crate::process::{self, command, human};
use crate::setup::{self, Purpose};

/// Builds the package into `out`, and checks it on request.
pub(crate) fn run(
    install: bool,
    architecture: Option<Architecture>,
    out: Option<PathBuf>,
    check: bool,
) -> Result<()> {
    let start = Instant::now();
    let here = Architecture::here()?;
    let architecture = architecture.unwrap_or(here);
    setup::system_packages(&purposes(architecture, here, check)?, install)?;
    let work = process::target_folder()?.join("deb");
    let out = match out {
        Some(named) => std::path::absolute(named).context("reading --out")?,
        None => work.clone(),
    };

    let commit = Commit::read()?;
    let root = Root::prepare(architecture, &work)?;
    let built = program::build(architecture, &root, &work, install)?;
    let stripped = work.join(architecture.name()).join("pawsd");
    process::run(
        command(format!("{}-strip", architecture.gnu()))?
            .args(["--remove-section=.comment", "--remove-section=.note", "-o"])
            .args([&stripped, &built]),
    )?;
    let needs = examine(&stripped, &root)?;
    let assemble =
        |out: &Path| package::assemble(architecture, &commit, &stripped, &needs, &work, out);
    let package = assemble(&out)?;
    println!(
        "\n{}\n  {:.1} MB; the program {:.1} MB, with its symbols {:.1} MB: {}",
        package.display(),
        megabytes(&package)?,
        megabytes(&stripped)?,
        megabytes(&built)?,
        built.display()
    );
    for need in &needs {
        println!("  {} >= {} ({})", need.package, need.version, need.symbol);
    }
    if check {
        println!();
        same_bytes(
            &package,
            &assemble(&work.join(architecture.name()).join("again"))?,
        )?;
        lintian(&package)?;
        println!(
            "The package in a Debian root, {}:",
            if root.is_emulated()? {
                "emulated"
            } else {
                "on this machine's processor"
            }
        );
        smoke::run(&root, &package)?;
    }
    println!("\nDone in {}.", human(start.elapsed()));
    Ok(())
}

fn purposes(architecture: Architecture, here: Architecture, check: bool) -> Result<Vec<Purpose>> {
    let mut purposes = vec![Purpose::Build, Purpose::Packaging];
    if architecture != here {
        ensure!(
            architecture == Architecture::Arm64,
            "packages for {} are built on {0} machines only",
            architecture.name()
        );
        purposes.push(Purpose::CrossArm64);
    }
    if check {
        // `paws` validates what was recorded, and decodes for it.
        purposes.extend([Purpose::PackageCheck, Purpose::Video]);
        if architecture != here {
            purposes.push(Purpose::Emulation);
        }
    }
    Ok(purposes)
}

/// What the program needs of a system; an error if it is not hardened or JetPack 6 does not have
/// it.
fn examine(program: &Path, root: &Root) -> Result<Vec<Need>> {
    let readelf = |arguments: &[&str]| {
        output(
            Command::new("readelf")
                .arg("--wide")
                .args(arguments)
                .arg(program)
                .env("LC_ALL", "C"),
        )
    };
    let form = readelf(&[
        "--file-header",
        "--program-headers",
        "--section-headers",
        "--dynamic",
    ])?;
    let mut libraries = Libraries::default();
    for (package, _) in OLDEST_SYSTEM {
        if let Some(file) = root.symbols(package) {
            libraries
                .read(&read(&file)?)
                .with_context(|| format!("reading {}", file.display()))?;
        }
    }
    let needs = libraries.needs(
        &elf::needed_libraries(&form),
        &elf::undefined_symbols(&readelf(&["--dyn-syms"])?),
    )?;
    let mut wrong: Vec<String> = elf::faults(&form).into_iter().map(Into::into).collect();
    wrong.extend(symbols::too_new(&needs));
    if wrong.is_empty() {
        return Ok(needs);
    }
    bail!(
        "{} does not fit the machines that it is for:\n  - {}",
        program.display(),
        wrong.join("\n  - ")
    )
}

/// Whether making the package once more gives the same file.
fn same_bytes(package: &Path, again: &Path) -> Result<()> {
    let bytes = |path: &Path| fs::read(path).with_context(|| format!("reading {}", path.display()));
    ensure!(
        bytes(package)? == bytes(again)?,
        "made twice, the package is not the same: {} and {}",
        package.display(),
        again.display()
    );
    println!("Made twice, the package is the same.");
    Ok(())
}

/// Debian's rules, down to matters of taste; every exception stands with its reason in
/// `deploy/debian/lintian-overrides`. Left out here is the search for misspelt words in the
/// program, because machine code reads as words by chance, other ones in each build.
fn lintian(package: &Path) -> Result<()> {
    process::run(
        command("lintian")?
            .args(["--allow-root", "--display-info", "--pedantic"])
            .arg("--suppress-tags=spelling-error-in-binary")
            .arg("--fail-on=error,warning,info,pedantic")
            .arg(package),
    )
    .context("lintian finds what is neither mended nor excused")?;
    println!("lintian finds nothing beyond deploy/debian/lintian-overrides.");
    Ok(())
}

fn megabytes(path: &Path) -> Result<f64> {
    let data = fs::metadata(path).with_context(|| format!("reading {}", path.display()))?;
    Ok(data.len() as f64 / 1e6)
}
