//! `splats`: training of scenes of 3D Gaussians on simulated walks, against the truth of the
//! simulator.
//!
//! Poses are true, and so are the masks of people and of the wearer; keyframes are selected, and
//! depth is computed and rounded, as by `paws-reconstruct` with its preset `balanced`. Test views
//! have neither noise nor motion blur; see [`views`].
//!
//! 1. `walks`: held-out instants, gaps of 2 m in every 20 m and views off the path, of each walk
//!    and preset.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use serde_json::{Map, Value, json};
use splats::{Evaluation, TrainingView};

pub(crate) mod fit;
pub(crate) mod off_path;
pub(crate) mod recorded;
pub(crate) mod views;
pub(crate) mod walks;

use fit::{Fit, config, evaluate};
use off_path::off_path;
use views::{Part, ViewOptions, WalkViews};
use walks::{Extent, short_name};

use crate::stamp;
use crate::terrain::walks::{SMALL, Walk};

const PARTS: [&str; 1] = ["walks"];
/// Views off the path for each offset and angle, and their seed.
const OFF_PATH_VIEWS: usize = 4;
const OFF_PATH_SEED: u64 = 17;
/// Points of a curve over time.
const CURVE_POINTS: usize = 7;

/// Runs the benchmark: `[--quick] [--only PART,...] [--walks NAME,...] [--presets NAME,...]
/// [--steps N] [--seconds S] [--half] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error. A missed goal is a result and no error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let options = Options::parse(args)?;
    fs::create_dir_all(&options.out)
        .with_context(|| format!("making {}", options.out.display()))?;
    let stamp = stamp::stamp("splats", args)?;
    // Results of other parts are kept.
    let path = options.out.join("splats.json");
    let mut report = read(&path)?;
    for part in &options.parts {
        for walk in walks::walks(&options.walks, options.extent)? {
            let rows = match part.as_str() {
                _ => presets(walk, &options)?,
            };
            for row in &rows {
                println!("{row}");
            }
            add_rows(&mut report, part, rows, &stamp);
            let text = format!("{:#}\n", Value::Object(report.clone()));
            fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
        }
    }
    Ok(())
}

/// Rows of one walk, a preset each.
fn presets(walk: Walk, options: &Options) -> Result<Vec<Value>> {
    let views = WalkViews::load(walk.prepare()?, "")?;
    let tests = Tests::new(&views, options)?;
    let mut rows = Vec::new();
    for preset in &options.presets {
        let config = config(preset, options.steps)?;
        let stage = ViewOptions {
            reduction: config.reduction,
            ..ViewOptions::STAGE
        };
        let training = views.recorded(Part::Training, &stage)?;
        let validation = views.recorded(Part::Validation, &stage)?;
        let count = training.len();
        let fit = fit::fit(training, &validation, &config, (&tests.gaps, CURVE_POINTS))?;
        let mut row = row(walk, preset, &fit, count);
        row["recorded"] = scores(&evaluate(&fit.scene, &validation, &config)?);
        tests.add_scores(&mut row, &fit, &config)?;
        rows.push(row);
    }
    Ok(rows)
}

/// What a training was and took.
fn row(walk: Walk, preset: &str, fit: &Fit, training_views: usize) -> Value {
    let curve = fit.curve.iter().map(|point| {
        json!({
            "step": point.step,
            "cpu_s": point.cpu_s,
            "gaussians": point.splats,
            "psnr_db": point.psnr_db,
        })
    });
    let checks = fit.checks.iter().map(|check| {
        json!({
            "step": check.step,
            "gaussians": check.splats,
            "psnr_db": check.psnr_db,
            "gain_db": check.gain_db,
            "continues": check.continues,
        })
    });
    json!({
        "walk": short_name(walk.kind, walk.light),
        "size": walk.size,
        "seconds": walk.span_s[1] - walk.span_s[0],
        "preset": preset,
        "views": training_views,
        "start": fit.start_count,
        "gaussians": fit.scene.splats.len(),
        "steps": fit.curve.last().map(|point| point.step),
        "steps_with_checks": fit.steps,
        "cpu_s": fit.timing.cpu_s,
        "wall_s": fit.timing.wall_s,
        "steps_per_cpu_s": fit.steps as f64 / fit.timing.cpu_s,
        "curve": curve.collect::<Vec<Value>>(),
        "checks": checks.collect::<Vec<Value>>(),
    })
}

fn scores(of: &Evaluation) -> Value {
    json!({
        "views": of.psnr_db.len(),
        "psnr_db": of.mean_psnr_db(),
        "worst_db": of.worst_psnr_db(),
        "ssim": of.mean_ssim(),
        "depth_error": of.depth_error,
    })
}

/// Test views of a walk.
struct Tests {
    instants: Vec<TrainingView>,
    gaps: Vec<TrainingView>,
    off_path: Vec<off_path::OffPathView>,
}

impl Tests {
    fn new(views: &WalkViews, options: &Options) -> Result<Self> {
        let full = ViewOptions::STAGE;
        let plain = |part| -> Result<Vec<TrainingView>> {
            let truth = views.truth(part, &full)?;
            Ok(truth.into_iter().map(|test| test.view).collect())
        };
        let count = if options.quick { 1 } else { OFF_PATH_VIEWS };
        Ok(Self {
            instants: plain(Part::Validation)?,
            gaps: plain(Part::Gap)?,
            off_path: off_path(views, count, OFF_PATH_SEED, &full)?,
        })
    }

    fn add_scores(
        &self,
        row: &mut Value,
        fit: &Fit,
        config: &reconstruction::pipeline::stages::splats::SplatsConfig,
    ) -> Result<()> {
        row["instants"] = scores(&evaluate(&fit.scene, &self.instants, config)?);
        row["gaps"] = scores(&evaluate(&fit.scene, &self.gaps, config)?);
        let mut off_path = Vec::new();
        for offset_m in off_path::OFFSETS_M {
            for angle_deg in off_path::ANGLES_DEG {
                let own = self.off_path.iter();
                let own = own.filter(|v| v.offset_m == offset_m && v.angle_deg == angle_deg);
                let own: Vec<TrainingView> = own.map(|v| v.test.view.clone()).collect();
                if own.is_empty() {
                    continue;
                }
                let mut entry = scores(&evaluate(&fit.scene, &own, config)?);
                entry["offset_m"] = offset_m.into();
                entry["angle_deg"] = angle_deg.into();
                off_path.push(entry);
            }
        }
        row["off_path"] = off_path.into();
        Ok(())
    }
}

/// Adds rows of one walk, with their source; those of others, and of other presets, remain.
fn add_rows(report: &mut Map<String, Value>, part: &str, mut rows: Vec<Value>, stamp: &Value) {
    for row in &mut rows {
        row["source"] = stamp::source(stamp).into();
    }
    let old = report
        .get(part)
        .map_or(&Value::Null, |entry| &entry["rows"]);
    let old = old.as_array().map_or(&[][..], Vec::as_slice);
    let key = |row: &Value| ["walk", "size", "preset", "steps", "case"].map(|k| row[k].clone());
    let is_other = |own: &&Value| rows.iter().all(|row| key(row) != key(own));
    let mut all: Vec<Value> = old.iter().filter(is_other).cloned().collect();
    all.append(&mut rows);
    let place = |row: &Value| {
        let mut all = walks::WALKS.iter();
        all.position(|(kind, light, _)| row["walk"] == short_name(*kind, *light))
    };
    all.sort_by_key(place);
    report.insert(part.to_owned(), json!({ "stamp": stamp, "rows": all }));
}

fn read(path: &Path) -> Result<Map<String, Value>> {
    if !path.exists() {
        return Ok(Map::new());
    }
    let text = fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("reading {}", path.display()))
}

struct Options {
    quick: bool,
    out: PathBuf,
    parts: Vec<String>,
    /// Short names of the walks to run; empty for all.
    walks: Vec<String>,
    presets: Vec<String>,
    /// Number of steps in place of the presets'.
    steps: Option<usize>,
    extent: Extent,
}

impl Options {
    fn parse(args: &[String]) -> Result<Self> {
        let mut parsed = Self {
            quick: false,
            out: PathBuf::from("docs/benchmarks"),
            parts: PARTS.map(str::to_owned).to_vec(),
            walks: Vec::new(),
            presets: vec!["balanced".to_owned()],
            steps: None,
            extent: Extent::WHOLE,
        };
        let mut rest = args.iter();
        while let Some(argument) = rest.next() {
            let mut value = || {
                rest.next()
                    .with_context(|| format!("{argument} needs a value"))
            };
            let list = |text: &String| text.split(',').map(str::to_owned).collect();
            match argument.as_str() {
                "--quick" => parsed.quick = true,
                "--half" => parsed.extent.size = SMALL.map(|edge| edge / 2),
                "--out" => parsed.out = value()?.into(),
                "--walks" => parsed.walks = list(value()?),
                "--preset" | "--presets" => parsed.presets = list(value()?),
                "--steps" => parsed.steps = Some(value()?.parse().context("reading --steps")?),
                "--seconds" => {
                    parsed.extent.seconds = value()?.parse().context("reading --seconds")?;
                }
                "--only" => {
                    parsed.parts = list(value()?);
                    let known = |part: &String| PARTS.contains(&part.as_str());
                    ensure!(
                        parsed.parts.iter().all(known),
                        "--only takes {}",
                        PARTS.join(", ")
                    );
                }
                other => bail!(
                    "unknown argument {other:?}, expected --quick, --only, --walks, --presets, \
                     --steps, --seconds, --half or --out"
                ),
            }
        }
        if parsed.quick {
            parsed.extent.seconds = 12.0;
            parsed.steps = parsed.steps.or(Some(300));
            parsed.presets = vec!["fast".to_owned()];
        }
        Ok(parsed)
    }
}
