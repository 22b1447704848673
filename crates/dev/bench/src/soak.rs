//! `soak`: an hour in virtual time. Checks that memory is constant and every sample is stored.
//!
//! Three small synthetic cameras (64x32 per eye, 30 Hz) with their IMUs (200 Hz) go through the
//! whole daemon: clock maps, encoders, recorder, archive with its syncs. Small images make an hour
//! short and do not affect the result: growth would depend on the number of samples. The memory of
//! the process is read with every chunk.

use std::fs;

use anyhow::{Context as _, Result, ensure};
use charts::{Axis, Chart, Series};
use harness::rig::Rig;
use harness::soak::{SoakResult, soak};
use serde_json::json;

use crate::arguments::Arguments;
use crate::stamp;

/// Maximum growth of the peak memory after the first minute, bytes.
const GROWTH_LIMIT: u64 = 10 << 20;

/// Runs the benchmark: `[--quick] [--out DIR]`.
///
/// # Errors
/// Bad arguments, the recording fails, a sample is missing, or the memory grows beyond the limit.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let Arguments { quick, out } = Arguments::parse(args)?;
    let seconds = if quick { 300 } else { 3600 };
    let stamp = stamp::stamp("soak", args)?;
    let rig = Rig::small(3);
    let folder = tempfile::tempdir().context("making a folder")?;
    let soaked = soak(&rig, seconds, folder.path())?;
    soaked.check_counts(&rig, seconds)?;
    let growth = soaked.growth(60.0)?;
    let speed = f64::from(seconds) / soaked.wall_s;
    println!(
        "{seconds} s of session in {:.1} s: {speed:.0} times real time",
        soaked.wall_s
    );
    println!(
        "after the first minute the memory grew by {} KiB",
        growth / 1024
    );

    let streams = soaked.report.streams.iter();
    let samples: serde_json::Map<_, _> = streams
        .map(|(name, stream)| (name.clone(), stream.samples.into()))
        .collect();
    // A hundred and twenty readings are as informative as seven thousand.
    let step = soaked.samples.len().div_ceil(120).max(1);
    let looks = soaked.samples.iter().step_by(step);
    let report = json!({
        "benchmark": "soak",
        "stamp": stamp,
        "rig": {
            "cameras": rig.cameras, "width": rig.width, "height": rig.height,
            "rate_hz": rig.rate_hz, "imu_rate_hz": rig.imu_rate_hz, "encoder": rig.encoder,
        },
        "session_s": seconds,
        "wall_s": soaked.wall_s,
        "times_real_time": speed,
        "bytes": soaked.report.bytes,
        "messages": soaked.report.messages,
        "samples": samples,
        "counts_exact": true,
        "growth_after_first_minute_bytes": growth,
        "growth_limit_bytes": GROWTH_LIMIT,
        "memory": looks.map(|look| json!({
            "session_s": look.session_s,
            "resident_bytes": look.memory.resident,
            "peak_bytes": look.memory.peak,
        })).collect::<Vec<_>>(),
    });
    fs::create_dir_all(&out).with_context(|| format!("making {}", out.display()))?;
    for (name, text) in [
        ("soak.json", format!("{report:#}\n")),
        ("soak.svg", chart(&soaked, &stamp::line(&stamp))),
    ] {
        let path = out.join(name);
        fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
        println!("wrote {}", path.display());
    }
    ensure!(
        growth < GROWTH_LIMIT,
        "the memory grew by {growth} bytes after the first minute, expected less than {GROWTH_LIMIT}"
    );
    Ok(())
}

fn chart(soaked: &SoakResult, footnote: &str) -> String {
    const MIB: f64 = (1 << 20) as f64;
    let looks = &soaked.samples;
    let at_minute = looks.iter().find(|look| look.session_s >= 60.0);
    let base = at_minute.map_or(0.0, |look| look.memory.resident as f64 / MIB);
    let line = |name, of: fn(&harness::soak::Memory) -> u64| {
        Series::line(
            name,
            looks
                .iter()
                .map(|l| (l.session_s, of(&l.memory) as f64 / MIB)),
        )
    };
    Chart::new("Memory of a recording in virtual time")
        .subtitle(
            "three synthetic cameras of 64x32 per eye at 30 Hz and three IMUs at 200 Hz; whole process",
        )
        .footnote(footnote)
        .x_axis(Axis::time("time in session"))
        .y_axis(Axis::linear("memory", "MiB").include(0.0))
        .series(line("resident", |memory| memory.resident))
        .series(line("peak", |memory| memory.peak))
        .hline(base + GROWTH_LIMIT as f64 / MIB, "limit")
        .to_svg(720, 320)
}
