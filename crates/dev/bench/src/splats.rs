//! `splats`: training of scenes of 3D Gaussians on simulated walks, against the truth of the
//! simulator.
//!
//! Poses are true, and so are the masks of people and of the wearer; keyframes are selected, and
//! depth is computed and rounded, as by `paws-reconstruct` with its preset `balanced`. Test views
//! have neither noise nor motion blur; see [`views`].
//!
//! 1. `walks`: held-out instants, gaps of 2 m in every 20 m and views off the path, of each walk
//!    and preset.
//! 2. `settings`: what poses and exposures, right images and depth are worth, at equal steps.
//! 3. `counts`: PSNR over the number of Gaussians.
//! 4. `failures`: damaged views at rising strength.
//! 5. `plain`: beside a plain PyTorch trainer.
//! 6. `fox`: photos of the shared data.
//!
//! Beside times stand processor times of all threads, which other load of the machine changes less.

use std::fs;

use anyhow::{Context, Result};
use serde_json::{Map, Value, json};

pub(crate) mod brightness;
mod charts;
mod counts;
mod exam;
mod failures;
pub(crate) mod fit;
mod fox;
pub(crate) mod off_path;
mod options;
mod plain;
pub(crate) mod recorded;
mod settings;
#[cfg(test)]
mod tests;
pub(crate) mod views;
pub(crate) mod walks;

use exam::Exam;
use options::Options;
use views::{ViewOptions, WalkViews};

use crate::terrain::walks::Walk;
use crate::{report, stamp};

/// Steps beside the plain trainer, which is slow.
const PLAIN_STEPS: usize = 100;

/// Runs the benchmark: `[--quick] [--only PART,...] [--walks NAME,...] [--presets NAME,...]
/// [--steps N] [--seconds S] [--half] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error. A missed goal is a result and no error; a missing peer or data
/// set is left out with a printed reason.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let options = Options::parse(args)?;
    fs::create_dir_all(&options.out)
        .with_context(|| format!("making {}", options.out.display()))?;
    let mut stamp = stamp::stamp("splats", args)?;
    stamp["command"] = format!("cargo xtask bench splats {}", arguments(args)).into();
    // Results of other parts are kept.
    let path = options.out.join("splats.json");
    let mut report = report::read(&path)?;
    for part in &options.parts {
        let walks = match part.as_str() {
            "fox" => vec![None],
            _ => walks::walks(&options.walks(part), options.extent)?
                .into_iter()
                .map(Some)
                .collect(),
        };
        for walk in walks {
            let Some(rows) = rows(part, walk, &options)? else {
                continue;
            };
            for row in &rows {
                println!("{row}");
            }
            add_rows(&mut report, part, rows, &stamp);
            report::write(&path, &report)?;
        }
    }
    report::write_charts(&options.out, charts::draw(&report))?;
    Ok(())
}

/// Arguments without the output folder, which is a path of this machine.
fn arguments(args: &[String]) -> String {
    let mut kept: Vec<&str> = Vec::new();
    let mut rest = args.iter();
    while let Some(argument) = rest.next() {
        match argument.as_str() {
            "--out" => drop(rest.next()),
            other => kept.push(other),
        }
    }
    kept.join(" ")
}

/// Rows of a part on a walk; `None`, with a printed reason, where something is missing.
fn rows(part: &str, walk: Option<Walk>, options: &Options) -> Result<Option<Vec<Value>>> {
    let Some(walk) = walk else {
        return fox::fox(&options.presets, options.steps);
    };
    let (presets, steps) = (&options.presets, options.steps);
    let preset = presets.first().map_or("balanced", String::as_str);
    let exam = |off_path_views| Exam::new(walk.prepare()?, "", off_path_views);
    Ok(Some(match part {
        "walks" => {
            let exam = exam(options.off_path_views)?;
            let row = |preset: &String| {
                let config = fit::config(preset, steps)?;
                let stage = ViewOptions {
                    reduction: config.reduction,
                    ..ViewOptions::STAGE
                };
                exam.run("", preset, &config, &stage)
            };
            presets.iter().map(row).collect::<Result<_>>()?
        }
        "settings" => settings::settings(&exam(0)?, preset, steps)?,
        "counts" => counts::counts(&exam(0)?, preset, steps)?,
        "failures" => {
            let mut rows = failures::failures(&exam(0)?, preset, steps)?;
            rows.extend(failures::blur(walk, preset, steps)?);
            rows
        }
        _ => {
            let views = WalkViews::load(walk.prepare()?, "")?;
            match plain::plain(&views, steps.unwrap_or(PLAIN_STEPS))? {
                Some(row) => vec![row],
                None => return Ok(None),
            }
        }
    }))
}

/// Adds rows, with their source; those of other cases remain.
fn add_rows(report: &mut Map<String, Value>, part: &str, mut rows: Vec<Value>, stamp: &Value) {
    for row in &mut rows {
        row["source"] = stamp::source(stamp).into();
        row["command"] = stamp["command"].clone();
    }
    let old = report
        .get(part)
        .map_or(&Value::Null, |entry| &entry["rows"]);
    let old = old.as_array().map_or(&[][..], Vec::as_slice);
    let key = |row: &Value| {
        ["walk", "size", "seconds", "preset", "steps", "case"].map(|k| row[k].clone())
    };
    let is_other = |own: &&Value| rows.iter().all(|row| key(row) != key(own));
    let mut all: Vec<Value> = old.iter().filter(is_other).cloned().collect();
    all.append(&mut rows);
    let place = |row: &Value| {
        let mut all = walks::WALKS.iter();
        all.position(|(kind, light, _)| row["walk"] == walks::short_name(*kind, *light))
    };
    all.sort_by_key(place);
    report.insert(part.to_owned(), json!({ "stamp": stamp, "rows": all }));
}
