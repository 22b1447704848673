//! `paws-reconstruct evaluate`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::{Args, CommandFactory, ValueEnum};
use command_line::output::print;
use reconstruction::evaluate::runs::{Cost, Run, Runs};
use reconstruction::evaluate::{Alignment, Delta, Settings, clip_to_recording, evaluate, files};
use serde_json::Value;

#[derive(Args)]
pub(crate) struct Arguments {
    /// Trajectories: TUM, KITTI or EuRoC files, or scene bundles. For a bundle the ground truth is
    /// used from its first row to its last.
    #[arg(required = true, value_name = "ESTIMATE")]
    estimates: Vec<PathBuf>,
    /// Ground-truth trajectory, or the truth of a simulated session (truth.CAMERA.csv).
    #[arg(long, value_name = "FILE")]
    truth: PathBuf,
    /// Alignment of an estimate with the ground truth.
    #[arg(long, value_enum, default_value_t = AlignmentName::Se3)]
    align: AlignmentName,
    /// Maximum time difference of poses that are compared, milliseconds.
    #[arg(long, value_name = "MS", default_value_t = 10.0, value_parser = positive)]
    tolerance_ms: f64,
    /// Maximum time between poses that is not a gap, milliseconds.
    #[arg(long, value_name = "MS", default_value_t = 250.0, value_parser = positive)]
    longest_step_ms: f64,
    /// Covered part of the ground truth's time below which a run counts as lost, percent.
    #[arg(long, value_name = "PERCENT", default_value_t = 95.0, value_parser = positive)]
    least_completion: f64,
    /// Lengths of the segments over which drift (RPE) is measured: true path length (10m), time
    /// (5s) or compared poses (1f). evo_rpe takes 1f with --consecutive by default.
    #[arg(long, value_name = "LENGTH", value_delimiter = ',', default_value = "10m,5s", value_parser = delta)]
    over: Vec<Delta>,
    /// Measure drift over consecutive segments, not from every pose: the pairs of evo_rpe without
    /// --all_pairs (in metres with --pairs_from_reference). From every pose, a segment in metres
    /// ends at the first pose beyond its length; with --all_pairs evo takes the pose nearest to it,
    /// if within 10 %.
    #[arg(long)]
    consecutive: bool,
    /// Which trajectory of a bundle: `trajectory`, `trajectory-causal`. Default: the first of these
    /// that is there.
    #[arg(long, value_name = "OUTPUT")]
    output: Option<String>,
    /// Output of `run --json` for each trajectory, for time and memory; in the same order.
    #[arg(long, value_name = "FILE")]
    cost: Vec<PathBuf>,
    /// Print JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum AlignmentName {
    /// Best rigid fit
    Se3,
    /// Best fit with scale
    Sim3,
    /// No alignment
    None,
    /// By the first poses
    First,
}

fn positive(text: &str) -> Result<f64, String> {
    let number = text.parse().ok().filter(|n: &f64| *n >= 0.0 && *n <= 1e9);
    number.ok_or_else(|| "expected a number from 0 to 1e9".to_owned())
}

fn delta(text: &str) -> Result<Delta, String> {
    let number = |text: &str| {
        text.parse()
            .ok()
            .filter(|n: &f64| *n > 0.0 && n.is_finite())
    };
    let metres = || Some(Delta::Meters(number(text.strip_suffix('m')?)?));
    let seconds = || Some(Delta::Seconds(number(text.strip_suffix('s')?)?));
    let poses = || match text.strip_suffix('f')?.parse() {
        Ok(poses) if poses > 0 => Some(Delta::Poses(poses)),
        _ => None,
    };
    let found = metres().or_else(seconds).or_else(poses);
    found.ok_or_else(|| {
        "expected metres, seconds or a number of poses, as in 10m, 5s or 1f".to_owned()
    })
}

pub(crate) fn run(arguments: &Arguments) -> Result<ExitCode> {
    let (costs, estimates) = (arguments.cost.len(), arguments.estimates.len());
    if costs != 0 && costs != estimates {
        let message =
            format!("found {costs} --cost, expected none or {estimates}, one for each estimate");
        let kind = clap::error::ErrorKind::WrongNumberOfValues;
        crate::Arguments::command().error(kind, message).exit();
    }
    let settings = Settings {
        alignment: match arguments.align {
            AlignmentName::Se3 => Alignment::Se3,
            AlignmentName::Sim3 => Alignment::Sim3,
            AlignmentName::None => Alignment::None,
            AlignmentName::First => Alignment::First,
        },
        tolerance_ns: (1e6 * arguments.tolerance_ms).round() as i64,
        max_step_ns: (1e6 * arguments.longest_step_ms).round() as i64,
        deltas: arguments.over.clone(),
        overlapping: !arguments.consecutive,
    };
    let truth = files::load(&arguments.truth, arguments.output.as_deref())?;
    let mut runs = Vec::new();
    for (k, path) in arguments.estimates.iter().enumerate() {
        let estimate = files::load(path, arguments.output.as_deref())?;
        let (estimated, truth) = files::comparable(&estimate, &truth, path)?;
        let recorded = estimate
            .has_row_per_set
            .then(|| clip_to_recording(truth, estimated));
        let truth = recorded.as_ref().unwrap_or(truth);
        let cost = arguments.cost.get(k).map(|path| cost(path)).transpose()?;
        runs.push(Run {
            name: name(path, &arguments.estimates),
            evaluation: evaluate(estimated, truth, &settings),
            cost: cost.unwrap_or_default(),
        });
    }
    let runs = Runs::new(runs, 0.01 * arguments.least_completion);
    if arguments.json {
        print(serde_json::to_string_pretty(&runs)?)?;
    } else {
        print(runs.table().trim_end())?;
    }
    Ok(ExitCode::from(if runs.lost == 0 { 0 } else { 3 }))
}

/// The name of its file or folder if that is unique; else the path.
fn name(path: &Path, all: &[PathBuf]) -> String {
    let same = all.iter().filter(|p| p.file_name() == path.file_name());
    let short = path.file_name().filter(|_| same.count() == 1);
    short
        .unwrap_or(path.as_os_str())
        .to_string_lossy()
        .into_owned()
}

/// Time and memory of the stages that compute trajectories, from lines of JSON.
fn cost(path: &Path) -> Result<Cost> {
    let shown = path.display();
    let text = plain_file::read_to_string(path, plain_file::DOCUMENT_LIMIT)
        .with_context(|| format!("reading {shown}"))?;
    let (mut seconds, mut peak_bytes) = (None, None);
    for line in text.lines().filter(|line| !line.trim().is_empty()) {
        let stage: Value = serde_json::from_str(line)
            .with_context(|| format!("expected what run --json prints in {shown}"))?;
        let has_run = stage["state"] == "ran";
        if !has_run
            || !matches!(
                stage["stage"].as_str(),
                Some("odometry" | "bundle-adjustment")
            )
        {
            continue;
        }
        seconds = stage["seconds"]
            .as_f64()
            .map(|s| s + seconds.unwrap_or(0.0))
            .or(seconds);
        peak_bytes = stage["peak_bytes"].as_u64().max(peak_bytes);
    }
    Ok(Cost {
        seconds,
        peak_bytes,
    })
}
