//! `sim_images`: similarity of simulated and real images, in numbers.
//!
//! A walk through each scene by day is rendered with its ground truth, at the quality for tests. A
//! Python program (`sim_images.py` beside this file, whose head documents the measures) computes
//! the same statistics of these images and of the real ones of the data folder: gradients,
//! spectrum, noise, stereo matching by OpenCV, length of feature tracks. The table marks which of
//! the simulated ones are within the range of the real ones.

use std::fs;
use std::path::Path;
use std::process::Command;
use std::sync::Arc;

use anyhow::{Context, Result, ensure};
use cad_transforms::rig::Rig;
use rig_sim::camera::Quality;
use rig_sim::faults::Faults;
use rig_sim::render::{Job, render};
use rig_sim::scene::{Kind, Lighting};
use rig_sim::simulation::{Settings, Simulation};
use serde_json::Value;

use crate::arguments::Arguments;
use crate::{python, stamp};

const RIG: &str = include_str!("../../../../cad-transforms/rigs/example.toml");

/// Runs the benchmark: `[--quick] [--out DIR]`.
///
/// # Errors
/// Bad arguments, no interpreter in `PAWS_PYTHON`, no real images in `PAWS_DATA`, or an I/O error.
/// Images unlike real ones are a result and not an error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let Arguments { quick, out } = Arguments::parse(args)?;
    // A quick run has the number of frames through which features are tracked.
    let seconds = if quick { 0.67 } else { 2.0 };
    let python = python::interpreter()?;
    let data = std::env::var_os("PAWS_DATA")
        .context("PAWS_DATA names no folder of real recordings to compare with")?;
    fs::create_dir_all(&out).with_context(|| format!("making {}", out.display()))?;
    let stamp = stamp::stamp("sim_images", args)?;
    let walks = tempfile::tempdir().context("making a folder for the walks")?;
    for kind in Kind::ALL {
        eprintln!("{} ...", kind.name());
        walk(kind, seconds, &walks.path().join(kind.name()))?;
    }
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/sim_images.py");
    let results = out.join("sim_images.json");
    let status = Command::new(python)
        .arg(&script)
        .arg(walks.path())
        .arg(data)
        .arg(&results)
        .status()
        .context("starting Python")?;
    ensure!(status.success(), "the statistics ended with {status}");

    let reading = || format!("reading {}", results.display());
    let text = fs::read_to_string(&results).with_context(reading)?;
    let mut report: Value = serde_json::from_str(&text).with_context(reading)?;
    report["stamp"] = stamp;
    let text = serde_json::to_string_pretty(&report)? + "\n";
    fs::write(&results, text).with_context(|| format!("writing {}", results.display()))?;
    println!("results: {}", results.display());
    Ok(())
}

fn walk(kind: Kind, seconds: f64, folder: &Path) -> Result<()> {
    let rig = Rig::parse(RIG)?;
    let settings = Settings {
        kind,
        lighting: Lighting::Day,
        seed: 1,
        seconds,
        rate_hz: 15.0,
        width: 672,
        height: 376,
        quality: Quality::ACCURATE,
    };
    let simulation = Arc::new(Simulation::new(&settings, &rig)?);
    let job = Job {
        rig: &rig,
        rig_text: RIG,
        session: false,
        faults: &Faults::default(),
        truth: true,
        threads: 2,
    };
    render(&simulation, &job, folder, &|| {})?;
    Ok(())
}
