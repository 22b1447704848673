//! Checks a package: it is installed in the root, records there, and what it recorded is checked on
//! this machine.
//!
//! Two recordings of three cameras of 320x96: a simulated walk in virtual time, which nothing may
//! be missing of, and synthetic frames in real time, as on the rig. In real time an emulated
//! processor may be too slow, or this machine too busy; then the recording reports what it lost,
//! and this step shows it.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Instant;

use anyhow::{Context, Result, ensure};

use super::files::{output, read, write};
use super::root::Root;
use crate::process::{self, cargo, command, human};

/// The exit code of a recording that did all it was to do and says that something is missing.
const WITH_LOSS: i32 = 3;

/// Stands in the folder of recordings, for the test that none is ever deleted.
const KEPT: &str = "var/lib/paws/kept";

/// How long the recordings are, in seconds.
const SECONDS: &str = "2";

/// The smallest thing that is a rig, with cameras of this source.
fn configuration(source: &str) -> String {
    let camera = |name| {
        format!("[[camera]]\nname = {name:?}\ntrigger = \"smoke\"\nsource = {{ {source} }}\n\n")
    };
    format!(
        "[disk]\nreserve_gb = 0.1\n\n\
         [rig]\nfile = \"/usr/share/doc/pawsd/examples/rigs/example.toml\"\n\n{}",
        ["left_shoulder", "right_shoulder", "feet"]
            .map(camera)
            .concat()
    )
}

/// Installs, records, upgrades and purges; the recording is checked by this checkout's `paws`.
pub(super) fn run(root: &Root, package: &Path) -> Result<()> {
    root.make_runnable()?;
    let inside = root.folder().join("tmp/package.deb");
    fs::copy(package, &inside).with_context(|| format!("copying {}", package.display()))?;
    for left in ["var/lib/paws", "tmp/recorded"] {
        remove(&root.folder().join(left))?;
    }

    let dpkg = |name: &str, arguments: &[&str]| -> Result<()> {
        step(name, || {
            quiet(root.command("dpkg")?.args(arguments)).map(|_| String::new())
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

/// Every command that the program knows has its manual page.
fn commands_are_documented(root: &Root) -> Result<()> {
    let help = output(root.command("pawsd")?.arg("--help"))?;
    let commands = commands(&help);
    ensure!(!commands.is_empty(), "`pawsd --help` lists no commands");
    for command in commands {
        let page = format!("usr/share/man/man1/pawsd-{command}.1.gz");
        ensure!(
            root.folder().join(&page).is_file(),
            "`pawsd {command}` has no manual page /{page}"
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
        quiet(root.command("pawsd")?.arg("check")).map(last_line)
    })?;
    let size = "width = 320, height = 96";
    record_one(
        root,
        "walk",
        &format!("kind = \"sim\", scene = \"pavement\", seconds = 4, rate_hz = 10, {size}"),
        &["--virtual"],
    )?;
    record_one(
        root,
        "live",
        &format!("kind = \"synthetic\", rate_hz = 15, imu_rate_hz = 200, {size}"),
        &[],
    )
}

/// One recording. In real time loss is shown and is no failure.
fn record_one(root: &Root, name: &str, source: &str, how: &[&str]) -> Result<()> {
    let file = format!("/tmp/{name}.toml");
    write(&root.folder().join(&file[1..]), configuration(source))?;
    step(name, || {
        let mut record = root.command("pawsd")?;
        record
            .args(["record", "--config", &file, "--out", "/tmp/recorded"])
            .args(["--seconds", SECONDS, "--name", name])
            .args(how);
        let ended = record.output().context("starting the recording")?;
        let messages = String::from_utf8_lossy(&ended.stderr);
        let with_loss = ended.status.code() == Some(WITH_LOSS);
        ensure!(
            ended.status.success() || (with_loss && how.is_empty()),
            "`{}` ended with {}:\n{messages}",
            process::line(&record),
            ended.status
        );
        let said = messages.lines().rfind(|line| line.starts_with("finished"));
        Ok(said.unwrap_or_default().to_owned())
    })
}

/// Imports and validates with the tool of this machine: what was recorded by one processor is read
/// by another.
fn check_here(root: &Root) -> Result<()> {
    process::run(cargo()?.args(["build", "--quiet", "--locked", "--package=collector"]))?;
    let paws = process::program_folder()?.join("paws");
    let library = root.folder().with_file_name("library");
    remove(&library)?;
    let paws = |arguments: &[&str]| {
        let mut paws = command(&paws)?;
        output(paws.args(arguments).arg("--library").arg(&library)).map(last_line)
    };
    let recorded = root.folder().join("tmp/recorded");
    let recorded = recorded
        .to_str()
        .context("a folder whose name is no text")?;
    step("import", || paws(&["import", recorded]))?;
    step("validate", || paws(&["validate", "walk"]))
}

/// One line about one step.
fn step(name: &str, work: impl FnOnce() -> Result<String>) -> Result<()> {
    let start = Instant::now();
    let said = work().with_context(|| format!("the step `{name}`"))?;
    println!("  {name:10} {:>8}  {said}", human(start.elapsed()));
    Ok(())
}

/// What the program prints; its messages only if it fails.
fn quiet(command: &mut Command) -> Result<String> {
    let ended = command
        .output()
        .with_context(|| format!("starting `{}`", process::line(command)))?;
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    ensure!(
        ended.status.success(),
        "`{}` ended with {}:\n{}{}",
        process::line(command),
        ended.status,
        text(&ended.stdout),
        text(&ended.stderr)
    );
    Ok(text(&ended.stdout))
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
