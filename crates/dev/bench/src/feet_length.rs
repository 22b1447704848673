//! `feet_length`: cost of the stages `tags`, `terrain`, `feet` and `maps` against the length of a
//! walk.
//!
//! Rounds of a simulated plaza with the feet camera alone, so that the surface is complete after the
//! first round and what grows after it is not the map. Two sources:
//!
//! - `images`: sessions of 2 and 10 minutes, 672x376 per eye at 15 Hz, rendered with reduced
//!   quality. Poses are true; depth, cloud and masks are those of their stages, which are not
//!   measured.
//! - `plain data`: up to 60 minutes, without images ([`plain`]): an hour of them would take hours
//!   to render and to decode. Stage `tags` needs images and does not run.
//!
//! Every stage runs in a process of its own, on outputs that are read from disk, as
//! `paws-reconstruct run --from STAGE --to STAGE` does; memory is the peak of that process, minus
//! what is resident before the stage. Cost in a third of a walk is the difference of the costs of
//! two walks, one of which ends where the third begins and the other where it ends: stages that
//! read a whole walk in one step have no cost of a minute.

use std::path::Path;

use anyhow::{Context, Result};
use serde::Serialize;
use serde_json::json;

mod charts;
mod detections;
mod images;
mod map_size;
mod plain;
mod stage_run;
mod walk;

use crate::arguments::Arguments;
use crate::odometry::results::write;
use crate::{meter, stamp};
use map_size::MapSize;
use stage_run::StageCost;
use walk::Walk;

/// Stages that are measured, in their order.
const STAGES: [&str; 4] = ["tags", "terrain", "feet", "maps"];
/// Lengths of plain data, minutes: the last three are thirds of the longest.
const PLAIN_MINUTES: [u32; 7] = [1, 2, 5, 10, 20, 40, 60];
const QUICK_PLAIN_MINUTES: [u32; 3] = [1, 2, 3];
/// Lengths of sessions with images, minutes.
const IMAGE_MINUTES: [u32; 2] = [2, 10];
/// Maximum ratio of the costs of a minute in the last and in the first third.
const MAX_GROWTH: f64 = 1.10;

/// Costs of a walk of some length.
#[derive(Clone, Debug, Serialize)]
struct Run {
    source: &'static str,
    minutes: u32,
    keyframes: usize,
    detections: usize,
    stages: Vec<StageCost>,
    map: MapSize,
}

impl Run {
    fn stage(&self, name: &str) -> Option<&StageCost> {
        self.stages.iter().find(|own| own.stage == name)
    }
}

/// Growth of a stage's cost over the thirds of the longest walk.
#[derive(Clone, Debug, Serialize)]
struct Growth {
    stage: &'static str,
    /// Processor time for a minute of each third, s.
    cpu_s_per_minute: [f64; 3],
    last_third_over_first: f64,
    last_third_over_second: f64,
    /// Peak memory at the end of each third, MB.
    peak_mb: [f64; 3],
    last_peak_over_first: f64,
    within_limits: bool,
}

/// Runs the benchmark: `[--quick] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error. Growth is a result and not an error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    if let Some(answer) = stage_run::answer(args) {
        return answer;
    }
    let Arguments { quick, out } = Arguments::parse(args)?;
    let stamp = stamp::stamp("feet_length", args)?;
    let disk = meter::on_disk(None)?;
    let disk = tempfile::tempdir_in(disk).context("making a folder for bundles")?;
    let lengths: &[u32] = match quick {
        true => &QUICK_PLAIN_MINUTES,
        false => &PLAIN_MINUTES,
    };
    let mut runs = plain_runs(lengths, disk.path())?;
    if !quick {
        for minutes in IMAGE_MINUTES {
            runs.push(images::run(minutes, disk.path())?);
        }
    }
    let growth = growth(&runs);
    for own in &growth {
        println!(
            "{}: {:.2?} s of processor time for a minute of each third, last over first {:.3}, over \
             second {:.3}; peak {:.0?} MB, last over first {:.3}",
            own.stage,
            own.cpu_s_per_minute,
            own.last_third_over_first,
            own.last_third_over_second,
            own.peak_mb,
            own.last_peak_over_first
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
    let mut files = vec![("feet_length.json".to_owned(), format!("{report:#}\n"))];
    files.extend(charts::draw(&runs, &stamp::line(&stamp)));
    write(&out, files)
}

fn plain_runs(lengths: &[u32], disk: &Path) -> Result<Vec<Run>> {
    let longest = *lengths.last().context("a length")?;
    let walk = Walk::new(longest, plain::SIZE)?;
    let session = walk.short_session(&disk.join("plain-session"))?;
    let bundles = plain::write(&walk, &session, lengths, disk)?;
    let mut runs = Vec::new();
    for bundle in bundles {
        let stages = stage_run::run(&session, &bundle.path, &STAGES[1..])?;
        let map = MapSize::of(&bundle.path)?;
        let run = Run {
            source: "plain data",
            minutes: bundle.minutes,
            keyframes: bundle.keyframes,
            detections: bundle.detections,
            stages,
            map,
        };
        print(&run);
        runs.push(run);
    }
    Ok(runs)
}

fn print(run: &Run) {
    let stages = run.stages.iter().map(|own| {
        let StageCost {
            stage,
            cpu_s,
            wall_s,
            peak_mb,
        } = own;
        format!("{stage} {cpu_s:.2} s CPU, {wall_s:.2} s, {peak_mb:.0} MB")
    });
    println!(
        "{} min of {}: {} keyframes, {} detections; {}; map {:.0} m2, {} blocks, {:.0} MB",
        run.minutes,
        run.source,
        run.keyframes,
        run.detections,
        stages.collect::<Vec<_>>().join("; "),
        run.map.area_m2,
        run.map.blocks,
        run.map.blocks_mb
    );
}

/// Growth over the last three lengths of plain data.
fn growth(runs: &[Run]) -> Vec<Growth> {
    let plain: Vec<&Run> = runs
        .iter()
        .filter(|run| run.source == "plain data")
        .collect();
    let [.., first, second, last] = plain[..] else {
        return Vec::new();
    };
    let of = |stage: &'static str| {
        let costs = [first, second, last].map(|run| run.stage(stage).cloned());
        let [Some(a), Some(b), Some(c)] = costs else {
            return None;
        };
        let third = f64::from(first.minutes);
        let cpu = [a.cpu_s, b.cpu_s - a.cpu_s, c.cpu_s - b.cpu_s].map(|cpu| cpu / third);
        let peak = [a.peak_mb, b.peak_mb, c.peak_mb];
        Some(Growth {
            stage,
            cpu_s_per_minute: cpu,
            last_third_over_first: cpu[2] / cpu[0],
            last_third_over_second: cpu[2] / cpu[1],
            peak_mb: peak,
            last_peak_over_first: peak[2] / peak[0],
            within_limits: cpu[2] <= MAX_GROWTH * cpu[0] && peak[2] <= MAX_GROWTH * peak[0],
        })
    };
    STAGES.into_iter().filter_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_third_costs_the_difference_of_two_walks() {
        let run = |minutes, cpu_s, peak_mb| Run {
            source: "plain data",
            minutes,
            keyframes: 0,
            detections: 0,
            stages: vec![StageCost {
                stage: "feet".to_owned(),
                cpu_s,
                wall_s: 0.0,
                peak_mb,
            }],
            map: MapSize::default(),
        };
        let runs = [
            run(5, 9.0, 1.0),
            run(10, 20.0, 10.0),
            run(20, 50.0, 10.0),
            run(30, 90.0, 12.0),
        ];
        let [own] = &growth(&runs)[..] else {
            panic!("one stage")
        };
        assert_eq!(own.cpu_s_per_minute, [2.0, 3.0, 4.0]);
        assert_eq!(
            (own.last_third_over_first, own.last_peak_over_first),
            (2.0, 1.2)
        );
        assert!(!own.within_limits);
    }
}
