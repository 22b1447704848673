//! `archive`: speed of writing and reading sessions, loss by a power cut, time to stop.
//!
//! 1. Writing: three cameras' access units of 60 to 100 kB through `SessionWriter`, into the page
//!    cache (syncs are counted and left out), onto the disk (with syncs), and into nothing (what
//!    the writer itself costs); beside it the bare `mcap` crate with chunks of the same size, the
//!    same payloads, no compression, all its checksums on. The runs alternate.
//! 2. Reading the same session from the page cache, all checksums checked: every entry, `verify`,
//!    and the crate's own reader that lends its bytes, on a segment loaded into memory that it may
//!    keep.
//! 3. Loss: power cuts at random instants, for chunk lengths from 0.1 to 1 s: the span of each
//!    stream that had arrived at the writer and is not on disk; and what chunks cost in bytes and
//!    syncs. What is still in an encoder, and a sync that has not come back, are not included.
//! 4. Closing the session's files: after sessions of different lengths in virtual time, on a real
//!    disk, with syncs. What `pawsd stop` does before that, such as draining encoders, is not
//!    included.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use serde_json::json;

use crate::{meter, stamp};

mod charts;
mod loss;
mod stop;
mod throughput;

/// Throughput into the page cache that the writer must reach, bytes per second.
const TARGET: f64 = 1e9;
/// Time that stopping may take, seconds.
const STOP_LIMIT_S: f64 = 0.5;

/// Amount of work.
struct Plan {
    /// Seconds of video per throughput run, about 14 MB each.
    write_s: f64,
    repetitions: usize,
    loss_s: f64,
    cuts: usize,
    /// Length of the sessions that are stopped, s, and number of each.
    stops: &'static [(f64, usize)],
}

const FULL: Plan = Plan {
    write_s: 100.0,
    repetitions: 7,
    loss_s: 30.0,
    cuts: 500,
    stops: &[(60.0, 9), (3600.0, 3)],
};

const QUICK: Plan = Plan {
    write_s: 10.0,
    repetitions: 2,
    loss_s: 5.0,
    cuts: 30,
    stops: &[(6.0, 2), (60.0, 1)],
};

/// Runs the benchmark: `[--quick] [--out DIR] [--disk DIR]`. The sessions are written below the
/// target folder unless `--disk` names another.
///
/// # Errors
/// Bad arguments, a folder that is in memory, or an I/O error. A target that is missed is a result
/// and no error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let mut plan = FULL;
    let mut out = PathBuf::from("docs/benchmarks");
    let mut disk = None;
    let mut rest = args.iter();
    while let Some(argument) = rest.next() {
        match argument.as_str() {
            "--quick" => plan = QUICK,
            "--out" => out = rest.next().context("--out needs a folder")?.into(),
            "--disk" => disk = Some(rest.next().context("--disk needs a folder")?.into()),
            other => bail!("unknown argument {other:?}, expected --quick, --out or --disk DIR"),
        }
    }
    let disk = meter::on_disk(disk)?;
    let stamp = stamp::stamp("archive", args)?;
    let rates = throughput::measure(&plan, &disk)?;
    let losses = loss::measure(&plan)?;
    let stops = stop::measure(&plan, &disk)?;

    fs::create_dir_all(&out).with_context(|| format!("making {}", out.display()))?;
    let report = json!({
        "benchmark": "archive",
        "stamp": stamp,
        "target_bytes_per_s": TARGET,
        "throughput": rates.json(),
        "loss": losses.iter().map(loss::Loss::json).collect::<Vec<_>>(),
        "stop_limit_s": STOP_LIMIT_S,
        "stop": stops.iter().map(stop::Stopping::json).collect::<Vec<_>>(),
    });
    let mut files = vec![("archive.json".to_owned(), format!("{report:#}\n"))];
    files.extend(charts::draw(&rates, &losses, &stops, &stamp::line(&stamp)));
    for (name, text) in files {
        let path = out.join(name);
        fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
    }
    Ok(())
}
