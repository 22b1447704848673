//! `sim_step`: steps per second of agents on the ground, without images.
//!
//! A step has everything that a learner needs: motion with collisions, height and tilt of the
//! ground, deviation of the camera from recorded ones, reward, ends and the state observation with
//! its scan of heights and its rays. Environments that end are reset; episodes are at most 50
//! steps. The share of resets is reported. Actions are random.
//!
//! 1. `throughput`: over 1 to 4096 environments and 1 and 2 threads, with latency of a call.
//! 2. `memory`: resident memory, files and threads over 10^6 steps with changes of sectors.
//! 3. `costs`: time of single look-ups.

use std::fs;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use anyhow::{Context, Result, bail};
use serde_json::json;
use simulation::SceneData;
use simulation::testing::SyntheticScene;

mod charts;
mod costs;
mod memory;
mod throughput;
mod world;

use crate::{arguments, report, stamp};

const PARTS: [&str; 3] = ["throughput", "memory", "costs"];

/// Runs the benchmark: `[--quick] [--only PART,...] [--scene PATH] [--out DIR]`.
///
/// # Errors
/// Bad arguments, a scene that cannot be opened, or an I/O error. A missed target is a result and
/// no error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let options = Options::parse(args)?;
    fs::create_dir_all(&options.out)
        .with_context(|| format!("making {}", options.out.display()))?;
    let stamp = stamp::stamp("sim_step", args)?;
    let scenes = scenes(&options.scene)?;
    let path = options.out.join("sim_step.json");
    let mut report = report::read(&path)?;
    for part in &options.parts {
        let mut rows = Vec::new();
        for (name, scene) in &scenes {
            let found = match part.as_str() {
                "throughput" => throughput::measure(scene, options.quick),
                "memory" => memory::measure(scene, options.quick),
                _ => costs::measure(scene, options.quick),
            };
            let found = found.with_context(|| format!("{part} on {name}"))?;
            let row = json!({ "scene": name, "found": found });
            println!("{row:#}");
            rows.push(row);
        }
        report.insert(part.clone(), json!({ "stamp": stamp, "rows": rows }));
        report::write(&path, &report)?;
    }
    let chart = report.get("throughput").and_then(charts::throughput);
    let charts = chart.map(|svg| ("sim_step-throughput.svg".to_owned(), svg));
    report::write_charts(&options.out, charts.into_iter().collect())
}

/// Scenes with their names: a synthetic one of four sectors, and a reconstructed one.
fn scenes(path: &Path) -> Result<Vec<(String, Arc<SceneData>)>> {
    let synthetic = SyntheticScene::corridor_loop()?.scene;
    let mut scenes = vec![("synthetic corridor".to_owned(), synthetic)];
    match path.exists() {
        true => {
            let scene = SceneData::open(path)?;
            scenes.push(("reconstructed walk".to_owned(), Arc::new(scene)));
        }
        false => eprintln!(
            "no reconstructed scene, its rows are left out; `cargo xtask demo` makes {}",
            path.display()
        ),
    }
    Ok(scenes)
}

struct Options {
    quick: bool,
    parts: Vec<String>,
    scene: PathBuf,
    out: PathBuf,
}

impl Options {
    fn parse(args: &[String]) -> Result<Self> {
        let mut options = Self {
            quick: false,
            parts: PARTS.map(str::to_owned).to_vec(),
            scene: PathBuf::from("target/demo/walk.scene"),
            out: PathBuf::from("docs/benchmarks"),
        };
        let mut rest = args.iter();
        while let Some(argument) = rest.next() {
            match argument.as_str() {
                "--quick" => options.quick = true,
                "--only" => options.parts = arguments::parts(rest.next(), &PARTS)?,
                "--scene" => options.scene = rest.next().context("--scene needs a path")?.into(),
                "--out" => options.out = rest.next().context("--out needs a folder")?.into(),
                other => bail!(
                    "unknown argument {other:?}, expected --quick, --only PARTS, --scene PATH or \
                     --out DIR"
                ),
            }
        }
        Ok(options)
    }
}
