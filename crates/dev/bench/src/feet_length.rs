//! `feet_length`: cost of the stages `tags`, `terrain`, `feet` and `maps` against the length of a
//! walk.
//!
//! Rounds of a simulated plaza with the feet camera alone, so that the surface is complete after
//! the first round and what grows after it is not the map. Two sources:
//!
//! - `images`: sessions of 2 and 10 minutes, 672x376 per eye at 7.5 Hz, rendered with reduced
//!   quality. Poses are true; keyframes, depth, cloud and masks are those of their stages with the
//!   preset `fast`, which are not measured.
//! - `plain data`: 60 minutes without images ([`plain`]), since an hour of them would take hours to
//!   render. Stage `tags` needs images and does not run.
//!
//! Every stage runs in a process of its own, on outputs that are read from disk, as
//! `paws-reconstruct run --from STAGE --to STAGE` does; memory is the peak of that process, minus
//! what is resident before the stage.
//!
//! `tags` and `terrain` read frame by frame: their processor time and memory are those of each
//! minute of one run, and growth is the ratio of the medians of the last and the first third of the
//! minutes without the first ones, in which the map is built. `feet` and `maps` read the whole walk
//! in one step. Their cost in a third is the difference of the costs of two walks, one of which
//! ends where the third begins and the other where it ends; all use the terrain of the longest.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result, bail, ensure};
use serde_json::{Value, json};

mod charts;
mod detections;
mod growth;
mod images;
mod map_size;
mod plain;
mod runs;
mod stage_run;
mod walk;

use scene_bundle::outputs::TERRAIN;

use crate::arguments::Arguments;
use crate::odometry::results::write;
use crate::stamp;
use growth::MAX_GROWTH;
use map_size::MapSize;
use runs::{IMAGES, PLAIN, Run};
use walk::Walk;

/// Lengths of plain data, minutes: the last three are thirds of the longest.
const PLAIN_MINUTES: [u32; 4] = [10, 20, 40, 60];
const QUICK_PLAIN_MINUTES: [u32; 3] = [1, 2, 3];
/// Lengths of sessions with images, minutes.
const IMAGE_MINUTES: [u32; 2] = [2, 10];
/// Runs of stages that read a walk in one step.
const REPEATS: usize = 3;
const FILE: &str = "feet_length.json";

/// Runs the benchmark: `[--quick] [--only plain|images] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error. Growth is a result and not an error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    if let Some(answer) = stage_run::answer(args) {
        return answer;
    }
    let options = Options::parse(args)?;
    let Arguments { quick, out } = &options.common;
    let stamp = stamp::stamp("feet_length", args)?;
    let disk = tempfile::tempdir().context("making a folder for bundles")?;
    // Results of the other source are kept.
    let mut runs = earlier_runs(out)?;
    if options.plain {
        let (lengths, repeats): (&[u32], _) = match quick {
            true => (&QUICK_PLAIN_MINUTES, 1),
            false => (&PLAIN_MINUTES, REPEATS),
        };
        let new = plain_runs(lengths, repeats, disk.path())?;
        runs.retain(|run| run.source != PLAIN);
        runs.extend(new);
        write_results(out, &runs, &stamp)?;
    }
    if options.images {
        runs.retain(|run| run.source != IMAGES);
        for minutes in IMAGE_MINUTES {
            runs.push(images::run(minutes, disk.path())?);
            write_results(out, &runs, &stamp)?;
        }
    }
    Ok(())
}

struct Options {
    common: Arguments,
    plain: bool,
    images: bool,
}

impl Options {
    fn parse(args: &[String]) -> Result<Self> {
        let mut rest = args.to_vec();
        let mut only = None;
        if let Some(at) = rest.iter().position(|a| a == "--only") {
            ensure!(at + 1 < rest.len(), "--only needs plain or images");
            only = Some(rest.remove(at + 1));
            rest.remove(at);
        }
        let common = Arguments::parse(&rest)?;
        let (plain, images) = match only.as_deref() {
            None => (true, !common.quick),
            Some("plain") => (true, false),
            Some("images") => (false, true),
            Some(other) => bail!("found --only {other:?}, expected plain or images"),
        };
        Ok(Self {
            common,
            plain,
            images,
        })
    }
}

fn earlier_runs(out: &Path) -> Result<Vec<Run>> {
    let path = out.join(FILE);
    if !path.exists() {
        return Ok(Vec::new());
    }
    let text = fs::read_to_string(&path).with_context(|| format!("reading {}", path.display()))?;
    let mut report: Value =
        serde_json::from_str(&text).with_context(|| format!("reading {}", path.display()))?;
    serde_json::from_value(report["runs"].take())
        .with_context(|| format!("reading the runs in {}", path.display()))
}

fn write_results(out: &Path, runs: &[Run], stamp: &Value) -> Result<()> {
    let growth = growth::growth(runs);
    for own in &growth {
        println!(
            "{}, {}: {:.3?} s of processor time for a minute of each third, last over first {:.3}, \
             over second {:.3}; {:.0?} MB, last over first {:.3}",
            own.stage,
            own.source,
            own.cpu_s_per_minute,
            own.last_third_over_first,
            own.last_third_over_second,
            own.memory_mb,
            own.last_memory_over_first
        );
    }
    let report = json!({
        "benchmark": "feet_length",
        "stamp": stamp,
        "walk": Walk::NAME,
        "max_growth": MAX_GROWTH,
        "growth": growth,
        "runs": runs,
    });
    let mut files = vec![(FILE.to_owned(), format!("{report:#}\n"))];
    files.extend(charts::draw(runs, &stamp::line(stamp)));
    write(out, files)
}

fn plain_runs(lengths: &[u32], repeats: usize, disk: &Path) -> Result<Vec<Run>> {
    let longest = *lengths.last().context("a length")?;
    let walk = Walk::new(longest, plain::SIZE, plain::RATE_HZ)?;
    let session = walk.short_session(&disk.join("plain-session"))?;
    let bundles = plain::write(&walk, &session, lengths, disk)?;
    let whole = &bundles.last().context("a bundle")?.path;
    let terrain = stage_run::run(&session, whole, &["terrain"], 1)?;
    let mut runs = Vec::new();
    for bundle in &bundles {
        let mut stages = match bundle.path == *whole {
            true => terrain.clone(),
            false => {
                plain::copy_output(TERRAIN, whole, &bundle.path)?;
                Vec::new()
            }
        };
        stages.extend(stage_run::run(
            &session,
            &bundle.path,
            &["feet", "maps"],
            repeats,
        )?);
        let run = Run {
            source: PLAIN.to_owned(),
            minutes: bundle.minutes,
            keyframes: bundle.keyframes,
            detections: bundle.detections,
            stages,
            map: MapSize::of(whole, &bundle.path)?,
        };
        run.print();
        runs.push(run);
    }
    Ok(runs)
}
