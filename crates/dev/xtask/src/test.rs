//! `cargo xtask test`: every check that must pass before a change lands, in one go.
//!
//! A failed step does not stop the later ones, so that one run reports everything that is wrong;
//! the table at the end repeats what failed, what was left out and why. Tests that skip themselves
//! print a line beginning with `skipped:`; the test runner hides the output of tests that pass, so
//! those lines are picked out of it and shown (see [`runner`]).

pub(crate) mod python;
mod runner;

use std::io::{BufRead, BufReader, Read};
use std::process::{Child, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};

use crate::guide;
use crate::process::{self, cargo, human};
use crate::setup::{self, Purpose};
use crate::tidy;
use crate::vm;
use crate::wheel;
use runner::Report;

/// How a step ended; the text is what the table says beside it.
enum Ending {
    Passed(String),
    LeftOut(String),
    Failed(String),
}

struct Step {
    name: &'static str,
    ending: Ending,
    took: Duration,
}

/// Runs the checks; the error names the steps that failed. With `quick`: no Python readers, only
/// the unit tests, no documentation, no cargo deny.
pub(crate) fn run(install: bool, quick: bool) -> Result<()> {
    let mut purposes = vec![Purpose::Build, Purpose::Video, Purpose::Graphics];
    if !quick {
        purposes.push(Purpose::Interoperability);
    }
    setup::system_packages(&purposes, install)?;
    setup::rust_components(install)?;

    let mut report = Report::default();
    let mut python = None;
    let mut steps = vec![
        step("tidy", || Ok(Ending::Passed(tidy::check()?))),
        step("format", format_check),
        step("clippy", clippy),
    ];
    if !quick {
        steps.push(step("python readers", || {
            Ok(match python::interpreter() {
                Ok(path) => {
                    let text = path.display().to_string();
                    python = Some(path);
                    Ending::Passed(text)
                }
                Err(error) => {
                    println!("{error:#}");
                    Ending::LeftOut("tests that need them skip themselves".into())
                }
            })
        }));
    }
    steps.push(step("tests", || tests(quick, python, &mut report)));
    if !quick {
        steps.push(step("python package", python_package));
        steps.push(step("getting started", || {
            Ok(Ending::Passed(guide::run(false)?))
        }));
        steps.push(step("real kernel drivers", || machines(install)));
        steps.push(step("documentation", documentation));
        steps.push(step("cargo deny", deny));
    }
    conclude(&steps, &report)
}

/// Features that are disabled by default and nevertheless tested.
const FEATURES: &str = "reconstruction/gpu,reconstruction/onnx";

fn step(name: &'static str, work: impl FnOnce() -> Result<Ending>) -> Step {
    println!("\n== {name}");
    let start = Instant::now();
    let ending = work().unwrap_or_else(|error| {
        println!("{error:#}");
        Ending::Failed(String::new())
    });
    Step {
        name,
        ending,
        took: start.elapsed(),
    }
}

fn format_check() -> Result<Ending> {
    process::run(cargo()?.args(["fmt", "--all", "--check"]))
        .context("the code is not formatted; `cargo fmt --all` mends it")?;
    Ok(Ending::Passed(String::new()))
}

fn clippy() -> Result<Ending> {
    process::run(cargo()?.args([
        "clippy",
        "--workspace",
        "--features",
        FEATURES,
        "--all-targets",
        "--locked",
        "--",
        "-D",
        "warnings",
    ]))?;
    Ok(Ending::Passed(String::new()))
}

fn tests(quick: bool, python: Option<std::path::PathBuf>, report: &mut Report) -> Result<Ending> {
    let mut command = cargo()?;
    command.args(["test", "--workspace", "--features", FEATURES]);
    command.args(["--locked", "--no-fail-fast"]);
    if quick {
        command.args(["--lib", "--bins"]);
    }
    command.args(["--", "--show-output"]);
    if let Some(python) = python {
        command.env("PAWS_PYTHON", python);
    }
    if setup::installs_packages()? {
        // Vulkan is there: tests of the GPU fail where it does not work, and do not skip.
        command.env("PAWS_GPU_REQUIRED", "1");
    }
    match process::data_folder()? {
        Some(folder) => {
            println!("real recordings: {}", folder.display());
            command.env("PAWS_DATA", folder);
        }
        None => println!("real recordings: none; see `cargo xtask help`"),
    }

    let mut child = command
        .stdout(Stdio::piped())
        .spawn()
        .with_context(|| format!("starting `{}`", process::line(&command)))?;
    let status = follow(&mut child, PATIENCE, |line| {
        if report.take(line) {
            println!("{line}");
        }
    })?;
    if !status.success() {
        bail!("`{}` ended with {status}", process::line(&command));
    }
    Ok(Ending::Passed(report.counts()))
}

/// How long the output may be silent before it is looked whether the test runner has ended.
const PATIENCE: Duration = Duration::from_secs(10);

/// Reads what a program prints until it has ended, line by line. A process that it leaves behind,
/// as a test that fails may, holds the output open; `patience` after its last line it is not waited
/// for.
fn follow(child: &mut Child, patience: Duration, mut take: impl FnMut(&str)) -> Result<ExitStatus> {
    let output = child.stdout.take().context("no output to read")?;
    let lines = lines_of(output);
    let mut ended = None;
    loop {
        match lines.recv_timeout(patience) {
            Ok(line) => take(&String::from_utf8_lossy(
                &line.context("reading its output")?,
            )),
            Err(RecvTimeoutError::Disconnected) => return child.wait().context("waiting for it"),
            Err(RecvTimeoutError::Timeout) => match ended {
                Some(status) => {
                    take("a process was left behind, which is not waited for");
                    return Ok(status);
                }
                None => ended = child.try_wait().context("waiting for it")?,
            },
        }
    }
}

/// The lines of an output, read on a thread of its own.
fn lines_of(output: impl Read + Send + 'static) -> Receiver<std::io::Result<Vec<u8>>> {
    let (to, lines) = sync_channel(1024);
    std::thread::spawn(move || {
        for line in BufReader::new(output).split(b'\n') {
            if to.send(line).is_err() {
                return;
            }
        }
    });
    lines
}

/// The Python package of the simulators in an environment of its own.
fn python_package() -> Result<Ending> {
    Ok(match wheel::interpreters() {
        Ok(interpreters) => Ending::Passed(wheel::test(&interpreters)?),
        Err(error) => {
            println!("{error:#}");
            Ending::LeftOut("no environment for it, see above".into())
        }
    })
}

/// The short form of the tests in virtual machines; their kernel is built if it is not there.
fn machines(install: bool) -> Result<Ending> {
    let ran = vm::run(install, true, false, false, Some(FEATURES), &[])?;
    Ok(match ran {
        vm::Ran::Passed => Ending::Passed(String::new()),
        vm::Ran::Skipped => Ending::LeftOut("no virtual machine here, see above".into()),
    })
}

fn documentation() -> Result<Ending> {
    let mut command = cargo()?;
    command
        .args(["doc", "--workspace", "--no-deps", "--locked"])
        .env("RUSTDOCFLAGS", "-D warnings");
    process::run(&mut command)?;
    Ok(Ending::Passed(String::new()))
}

fn deny() -> Result<Ending> {
    if !process::succeeds(cargo()?.args(["deny", "--version"])) {
        let how = "the tool is not here; `cargo install --locked cargo-deny` gets it";
        println!("left out: {how}");
        return Ok(Ending::LeftOut(how.into()));
    }
    // Without a network the list of advisories cannot be had; the other rules need none.
    let advisories = process::succeeds(cargo()?.args(["deny", "--locked", "fetch", "db"]));
    let mut check = cargo()?;
    check.args(["deny", "--locked", "check"]);
    let note = if advisories {
        ""
    } else {
        check.args(["bans", "licenses", "sources"]);
        "without advisories: their list could not be fetched"
    };
    process::run(&mut check)?;
    Ok(Ending::Passed(note.into()))
}

fn conclude(steps: &[Step], report: &Report) -> Result<()> {
    if !report.skipped.is_empty() {
        println!("\nTests that skipped themselves, or a part of their work:");
        for (test, reason) in &report.skipped {
            println!("  {test}: {reason}");
        }
    }
    if !report.failed.is_empty() {
        println!("\nTests that failed:");
        for test in &report.failed {
            println!("  {test}");
        }
    }
    println!();
    for step in steps {
        let (word, text) = match &step.ending {
            Ending::Passed(text) => ("ok", text),
            Ending::LeftOut(text) => ("left out", text),
            Ending::Failed(text) => ("FAILED", text),
        };
        let row = format!("{:16} {word:9} {:>12}  {text}", step.name, human(step.took));
        println!("{}", row.trim_end());
    }
    let failed: Vec<&str> = steps
        .iter()
        .filter(|step| matches!(step.ending, Ending::Failed(_)))
        .map(|step| step.name)
        .collect();
    if !failed.is_empty() {
        bail!("{}", failed.join(", "));
    }
    println!("\nAll that ran has passed.");
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::process::Command;

    use super::*;

    #[test]
    fn a_process_that_is_left_behind_is_not_waited_for() {
        let mut child = Command::new("sh")
            .args(["-c", "sleep 600 & echo $!; exit 3"])
            .stdout(Stdio::piped())
            .spawn()
            .expect("a shell");
        let mut lines = Vec::new();
        let status = follow(&mut child, Duration::from_millis(100), |line| {
            lines.push(line.to_owned());
        });
        assert_eq!(status.expect("an end").code(), Some(3));
        let (left, said) = lines.split_first().expect("lines");
        assert_eq!(said, ["a process was left behind, which is not waited for"]);
        let killed = Command::new("kill").arg(left).status();
        assert!(killed.is_ok_and(|status| status.success()));
    }
}
