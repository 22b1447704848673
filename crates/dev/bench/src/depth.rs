//! `depth`: stereo depth, ours beside OpenCV's matchers, in one run on the same images with the
//! same disparity range.
//!
//! 1. `motorcycle`: a real pair (Middlebury), and `halved`: the same, reduced by area. Errors
//!    over time, of every mode of OpenCV's BM and SGBM and of our presets and settings between
//!    them. A point of OpenCV's is *beaten* if one of ours takes no longer, has at least the same
//!    density, and fewer pixels with an error of more than 2 px ("bad-2").
//! 2. `simulated`: the same on held-out frames of simulated walks, by day and at night.
//! 3. `imperfect`: the same on frames of held-out walks with what real cameras and scenes add
//!    ([`imperfect`]).
//! 4. `driving`: density of real driving pairs without ground truth, and the share that the
//!    neighboring frames confirm ([`driving`]).
//! 5. `rate`: pairs of 640x480 with 128 disparities per second.
//! 6. `bands`: time saved by restricting the disparity range to the needs of a scene, and the loss
//!    of answers.
//! 7. `sigma`: ratio of errors within two of the stated sigmas, in every quarter of the sigma.
//!
//! All use two threads. Times are medians; ours and theirs alternate. `--fit` refits the sigmas of
//! the presets on other walks, and prints their tables (`crates/vision/depth/src/sigma/tables.rs`).

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use serde_json::json;

mod bands;
mod changes;
pub(crate) mod charts;
pub(crate) mod coverage;
mod driving;
mod fit_sigma_model;
pub(crate) mod frames;
mod imperfect;
pub(crate) mod peers;
pub(crate) mod race;
mod real;
mod test_set;

use crate::{arguments, report, stamp};
use frames::Frame;
use peers::{Peers, SgbmConfig};
use race::Race;

const PARTS: [&str; 8] = [
    "motorcycle",
    "halved",
    "simulated",
    "imperfect",
    "driving",
    "rate",
    "bands",
    "sigma",
];

/// Runs the benchmark: `[--quick] [--only PART,...] [--fit] [--out DIR]`.
///
/// # Errors
/// Bad arguments, no interpreter in `PAWS_PYTHON`, images that cannot be read, or an I/O error. A
/// missed target is a result and no error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let options = Options::parse(args)?;
    if options.fits {
        println!("{}", fit_sigma_model::fit()?);
        return Ok(());
    }
    fs::create_dir_all(&options.out)
        .with_context(|| format!("making {}", options.out.display()))?;
    let stamp = stamp::stamp("depth", args)?;
    // Results of other runs are kept.
    let path = options.out.join("depth.json");
    let mut report = report::read(&path)?;
    let needs = |part: &str| options.parts.iter().any(|p| p == part);
    let places = test_set::held_out(options.quick);
    let held_out = match needs("simulated") || needs("sigma") {
        true => test_set::render(&places)?,
        false => Vec::new(),
    };
    let imperfect = match needs("imperfect") || needs("sigma") {
        true => test_set::render_imperfect(options.quick)?,
        false => Vec::new(),
    };
    for part in &options.parts {
        let found = match part.as_str() {
            "motorcycle" | "halved" => {
                let Some(mut frame) = motorcycle()? else {
                    continue;
                };
                if part == "halved" {
                    frame = real::halved(&frame);
                }
                let race = Race::run(
                    &mut Peers::start()?,
                    &SgbmConfig::many(),
                    &[&frame],
                    options.runs(),
                )?;
                race.print(part);
                race.json()
            }
            "simulated" => {
                let frames: Vec<&Frame> = held_out.iter().map(|(_, frame)| frame).collect();
                let race = Race::run(&mut Peers::start()?, &SgbmConfig::few(), &frames, 1)?;
                race.print(part);
                race.json()
            }
            "imperfect" => {
                let frames: Vec<&Frame> = imperfect.iter().map(|(_, frame)| frame).collect();
                let race = Race::run(&mut Peers::start()?, &SgbmConfig::few(), &frames, 1)?;
                race.print(part);
                race.json()
            }
            "driving" => match harness::data::sets([driving::SEQUENCE]) {
                Ok([folder]) => driving::run(&folder, options.quick)?,
                Err(reason) => {
                    eprintln!("{reason}");
                    continue;
                }
            },
            "rate" => race::rate(options.quick)?,
            "bands" => bands::bands(options.quick)?,
            _ => {
                let mut groups = fit_sigma_model::check(&places, &held_out)?;
                groups.extend(fit_sigma_model::imperfect(&imperfect)?);
                if let Some(frame) = motorcycle()? {
                    groups.extend(fit_sigma_model::alone(&frame)?);
                    groups.extend(fit_sigma_model::alone(&real::halved(&frame))?);
                }
                fit_sigma_model::json(groups)
            }
        };
        report.insert(part.clone(), json!({ "stamp": stamp, "found": found }));
        report::write(&path, &report)?;
    }
    report::write_charts(&options.out, charts::draw(&report)?)?;
    Ok(())
}

/// The real pair; `None`, with a printed reason, if it is missing.
fn motorcycle() -> Result<Option<Frame>> {
    match harness::data::sets([real::MOTORCYCLE]) {
        Ok([folder]) => real::motorcycle(&folder).map(Some),
        Err(reason) => {
            eprintln!("{reason}");
            Ok(None)
        }
    }
}

struct Options {
    quick: bool,
    fits: bool,
    out: PathBuf,
    parts: Vec<String>,
}

impl Options {
    fn parse(args: &[String]) -> Result<Self> {
        let mut parsed = Self {
            quick: args.iter().any(|a| a == "--quick"),
            fits: false,
            out: PathBuf::from("docs/benchmarks"),
            parts: PARTS.map(str::to_owned).to_vec(),
        };
        let mut rest = args.iter();
        while let Some(argument) = rest.next() {
            match argument.as_str() {
                "--quick" => {}
                "--fit" => parsed.fits = true,
                "--out" => parsed.out = rest.next().context("--out needs a folder")?.into(),
                "--only" => parsed.parts = arguments::parts(rest.next(), &PARTS)?,
                other => bail!(
                    "unknown argument {other:?}, expected --quick, --only PARTS, --fit or --out DIR"
                ),
            }
        }
        Ok(parsed)
    }

    /// Number of times that each pair is matched.
    fn runs(&self) -> usize {
        if self.quick { 1 } else { 7 }
    }
}
