//! `confidence`: whether a scene of Gaussians knows where it is wrong.
//!
//! Scenes of simulated walks are trained with the preset `fast` at a third of the size. Views off
//! the path, moved by 0.1 to 3 m and rotated by up to 30°, are compared with the truth of the
//! simulator, without noise, at the brightness of the scene. A view is bad below 18 dB, or with a
//! median error of depth above 10 %.
//! Rules flag views by what they know without the truth; their limits come from other walks than
//! those that are counted.
//!
//! Constants of the measure are fitted on the same walks as the limits, and printed: those of the
//! crate `splats` come from here.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use rayon::prelude::*;
use rig_sim::scene::{Kind, Lighting};
use serde_json::{Value, json};
use splats::MeasureConfig;

mod fit;
mod rules;
mod samples;
mod scores;

use rules::{Counts, Nearest, Verdicts, above, counts, measure};
use samples::{Sample, Sampling};

use crate::stamp;
use crate::terrain::walks::Walk;

/// Kinds of scenes.
const KINDS: [Kind; 6] = [
    Kind::Pavement,
    Kind::Stairs,
    Kind::Trail,
    Kind::Room,
    Kind::Corridor,
    Kind::Plaza,
];
/// Seeds of the first walk of the fit and of the first one of the exam; no other benchmark uses
/// them.
const FIT_SEED: u64 = 931;
const EXAM_SEED: u64 = 941;
/// What is before a walk, and its length, s.
const BEGIN_S: f64 = 3.0;
const LENGTH_S: f64 = 12.0;
/// Columns and rows: a third of the images of the cameras.
const SIZE: [u32; 2] = [224, 126];
/// The fit and the exam.
const FIT: Sampling = Sampling {
    steps: 1000,
    views: 6,
};
const EXAM: Sampling = Sampling {
    steps: 1000,
    views: 28,
};

/// Runs the benchmark: `[--quick] [--scenes NAME,...] [--views N] [--samples DIR] [--out DIR]`, N
/// views of the exam for each offset and angle of a walk. Samples of walks are kept in DIR and read
/// from there.
///
/// # Errors
/// Bad arguments, or an I/O error. A missed goal is a result and no error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let options = Options::parse(args)?;
    let of = |seed: u64, sampling: Sampling| -> Result<Vec<(Kind, Vec<Sample>)>> {
        let kinds = KINDS.iter().zip(seed..);
        let kinds = kinds.filter(|(kind, _)| options.scenes.iter().any(|of| of == kind.name()));
        let walks = kinds.map(|(kind, seed)| {
            let walk = Walk {
                kind: *kind,
                light: Lighting::Day,
                seed,
                span_s: [BEGIN_S, BEGIN_S + LENGTH_S],
                size: SIZE,
            };
            Ok((
                *kind,
                samples::samples(walk, sampling, options.samples.as_deref())?,
            ))
        });
        walks.collect()
    };
    let exam_sampling = Sampling {
        views: options.views,
        ..EXAM
    };
    let [fit_sampling, exam_sampling] = [FIT, exam_sampling].map(|of| options.sampling(of));
    let fit: Vec<Sample> = flat(of(FIT_SEED, fit_sampling)?);
    let exam = of(EXAM_SEED, exam_sampling)?;
    let by_kind: Vec<(Kind, usize)> = exam.iter().map(|(kind, own)| (*kind, own.len())).collect();
    let exam = flat(exam);
    let nearest = Nearest::fitted(&fit);
    let config = fit::fit(&fit);
    let mut rules = vec![
        ("measure", measure(&exam, &config)),
        (
            "measure, constants of the crate",
            measure(&exam, &MeasureConfig::default()),
        ),
        ("3 m and 30 degrees", Nearest::PUBLISHED.verdicts(&exam)),
    ];
    let fitted_name = nearest.map(|of| format!("{} m and {} degrees", of.distance_m, of.angle_deg));
    if let (Some(nearest), Some(name)) = (&nearest, &fitted_name) {
        rules.push((name, nearest.verdicts(&exam)));
    }
    rules.push(("transparency", above(&fit, &exam, rules::transparency)));
    let mut rows: Vec<Value> = rules
        .iter()
        .map(|(name, of)| row(name, &exam, of))
        .collect();
    // The first two rules predict a PSNR.
    for (row, (_, of)) in rows.iter_mut().zip(&rules).take(2) {
        row["mae_db"] = scores::mean_error_db(&exam, of).into();
    }
    for row in &rows {
        println!("{row}");
    }
    let ours = &rules[0].1;
    let fit_counts = counts(&fit, &measure(&fit, &config).flagged);
    let report = json!({
        "stamp": stamp::stamp("confidence", args)?,
        "fit": {
            "views": fit.len(),
            "counts": of_counts(&fit_counts),
            "constants": serde_json::to_value(config)?,
        },
        "views": exam.len(),
        "rows": rows,
        "by_offset": by_offset(&exam, ours),
        "by_scene": by_scene(&exam, &by_kind, ours),
        "pixels": pixels(&exam, &config),
    });
    println!("{report:#}");
    fs::create_dir_all(&options.out)
        .with_context(|| format!("making {}", options.out.display()))?;
    let path = options.out.join("confidence.json");
    fs::write(&path, format!("{report:#}\n")).with_context(|| format!("writing {}", path.display()))
}

fn flat(of: Vec<(Kind, Vec<Sample>)>) -> Vec<Sample> {
    of.into_iter().flat_map(|(_, samples)| samples).collect()
}

fn row(name: &str, samples: &[Sample], of: &Verdicts) -> Value {
    let counts = counts(samples, &of.flagged);
    // Root mean squared error of color, 0 to 1.
    let error = samples
        .iter()
        .map(|sample| libm::pow(10.0, -sample.errors.psnr_db / 20.0));
    let error: Vec<f64> = error.collect();
    let mut row = of_counts(&counts);
    row["rule"] = name.into();
    row["ause"] = scores::ause(&of.uncertainty, &error).into();
    row["spearman"] = scores::spearman(&of.uncertainty, &error).into();
    row
}

fn of_counts(of: &Counts) -> Value {
    let good = of.good_flagged + of.good_unflagged;
    json!({
        "bad_flagged": of.bad_flagged,
        "bad_unflagged": of.bad_unflagged,
        "good_flagged": of.good_flagged,
        "good_unflagged": of.good_unflagged,
        "good_flagged_share": of.good_flagged as f64 / good.max(1) as f64,
    })
}

/// Counts of each offset and angle.
fn by_offset(samples: &[Sample], of: &Verdicts) -> Vec<Value> {
    use crate::splats::off_path::{ANGLES_DEG, OFFSETS_M};
    let cases = OFFSETS_M
        .iter()
        .flat_map(|offset| ANGLES_DEG.iter().map(move |angle| (*offset, *angle)));
    let rows = cases.map(|(offset_m, angle_deg)| {
        let is_own = |sample: &Sample| {
            sample.errors.offset_m == offset_m && sample.errors.angle_deg == angle_deg
        };
        let mut row = of_counts(&counts_where(samples, of, is_own));
        row["offset_m"] = offset_m.into();
        row["angle_deg"] = angle_deg.into();
        row
    });
    rows.collect()
}

/// Counts of each scene.
fn by_scene(samples: &[Sample], kinds: &[(Kind, usize)], of: &Verdicts) -> Vec<Value> {
    let mut from = 0;
    let rows = kinds.iter().map(|(kind, count)| {
        let own = from..from + count;
        from += count;
        let mut row = of_counts(&counts(&samples[own.clone()], &of.flagged[own.clone()]));
        row["mae_db"] = scores::mean_error_db(&samples[own.clone()], &of.of(own)).into();
        row["scene"] = kind.name().into();
        row
    });
    rows.collect()
}

fn counts_where(samples: &[Sample], of: &Verdicts, is_own: impl Fn(&Sample) -> bool) -> Counts {
    let mut sum = Counts::default();
    for (sample, flagged) in samples.iter().zip(&of.flagged) {
        if is_own(sample) {
            let one = counts(std::slice::from_ref(sample), &[*flagged]);
            sum.bad_flagged += one.bad_flagged;
            sum.bad_unflagged += one.bad_unflagged;
            sum.good_flagged += one.good_flagged;
            sum.good_unflagged += one.good_unflagged;
        }
    }
    sum
}

/// Order of the pixels of single images: means over the images.
fn pixels(samples: &[Sample], config: &MeasureConfig) -> Value {
    let both: Vec<[f64; 2]> = samples
        .par_iter()
        .map(|sample| {
            let confidence = sample.channels.confidence(config).pixels;
            let uncertainty: Vec<f64> = confidence.iter().map(|c| -f64::from(*c)).collect();
            let error = sample.errors.pixel_errors.iter();
            let error: Vec<f64> = error.map(|e| f64::from(*e)).collect();
            [
                scores::ause(&uncertainty, &error),
                scores::spearman(&uncertainty, &error),
            ]
        })
        .collect();
    let mean = |k: usize| {
        let finite = both.iter().map(|of| of[k]).filter(|v| v.is_finite());
        let all: Vec<f64> = finite.collect();
        all.iter().sum::<f64>() / all.len() as f64
    };
    json!({ "ause": mean(0), "spearman": mean(1) })
}

struct Options {
    quick: bool,
    scenes: Vec<String>,
    views: usize,
    samples: Option<PathBuf>,
    out: PathBuf,
}

impl Options {
    fn parse(args: &[String]) -> Result<Self> {
        let mut parsed = Self {
            quick: false,
            scenes: KINDS.map(|kind| kind.name().to_owned()).to_vec(),
            views: EXAM.views,
            samples: None,
            out: PathBuf::from("docs/benchmarks"),
        };
        let mut rest = args.iter();
        while let Some(argument) = rest.next() {
            let mut value = || {
                rest.next()
                    .with_context(|| format!("{argument} needs a value"))
            };
            match argument.as_str() {
                "--quick" => parsed.quick = true,
                "--scenes" => {
                    parsed.scenes = value()?.split(',').map(str::to_owned).collect();
                }
                "--views" => parsed.views = value()?.parse().context("reading --views")?,
                "--samples" => parsed.samples = Some(value()?.into()),
                "--out" => parsed.out = value()?.into(),
                other => bail!(
                    "unknown argument {other:?}, expected --quick, --scenes, --views, --samples or \
                     --out"
                ),
            }
        }
        if parsed.quick {
            parsed.scenes.truncate(1);
        }
        Ok(parsed)
    }

    fn sampling(&self, of: Sampling) -> Sampling {
        match self.quick {
            true => Sampling {
                steps: 200,
                views: 2,
            },
            false => of,
        }
    }
}
