//! `sim_truth`: what the simulators say of reconstructed walks, against the truth of the simulated
//! ones and never against our own mesh.
//!
//! Walks, seeds and spans are used by no test and no other benchmark. Poses and masks are true,
//! depth is that of stereo with the preset `balanced`; surface, maps and Gaussians are made as by
//! the stages, with their constants.
//!
//! 1. `heights`: heights of the ground on which agents walk, near footsteps and elsewhere.
//! 2. `depth`: depth images of the simulator's cameras, at and off the path.
//! 3. `exact`: depth images of synthetic scenes, whose surfaces are known, with all lenses.
//! 4. `support`: the predicted PSNR of what agents see, at starts of episodes.
//! 5. `seam`: two reconstructions of one place, each with poses of its own odometry, joined by an
//!    imported edge.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use rig_sim::scene::{Kind, Lighting};
use serde_json::json;

mod charts;
mod depth;
mod exact;
mod heights;
mod seam;
mod support;

use crate::terrain::walks::{SMALL, Walk};
use crate::{arguments, report, stamp};

const PARTS: [&str; 5] = ["heights", "depth", "exact", "support", "seam"];
/// Kind, seed, and begin and end, s.
const WALKS: [(Kind, u64, [f64; 2]); 4] = [
    (Kind::Pavement, 981, [3.0, 23.0]),
    (Kind::Stairs, 982, [3.0, 23.0]),
    (Kind::Trail, 983, [3.0, 23.0]),
    (Kind::Room, 984, [0.0, 20.0]),
];
const QUICK_S: f64 = 6.0;

/// Runs the benchmark: `[--quick] [--only PART,...] [--walks KIND,...] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error. A missed goal is a result and no error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let options = Options::parse(args)?;
    fs::create_dir_all(&options.out)
        .with_context(|| format!("making {}", options.out.display()))?;
    let stamp = stamp::stamp("sim_truth", args)?;
    let path = options.out.join("sim_truth.json");
    let mut report = report::read(&path)?;
    for part in &options.parts {
        let mut rows = Vec::new();
        let walks = match part.as_str() {
            "exact" => {
                rows = exact::measure(options.quick).context("scenes with exact surfaces")?;
                &[]
            }
            "seam" => &[seam::WALK][..],
            _ => &options.walks,
        };
        for walk in walks {
            let found = match part.as_str() {
                "heights" => heights::measure(*walk),
                "depth" => depth::measure(*walk, options.quick),
                "support" => support::measure(*walk, options.quick),
                _ => seam::measure(*walk, options.quick),
            };
            let mut row = found.with_context(|| format!("{part} of {}", walk.name()))?;
            row["walk"] = walk.kind.name().into();
            row["seed"] = walk.seed.into();
            println!("{row:#}");
            rows.push(row);
        }
        report.insert(part.clone(), json!({ "stamp": stamp, "rows": rows }));
        report::write(&path, &report)?;
    }
    report::write_charts(&options.out, charts::draw(&report))
}

struct Options {
    quick: bool,
    parts: Vec<String>,
    walks: Vec<Walk>,
    out: PathBuf,
}

impl Options {
    fn parse(args: &[String]) -> Result<Self> {
        let mut options = Self {
            quick: false,
            parts: PARTS.map(str::to_owned).to_vec(),
            walks: Vec::new(),
            out: PathBuf::from("docs/benchmarks"),
        };
        let names = WALKS.map(|(kind, ..)| kind.name());
        let mut walks = names.map(str::to_owned).to_vec();
        let mut rest = args.iter();
        while let Some(argument) = rest.next() {
            match argument.as_str() {
                "--quick" => options.quick = true,
                "--only" => options.parts = arguments::parts(rest.next(), &PARTS)?,
                "--walks" => walks = arguments::parts(rest.next(), &names)?,
                "--out" => options.out = rest.next().context("--out needs a folder")?.into(),
                other => bail!(
                    "unknown argument {other:?}, expected --quick, --only PARTS, --walks KINDS or \
                     --out DIR"
                ),
            }
        }
        let own = WALKS.iter();
        let own = own.filter(|(kind, ..)| walks.iter().any(|name| name == kind.name()));
        options.walks = own
            .map(|(kind, seed, [from, to])| Walk {
                kind: *kind,
                light: Lighting::Day,
                seed: *seed,
                span_s: match options.quick {
                    true => [*from, from + QUICK_S],
                    false => [*from, *to],
                },
                size: SMALL,
            })
            .collect();
        Ok(options)
    }
}
