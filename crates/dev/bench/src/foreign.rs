//! `foreign`: depth, odometry and the check of a calibration on the images of another renderer.
//!
//! A walk of 10 s through a hall, rendered by Mitsuba 3 (`foreign/render.py`: path tracing, thin
//! lens, open shutter) with the samples of an IMU, in EuRoC's format. Nothing of it is from our own
//! simulator: neither images, nor textures, nor motion, nor the noise. Its images are still not
//! real ones. 240 images, 36 samples per pixel; existing images are kept, so that a run
//! that was ended goes on where it was.
//!
//! 1. `odometry`: causal and adjusted poses of the presets, with and without the IMU, and with the
//!    right eye of the nominal calibration rotated.
//! 2. `depth`: our settings and OpenCV's matchers as in the benchmark `depth`, and coverage of the
//!    stated sigmas in each quarter of them.
//! 3. `calibration`: the check of the calibration as it is and with the right eye rotated.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail, ensure};
use harness::sequences::{self, Sequence};
use serde_json::{Value, json};

mod calibration;
mod depth;
mod odometry;
mod table;

use crate::depth::charts;
use crate::{python, stamp};

const WALK: &str = "target/foreign/walk";
const TRUTH: &str = "mav0/state_groundtruth_estimate0/data.csv";
/// Stereo pairs of a quick run.
const QUICK_PAIRS: usize = 30;

/// The rendered walk.
struct Walk {
    folder: PathBuf,
    sequence: Sequence,
}

/// Runs the benchmark: `[--quick] [--walk DIR] [--out DIR]`.
///
/// # Errors
/// Bad arguments, no interpreter in `PAWS_RENDERER_PYTHON` or `PAWS_PYTHON`, or an I/O error. A
/// poor result is a result.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let (mut quick, mut folder) = (false, PathBuf::from(WALK));
    let mut out = PathBuf::from("docs/benchmarks");
    let mut rest = args.iter();
    while let Some(argument) = rest.next() {
        match argument.as_str() {
            "--quick" => quick = true,
            "--walk" => folder = rest.next().context("--walk needs a folder")?.into(),
            "--out" => out = rest.next().context("--out needs a folder")?.into(),
            other => {
                bail!("unknown argument {other:?}, expected --quick, --walk DIR or --out DIR")
            }
        }
    }
    render(&folder, quick)?;
    let sequence = sequences::euroc(&folder, &folder.join(TRUTH), None)?;
    let sequence = match quick {
        true => sequence.first(QUICK_PAIRS),
        false => sequence,
    };
    let log = folder.join("render.json");
    let text = fs::read_to_string(&log).with_context(|| format!("reading {}", log.display()))?;
    let rendering: Value =
        serde_json::from_str(&text).with_context(|| format!("reading {}", log.display()))?;
    let walk = Walk { folder, sequence };
    let report = json!({
        "benchmark": "foreign",
        "stamp": stamp::stamp("foreign", args)?,
        "pairs": walk.sequence.len(),
        "rendering": rendering,
        "odometry": odometry::rows(&walk.sequence)?,
        "depth": depth::results(&walk)?,
        "calibration": calibration::rows(&walk)?,
    });
    let table = table::table(&report);
    print!("{table}");
    fs::create_dir_all(&out).with_context(|| format!("making {}", out.display()))?;
    let mut files = vec![
        ("foreign.json".to_owned(), format!("{report:#}\n")),
        ("foreign.md".to_owned(), table),
    ];
    let foot = stamp::source(&report["stamp"]);
    for (name, chart) in charts::race(&report["depth"]["race"], "a foreign renderer (Mitsuba)")? {
        let svg = chart.footnote(&foot).to_svg(charts::WIDTH, charts::HEIGHT);
        files.push((format!("foreign-depth-{name}.svg"), svg));
    }
    for (name, text) in files {
        let path = out.join(name);
        fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
    }
    Ok(())
}

/// Renders the images that are not there yet.
fn render(folder: &Path, quick: bool) -> Result<()> {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/foreign/render.py");
    let mut command = Command::new(python::interpreter_in(python::RENDERER)?);
    command.arg("-B").arg(&script).arg(folder);
    if quick {
        command.args(["--pairs", &QUICK_PAIRS.to_string()]);
    }
    let status = command.status().context("starting the renderer")?;
    ensure!(status.success(), "the renderer ended with {status}");
    Ok(())
}
