//! `kills`: a recorder is killed a thousand times. Checks that everything reported durable is on
//! disk, and measures the loss.
//!
//! Each kill is a `pawsd record` process with two small synthetic cameras and their IMUs in real
//! time, ended by SIGKILL at a random instant. The session that is left must open, hold everything
//! that was promised, show the right number in every frame and the right values in every IMU
//! sample, and be recovered to a sound copy. What is lost is the time from the newest sample that
//! every stream has to the kill; it is bounded by the length of a chunk, the latency of the encoder
//! and that of an IMU batch. A kill leaves what the system has cached; loss by a power cut is
//! measured by `archive`.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

use anyhow::{Context as _, Result, bail};
use charts::{Axis, Bins, Chart, Series};
use harness::kills::{self, KillResult, Plan};
use harness::program::pawsd;
use serde_json::{Value, json};

use crate::meter::quantile;
use crate::stamp;

/// The chunk length that the daemon has by default, ms.
const CHUNK_MS: f64 = 500.0;

/// Runs the benchmark: `[--quick] [--seed N] [--out DIR]`.
///
/// # Errors
/// Bad arguments, `pawsd` cannot be built, or a kill left something that it must not.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let (mut kills, mut seed, mut out) = (1000, 1, PathBuf::from("docs/benchmarks"));
    let mut rest = args.iter();
    while let Some(argument) = rest.next() {
        match argument.as_str() {
            "--quick" => kills = 50,
            "--seed" => {
                seed = rest
                    .next()
                    .context("--seed needs a number")?
                    .parse()
                    .context("--seed")?;
            }
            "--out" => out = rest.next().context("--out needs a folder")?.into(),
            other => bail!("unknown argument {other:?}, expected --quick, --seed N or --out DIR"),
        }
    }
    let stamp = stamp::stamp("kills", args)?;
    let folder = tempfile::tempdir().context("making a folder")?;
    let plan = Plan {
        kills,
        parallel: 4,
        seed,
        after_ms: (50, 2500),
        pawsd: pawsd()?,
        folder: folder.path().to_owned(),
    };
    let done = AtomicU32::new(0);
    let results = kills::run(&plan, &|result| {
        let done = 1 + done.fetch_add(1, Ordering::Relaxed);
        if let Err(error) = result {
            eprintln!("{error:#}");
        }
        if done.is_multiple_of(50) {
            println!("{done} of {kills}");
        }
    });
    let (good, bad): (Vec<_>, Vec<_>) = results.into_iter().partition(Result::is_ok);
    let killed: Vec<KillResult> = good.into_iter().flatten().collect();
    write(&out, &plan, &stamp, &killed, bad.len())?;
    if !bad.is_empty() {
        bail!(
            "{} of {kills} kills went wrong; their sessions are in {}",
            bad.len(),
            folder.keep().display()
        );
    }
    Ok(())
}

fn write(out: &Path, plan: &Plan, stamp: &Value, killed: &[KillResult], bad: usize) -> Result<()> {
    let sum = |of: fn(&KillResult) -> u64| killed.iter().map(of).sum::<u64>();
    let mut lost: Vec<f64> = killed.iter().filter_map(lost_ms).collect();
    lost.sort_by(f64::total_cmp);
    let share = |part: f64| (!lost.is_empty()).then(|| quantile(&lost, part));
    let nothing = killed.len() - lost.len();
    println!(
        "{} kills, {bad} went wrong; {} messages were promised and {} found; {} frames and {} IMU samples are right",
        plan.kills,
        sum(|k| k.promised),
        sum(|k| k.messages),
        sum(|k| k.frames),
        sum(|k| k.imu_samples),
    );
    println!(
        "lost at the end: median {:.0} ms, most {:.0} ms; {nothing} kills came before the first chunk",
        share(0.5).unwrap_or(f64::NAN),
        share(1.0).unwrap_or(f64::NAN),
    );
    let report = json!({
        "benchmark": "kills",
        "stamp": stamp,
        "kills": plan.kills,
        "seed": plan.seed,
        "after_ms": [plan.after_ms.0, plan.after_ms.1],
        "parallel": plan.parallel,
        "went_wrong": bad,
        "messages_promised": sum(|k| k.promised),
        "messages_found": sum(|k| k.messages),
        "frames_decoded_and_right": sum(|k| k.frames),
        "imu_samples_right": sum(|k| k.imu_samples),
        "missing_by_gap_records": sum(|k| k.missing),
        "ended_inside_a_record": sum(|k| u64::from(k.cut_off)),
        "before_the_first_chunk": nothing,
        "lost_ms": {
            "median": share(0.5), "p90": share(0.9), "p99": share(0.99), "most": share(1.0),
            "chunk": CHUNK_MS,
        },
    });
    fs::create_dir_all(out).with_context(|| format!("making {}", out.display()))?;
    for (name, text) in [
        ("kills.json", format!("{report:#}\n")),
        ("kills.svg", histogram(&lost, &stamp::line(stamp))),
    ] {
        let path = out.join(name);
        fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
        println!("wrote {}", path.display());
    }
    Ok(())
}

fn lost_ms(killed: &KillResult) -> Option<f64> {
    killed.lost_ns.map(|ns| ns as f64 * 1e-6)
}

fn histogram(lost_ms: &[f64], footnote: &str) -> String {
    Chart::new("Lost by a kill")
        .subtitle("from the newest sample that every stream has to the kill")
        .footnote(footnote)
        .x_axis(Axis::linear("lost", "ms").include(0.0))
        .y_axis(Axis::linear("kills", "").include(0.0))
        .series(Series::histogram(
            "kills",
            lost_ms.iter().copied(),
            Bins::Width(25.0),
        ))
        .vline(CHUNK_MS, "a chunk")
        .to_svg(720, 320)
}
