//! Provenance of a measurement: machine, date, commit, command.

use std::fs;
use std::process::Command;
use std::thread;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result};
use serde_json::{Value, json};
use session_archive::time::CivilTime;

/// Machine, date, commit and command of this run of the benchmark `name`.
#[expect(
    clippy::disallowed_methods,
    reason = "the date of a measurement is civil time"
)]
pub(crate) fn stamp(name: &str, args: &[String]) -> Result<Value> {
    let now = SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .context("reading the date")?;
    let date = CivilTime(now.as_nanos() as i64).to_string();
    let cpus = thread::available_parallelism().map_or(1, usize::from);
    let mut command = vec![format!("cargo xtask bench {name}")];
    // The output folder is left out: it is a path of this machine.
    command.extend(args.iter().filter(|a| *a == "--quick").cloned());
    Ok(json!({
        "machine": format!("{cpus} CPUs, {}", processor()),
        "system": format!("Linux {}", first_line("/proc/sys/kernel/osrelease")),
        "build": if cfg!(debug_assertions) { "debug" } else { "release" },
        "date": date.split('T').next().unwrap_or_default(),
        "commit": commit(),
        "command": command.join(" "),
    }))
}

/// The stamp in one line, for the foot of a chart.
pub(crate) fn line(stamp: &Value) -> String {
    let keys = ["machine", "date", "commit", "command"];
    let parts = keys.map(|key| stamp[key].as_str().unwrap_or_default().to_owned());
    parts.join("; ")
}

/// Commit and date of a stamp.
pub(crate) fn source(stamp: &Value) -> String {
    ["commit", "date"]
        .map(|key| stamp[key].as_str().unwrap_or("?"))
        .join(" ")
}

/// The processor's name, as reported by the kernel.
fn processor() -> String {
    let text = fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let name = text
        .lines()
        .find_map(|line| line.strip_prefix("model name"))
        .and_then(|rest| rest.split_once(':'))
        .map(|(_, name)| name.trim());
    name.unwrap_or(std::env::consts::ARCH).to_owned()
}

fn first_line(path: &str) -> String {
    let text = fs::read_to_string(path).unwrap_or_default();
    text.lines().next().unwrap_or("unknown").to_owned()
}

/// The commit, with a note if the tree has changes or new files in it. Results are not counted: in
/// a run of several benchmarks those of the first exist when the second begins.
fn commit() -> String {
    let git = |arguments: &[&str]| {
        let output = Command::new("git")
            .args(arguments)
            .current_dir(env!("CARGO_MANIFEST_DIR"))
            .output()
            .ok()
            .filter(|output| output.status.success())?;
        Some(String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    let Some(commit) = git(&["rev-parse", "--short=12", "HEAD"]) else {
        return "unknown".to_owned();
    };
    let sources = [":/", ":(top,exclude)docs/benchmarks"];
    let status = ["status", "--porcelain", "--untracked-files=normal", "--"];
    match git(&[&status[..], &sources[..]].concat()) {
        Some(changes) if changes.is_empty() => commit,
        _ => format!("{commit} with changes"),
    }
}
