//! Provenance of a measurement: machine, load by others, date, commit, command.

use std::fs;
use std::process::Command;
use std::sync::OnceLock;
use std::thread;
use std::time::{SystemTime, UNIX_EPOCH};

use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};
use session_archive::time::CivilTime;

use crate::meter;

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
    command.extend(arguments(args));
    Ok(json!({
        "machine": format!("{cpus} CPUs, {}", processor()),
        "load_of_others": load_of_others()?,
        "system": format!("Linux {}", first_line("/proc/sys/kernel/osrelease")),
        "build": if cfg!(debug_assertions) { "debug" } else { "release" },
        "date": date.split('T').next().unwrap_or_default(),
        "commit": commit(),
        "command": command.join(" "),
    }))
}

/// Processor time at the begin of the program: of the machine, busy and in all, and its own, s.
static BEGIN: OnceLock<[f64; 3]> = OnceLock::new();

/// Begins to measure what others need of the machine.
pub(crate) fn begin() -> Result<()> {
    let now = processor_times_s()?;
    BEGIN.get_or_init(|| now);
    Ok(())
}

/// Share of the machine's processors that others used since [`begin`], of which wall times suffer.
fn load_of_others() -> Result<f64> {
    let now = processor_times_s()?;
    let begin = BEGIN.get().copied().unwrap_or_default();
    let [busy, all, own] = [0, 1, 2].map(|k| now[k] - begin[k]);
    let share = ((busy - own) / all.max(1e-9)).max(0.0);
    Ok((share * 1000.0).round() / 1000.0)
}

fn processor_times_s() -> Result<[f64; 3]> {
    /// Of the numbers in `/proc/stat`, on every Linux that this runs on (USER_HZ).
    const TICKS_PER_S: f64 = 100.0;
    let text = fs::read_to_string("/proc/stat").context("reading /proc/stat")?;
    // proc(5): user, nice, system, idle, iowait, irq, softirq, steal; guests count in user.
    let first = text.lines().next().unwrap_or_default();
    let fields = first.split_whitespace().skip(1).take(8);
    let ticks: Vec<f64> = fields.filter_map(|field| field.parse().ok()).collect();
    ensure!(ticks.len() == 8, "/proc/stat is not as expected: {first}");
    let all: f64 = ticks.iter().sum();
    let idle = ticks[3] + ticks[4];
    let own_s = meter::cpu_s() + meter::children_cpu_s()?;
    Ok([(all - idle) / TICKS_PER_S, all / TICKS_PER_S, own_s])
}

/// Arguments as another machine understands them: without the output folder, and of paths the last
/// part.
fn arguments(args: &[String]) -> Vec<String> {
    let mut all = Vec::new();
    let mut rest = args.iter();
    while let Some(argument) = rest.next() {
        if argument == "--out" {
            rest.next();
            continue;
        }
        all.push(argument.rsplit('/').next().unwrap_or(argument).to_owned());
    }
    all
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_have_no_path_of_this_machine() {
        let args = [
            "--only",
            "sizes",
            "--out",
            "/tmp/a",
            "--scene",
            "/tmp/b/walk.scene",
            "--quick",
        ];
        assert_eq!(
            arguments(&args.map(str::to_owned)),
            ["--only", "sizes", "--scene", "walk.scene", "--quick"]
        );
    }
}
