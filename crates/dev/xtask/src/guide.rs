//! The commands of the pages that a new user follows, run as they are written.
//!
//! Every line `$ COMMAND` of a ```` ```console ```` block of [`PAGES`] is run, in order, by one
//! shell per page that stops at the first failure: in a fresh clone of what is committed, with an
//! empty home. The short form leaves out what builds and installs (`cargo`, `git`) and finds the
//! programs that are built already, also for `cargo run`; nothing else differs. `cargo xtask test`
//! is left out of both: it runs this.

use std::fs;
use std::path::Path;
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};

use crate::process::{self, human, program_folder, root};
use crate::setup::{self, Purpose};

/// The pages with commands to follow.
const PAGES: [&str; 2] = ["README.md", "docs/getting-started.md"];

/// What the pages make.
const MADE: [&str; 6] = [
    "plaza.png",
    "recording.html",
    "first.html",
    "first.ply",
    "first.txt",
    "film.html",
];

/// Runs all pages with their builds.
pub(crate) fn whole(install: bool) -> Result<()> {
    setup::system_packages(&[Purpose::Build, Purpose::Video], install)?;
    println!("{}", run(true)?);
    Ok(())
}

/// Runs all pages; `whole`: with the builds. What was done.
///
/// # Errors
/// A command fails, or what the pages make is not there.
pub(crate) fn run(whole: bool) -> Result<String> {
    let start = std::time::Instant::now();
    let folder = std::env::temp_dir().join(format!("paws-guide-{}", std::process::id()));
    let done = follow(&folder, whole);
    let removed = fs::remove_dir_all(&folder);
    let count = done?;
    removed.with_context(|| format!("removing {}", folder.display()))?;
    Ok(format!("{count} commands in {}", human(start.elapsed())))
}

fn follow(folder: &Path, whole: bool) -> Result<usize> {
    let (clone, home) = (folder.join("clone"), folder.join("home"));
    fs::create_dir_all(&home).with_context(|| format!("making {}", home.display()))?;
    let mut git = Command::new("git");
    git.args(["clone", "--quiet", "--local"])
        .arg(root()?)
        .arg(&clone);
    process::run(&mut git)?;
    let mut count = 0;
    for page in PAGES {
        let text =
            fs::read_to_string(root()?.join(page)).with_context(|| format!("reading {page}"))?;
        let commands: Vec<String> = commands(&text)
            .filter_map(|command| to_run(command, whole))
            .collect();
        ensure!(!commands.is_empty(), "{page} has no commands");
        count += commands.len();
        let mut shell = Command::new("bash");
        shell
            .args(["-e", "-u", "-x", "-c", &commands.join("\n")])
            .current_dir(&clone)
            .env("HOME", &home)
            .env_remove("PAWS_LIBRARY")
            .env("PATH", search_path(whole)?);
        if whole {
            // The toolchain is the user's, wherever it keeps its things.
            for (name, usual) in [("CARGO_HOME", ".cargo"), ("RUSTUP_HOME", ".rustup")] {
                let home = std::env::var_os("HOME").unwrap_or_default();
                let folder =
                    std::env::var_os(name).map_or(Path::new(&home).join(usual), Into::into);
                shell.env(name, folder);
            }
        }
        let status = shell
            .status()
            .with_context(|| format!("starting a shell for {page}"))?;
        if !status.success() {
            bail!(
                "a command of {page} ended with {status}; it is the last one above that begins with +"
            );
        }
    }
    for made in MADE {
        let path = clone.join(made);
        let length = fs::metadata(&path).map_or(0, |found| found.len());
        ensure!(length > 0, "the commands made no {made}");
    }
    Ok(count)
}

/// Where programs are found: in the short form also those of this build.
fn search_path(whole: bool) -> Result<std::ffi::OsString> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let mut folders: Vec<_> = std::env::split_paths(&path).collect();
    if !whole {
        folders.insert(0, program_folder()?);
    }
    std::env::join_paths(folders).context("putting PATH together")
}

/// What is run for a command of a page, if anything is.
fn to_run(command: &str, whole: bool) -> Option<String> {
    if command == "cargo xtask test" {
        return None;
    }
    let is_build = matches!(command.split_whitespace().next(), Some("cargo" | "git"));
    if whole || !is_build {
        return Some(command.to_owned());
    }
    let arguments = command.strip_prefix("cargo run --release -p rig-sim -- ")?;
    Some(format!("paws-rig-sim {arguments}"))
}

/// The commands of a page's console blocks.
fn commands(page: &str) -> impl Iterator<Item = &str> {
    let mut is_console = false;
    page.lines().filter_map(move |line| {
        if let Some(kind) = line.strip_prefix("```") {
            is_console = kind == "console";
            return None;
        }
        line.strip_prefix("$ ").filter(|_| is_console)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_those_of_console_blocks() {
        let page =
            "text\n$ no\n```console\n$ cargo build\n$ paws list\noutput\n```\n```sh\n$ no\n```\n";
        assert_eq!(
            commands(page).collect::<Vec<_>>(),
            ["cargo build", "paws list"]
        );
    }

    #[test]
    fn the_short_form_builds_nothing() {
        let short = |command| to_run(command, false);
        assert_eq!(short("cargo xtask demo"), None);
        assert_eq!(short("git clone here"), None);
        assert_eq!(short("paws list").as_deref(), Some("paws list"));
        let run = "cargo run --release -p rig-sim -- preview --scene plaza";
        assert_eq!(
            short(run).as_deref(),
            Some("paws-rig-sim preview --scene plaza")
        );
        assert_eq!(to_run(run, true).as_deref(), Some(run));
        assert_eq!(to_run("cargo xtask test", true), None, "it runs this");
    }
}
