//! What a package is worth: it is installed in the root, records there, and what it recorded is checked on
//! this machine.
//!
//! The recording runs in real time, as on the rig, of three small synthetic cameras and their IMUs: under
//! emulation a processor of ours does the work of a tenth of one.

use std::fs;
use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, ensure};

use super::files::{make_folder, output, read, write};
use super::root::Root;
use crate::process::{self, cargo, command, human};

/// Stands in the folder of recordings, for the test that none is ever deleted.
const KEPT: &str = "var/lib/paws/kept";

/// Three cameras of 320x96 with an IMU each; the smallest thing that is a rig.
const CONFIGURATION: &str = "\
[disk]
reserve_gb = 0.1

[[camera]]
name = \"left_shoulder\"
trigger = \"shoulders\"
source = { kind = \"synthetic\", width = 320, height = 96, rate_hz = 15, imu_rate_hz = 200 }

[[camera]]
name = \"right_shoulder\"
trigger = \"shoulders\"
source = { kind = \"synthetic\", width = 320, height = 96, rate_hz = 15, imu_rate_hz = 200 }

[[camera]]
name = \"feet\"
source = { kind = \"synthetic\", width = 320, height = 96, rate_hz = 15, imu_rate_hz = 200 }
";

/// Seconds that are recorded.
const SECONDS: &str = "2";

/// Installs, records, upgrades and purges; the recording is checked by this checkout's `paws`.
pub(super) fn run(root: &Root, package: &Path) -> Result<()> {
    let inside = root.folder().join("tmp/package.deb");
    fs::copy(package, &inside).with_context(|| format!("copying {}", package.display()))?;
    for left in ["var/lib/paws", "tmp/recorded"] {
        remove(&root.folder().join(left))?;
    }

    let dpkg = |name: &str, arguments: &[&str]| -> Result<()> {
        step(name, || {
            output(root.command("dpkg")?.args(arguments)).map(|_| String::new())
        })
    };
    dpkg("install", &["--install", "/tmp/package.deb"])?;
    let installed = accounts_are_there(root);
    let recorded = installed
        .and_then(|()| commands_are_documented(root))
        .and_then(|()| record(root))
        .and_then(|()| check_here(root));
    // Whatever came out, the root is left as it was.
    write(&root.folder().join(KEPT), "a recording\n")?;
    dpkg("upgrade", &["--install", "/tmp/package.deb"])?;
    dpkg("purge", &["--purge", "pawsd"])?;
    recorded?;
    for (path, expected) in [(KEPT, true), ("etc/paws", false), ("usr/bin/pawsd", false)] {
        ensure!(
            root.folder().join(path).exists() == expected,
            "after the purge, /{path} should {}",
            if expected {
                "still be there"
            } else {
                "be gone"
            }
        );
    }
    Ok(())
}

fn accounts_are_there(root: &Root) -> Result<()> {
    let users = read(&root.folder().join("etc/passwd"))?;
    ensure!(
        users.lines().any(|line| line.starts_with("paws:")),
        "the installation made no user `paws`"
    );
    ensure!(
        root.folder().join("var/lib/paws").is_dir(),
        "the installation made no folder /var/lib/paws"
    );
    Ok(())
}

/// Every command that the program knows stands in its manual page.
fn commands_are_documented(root: &Root) -> Result<()> {
    let help = output(root.command("pawsd")?.arg("--help"))?;
    let page = "deploy/debian/pawsd.1";
    let manual = read(&process::root()?.join(page))?;
    let commands = commands(&help);
    ensure!(!commands.is_empty(), "`pawsd --help` lists no commands");
    for command in commands {
        ensure!(
            manual.contains(&format!(".B pawsd {command}")),
            "`pawsd {command}` is missing in {page}"
        );
    }
    Ok(())
}

/// The words in the list under `Commands:`.
fn commands(help: &str) -> Vec<&str> {
    help.lines()
        .skip_while(|line| *line != "Commands:")
        .skip(1)
        .take_while(|line| line.starts_with("  "))
        .filter(|line| !line.starts_with("   "))
        .filter_map(|line| line.split_whitespace().next())
        .filter(|word| *word != "help")
        .collect()
}

fn record(root: &Root) -> Result<()> {
    step("check", || {
        output(root.command("pawsd")?.arg("check")).map(last_line)
    })?;
    write(&root.folder().join("tmp/smoke.toml"), CONFIGURATION)?;
    step("record", || {
        let record = ["record", "--config", "/tmp/smoke.toml"];
        let length = ["--out", "/tmp/recorded", "--seconds", SECONDS];
        output(root.command("pawsd")?.args(record).args(length)).map(last_line)
    })
}

/// Imports and validates with the tool of this machine: what was recorded by one processor is read by
/// another.
fn check_here(root: &Root) -> Result<()> {
    process::run(cargo()?.args(["build", "--locked", "--package=collector"]))?;
    let paws = process::program_folder()?.join("paws");
    let recorded = root.folder().join("tmp/recorded");
    let library = recorded.with_file_name("library");
    remove(&library)?;
    make_folder(&library)?;
    step("import", || {
        let mut import = command(&paws)?;
        import.arg("import").arg(&recorded);
        output(import.arg("--library").arg(&library)).map(last_line)
    })?;
    step("validate", || {
        let mut validate = command(&paws)?;
        validate.args(["validate", "--library"]).arg(&library);
        output(&mut validate).map(last_line)
    })
}

/// One line about one step.
fn step(name: &str, work: impl FnOnce() -> Result<String>) -> Result<()> {
    let start = Instant::now();
    let said = work().with_context(|| format!("the step `{name}`"))?;
    println!("  {name:10} {:>8}  {said}", human(start.elapsed()));
    Ok(())
}

fn last_line(text: String) -> String {
    let last = text.lines().rfind(|line| !line.trim().is_empty());
    last.unwrap_or_default().trim().to_owned()
}

fn remove(folder: &Path) -> Result<()> {
    if folder.exists() {
        fs::remove_dir_all(folder).with_context(|| format!("emptying {}", folder.display()))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_read_from_the_help() {
        let help = "\
Records stereo cameras.

Usage: pawsd <COMMAND>

Commands:
  check      Tell everything that is wrong
  record     Make one recording: it starts at once
             and ends by itself
  help       Print this message

Options:
  -h, --help  Print help
";
        assert_eq!(commands(help), ["check", "record"]);
    }
}
