//! `feet`: shoe tags, contacts and swings on simulated walks with two rigs.
//!
//! - [`walks`]: the walks, the rigs, and wearers with the gait of [`joint_gait`].
//! - [`images`]: rendered images, kept on request; [`recording`]: the tags in them, and the truth.
//! - [`detections`]: sightings of shoe tags against the truth.
//! - [`ground`]: the ground as a map shows it.
//! - [`gait`]: contacts, their times, and hidden swings, from these sightings, true poses of the
//!   rig and that ground.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, Result, bail};
use rig_sim::scene::Lighting;
use serde_json::json;

use self::recording::Recording;
use self::row::Row;
use self::walks::{FeetRig, RIGS, TUNING, WALKS, Walk};
use crate::odometry::results;
use crate::{report, stamp};

mod charts;
mod detections;
mod gait;
mod ground;
mod images;
mod joint_gait;
mod recording;
mod row;
mod statistics;
mod walks;

/// Where images are kept: 90 MB per walk of the example rig, 660 MB of the recommended one.
const IMAGES: &str = "target/feet";

const FILE: &str = "feet.json";

struct Options {
    quick: bool,
    keep: bool,
    kept: bool,
    tuning: bool,
    only: Option<String>,
    walks: Vec<String>,
    out: PathBuf,
}

impl Options {
    fn parse(args: &[String]) -> Result<Self> {
        let mut options = Self {
            quick: false,
            keep: false,
            kept: false,
            tuning: false,
            only: None,
            walks: Vec::new(),
            out: PathBuf::from("docs/benchmarks"),
        };
        let mut rest = args.iter();
        while let Some(argument) = rest.next() {
            match argument.as_str() {
                "--quick" => options.quick = true,
                "--keep" => options.keep = true,
                "--kept" => options.kept = true,
                "--tuning" => options.tuning = true,
                "--only" => {
                    let rigs = RIGS.map(|rig| rig.name).join(" or ");
                    options.only =
                        Some(rest.next().context(format!("--only needs {rigs}"))?.clone());
                }
                "--walk" => {
                    let name = rest.next().context("--walk needs a walk's name")?;
                    options.walks.push(name.clone());
                }
                "--out" => options.out = rest.next().context("--out needs a folder")?.into(),
                other => bail!(
                    "unknown argument {other:?}, expected --quick, --keep, --kept, --tuning, --only RIG, --walk \
                     NAME or --out DIR"
                ),
            }
        }
        Ok(options)
    }
}

/// Runs the benchmark: `[--quick] [--keep] [--kept] [--tuning] [--only RIG] [--walk NAME]...
/// [--out DIR]`.
///
/// With `--keep` images are kept, and those of earlier runs are not rendered again; with `--kept`
/// walks of which none are kept are left out. With `--only` results of the other rig are kept. With
/// `--tuning` it runs on the walks that the estimator is developed with, and writes nothing.
///
/// # Errors
/// Bad arguments, or an I/O error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let options = Options::parse(args)?;
    let mut walks: Vec<Walk> = match (options.tuning, options.quick) {
        (true, _) => TUNING.to_vec(),
        (false, true) => vec![WALKS[0], WALKS[10]],
        (false, false) => WALKS.to_vec(),
    };
    if !options.walks.is_empty() {
        walks.retain(|walk| options.walks.iter().any(|name| walk.name == name));
    }
    let stamp = stamp::stamp("feet", args)?;
    let source = stamp::source(&stamp);
    let mut rows = earlier_rows(&options)?;
    for rig in &RIGS {
        if options.only.as_ref().is_none_or(|only| only == rig.name) {
            let folder = Path::new(IMAGES);
            let is_wanted = |walk: &&Walk| !options.kept || images::are_kept(folder, rig, walk);
            let walks: Vec<Walk> = walks.iter().filter(is_wanted).copied().collect();
            let keeps = options.keep || options.kept;
            rows.extend(of_rig(rig, &walks, keeps.then_some(folder), &source)?);
        }
    }
    if options.tuning {
        return Ok(());
    }
    let report = json!({
        "benchmark": "feet",
        "stamp": stamp,
        "rows": rows,
    });
    let mut files = charts::draw(&rows);
    files.push((FILE.to_owned(), format!("{report:#}\n")));
    results::write(&options.out, files)
}

/// Rows of earlier runs with a rig that is not run now.
fn earlier_rows(options: &Options) -> Result<Vec<Row>> {
    let Some(only) = &options.only else {
        return Ok(Vec::new());
    };
    let mut report = report::read(&options.out.join(FILE))?;
    let Some(rows) = report.remove("rows") else {
        return Ok(Vec::new());
    };
    let mut rows: Vec<Row> = serde_json::from_value(rows).context("reading rows of feet.json")?;
    rows.retain(|row| row.rig != *only);
    Ok(rows)
}

/// A row for each walk, and rows of all walks in one kind of gait.
fn of_rig(rig: &FeetRig, walks: &[Walk], kept: Option<&Path>, source: &str) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    let mut sums = [gait::Errors::default(), gait::Errors::default()];
    let mut counts = [gait::Row::default(), gait::Row::default()];
    for walk in walks {
        let recording = Recording::of(rig, walk, kept)?;
        let (gait, errors) = gait::row(&recording);
        let kind = usize::from(walk.wearer.is_some());
        sums[kind].extend(&errors);
        let all = &mut counts[kind];
        all.footfalls += gait.footfalls;
        all.found += gait.found;
        all.hidden += gait.hidden;
        all.invented += gait.invented;
        let row = Row {
            source: source.to_owned(),
            rig: rig.name.to_owned(),
            walk: walk.name.to_owned(),
            is_held_out: walk.wearer.is_some(),
            is_day: matches!(walk.light, Lighting::Day),
            tags: Some(detections::row(&recording)?),
            gait,
        };
        print(&row);
        rows.push(row);
    }
    for (kind, name) in ["all, simulator's gait", "all, by joint angles"]
        .into_iter()
        .enumerate()
    {
        if counts[kind].footfalls == 0 {
            continue;
        }
        let row = Row {
            source: source.to_owned(),
            rig: rig.name.to_owned(),
            walk: name.to_owned(),
            is_held_out: kind == 1,
            is_day: false,
            tags: None,
            gait: sums[kind].complete(counts[kind].clone()),
        };
        print(&row);
        rows.push(row);
    }
    Ok(rows)
}

fn print(row: &Row) {
    let gait = &row.gait;
    let tags = row.tags.as_ref().map_or(String::new(), |tags| {
        format!(
            "tags {}/{} ({}/{}) invented {} wrong {} {:.2} ms, ",
            tags.found,
            tags.visible,
            tags.found_predicted,
            tags.predicted,
            tags.invented,
            tags.wrong,
            tags.median_ms,
        )
    });
    println!(
        "{:<11} {:<21} {tags}steps {}/{} hidden {} invented {}, contact p95 {:.1} RMS {:.1} mm NEES \
         {:.2}, strike p95 {:.0} (seen {:.0} of {}) NEES {:.2}, toe off p95 {:.0} NEES {:.2}, bridged \
         {} RMS {:.0} p95 {:.0} mm within {:.0} %, dropped {} RMS {:.0} within {:.0} %, lost {:.0} %",
        row.rig,
        row.walk,
        gait.found,
        gait.footfalls,
        gait.hidden,
        gait.invented,
        gait.contact_mm[1],
        gait.contact_mm[2],
        gait.contact_nees,
        gait.strike_ms[1],
        gait.strike_seen_p95_ms,
        gait.strikes_seen,
        gait.strike_nees,
        gait.toe_off_ms[1],
        gait.toe_off_nees,
        gait.bridged,
        gait.bridged_mm[2],
        gait.bridged_mm[1],
        100.0 * gait.bridged_within,
        gait.dropped,
        gait.dropped_mm[2],
        100.0 * gait.dropped_within,
        100.0 * gait.lost,
    );
}
