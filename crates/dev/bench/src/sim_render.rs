//! `sim_render`: images per second of the simulator's cameras on a reconstructed scene, with their
//! PSNR to the exact renderer.
//!
//! 1. `sizes`: PAWS-Sim's table: 64 to 1024 px and 1280x720, colors and depth, over the size of a
//!    batch, and over the PSNR with other settings of the levels of detail. Poses are recorded ones
//!    with offsets up to 3 m and 30 degrees; views with more than half sky or a surface nearer than
//!    0.5 m are drawn again. Images are 8 bits per channel, depth in f32 and a mask, in memory of
//!    the caller: what a copy to Python would start from.
//! 2. `episode`: Beogym's: 1280x720 on one thread, 200 steps of an agent on the ground with motion,
//!    look-ups in the map and the changes of sector that lie on its path.
//! 3. `support`: PSNR of held-out views by their distance and angle from recorded ones, and the
//!    error of the support map on views that it was not fitted to.
//! 4. `changes`: frames at changes of sectors, loaded ahead, cross-faded and cold, on a synthetic
//!    loop of four sectors, and on the scene if it has several.
//! 5. `memory`: resident memory while Gaussians are loaded and leave, on the same two.
//!
//! Beside the elapsed time stands the processor time, which other load of the machine changes less.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};
use serde_json::Value;

mod changes;
mod charts;
mod episode;
mod memory;
mod opened_scene;
mod route;
mod sizes;
mod support;

use crate::{arguments, report, stamp};
use opened_scene::OpenedScene;

const PARTS: [&str; 5] = ["sizes", "episode", "support", "changes", "memory"];
/// Parts that are measured without a scene too.
const SYNTHETIC: [&str; 2] = ["changes", "memory"];
const DEMO: &str = "target/demo/walk.scene";

/// Runs the benchmark: `[--quick] [--only PART,...] [--scene PATH] [--out DIR]`.
///
/// # Errors
/// Bad arguments, a scene that cannot be opened, or an I/O error. A missed target is a result and
/// no error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let options = Options::parse(args)?;
    fs::create_dir_all(&options.out)
        .with_context(|| format!("making {}", options.out.display()))?;
    let stamp = stamp::stamp("sim_render", args)?;
    let mut scene = None;
    let path = options.out.join("sim_render.json");
    let mut report = report::read(&path)?;
    for part in &options.parts {
        let mut row = of_scene(part, &mut scene, &options)?;
        row["stamp"] = stamp.clone();
        println!("{row:#}");
        report.insert(part.clone(), row);
        report::write(&path, &report)?;
    }
    report::write_charts(&options.out, charts::draw(&report))?;
    Ok(())
}

/// A part, measured on the scene, which is opened for the first of them.
fn of_scene(part: &str, opened: &mut Option<OpenedScene>, options: &Options) -> Result<Value> {
    if opened.is_none() && options.scene.exists() {
        *opened = Some(OpenedScene::new(&options.scene)?);
    }
    let recorded = opened.as_ref().map(|scene| &scene.scene);
    let mut row = match (part, opened.as_ref()) {
        ("changes", _) => changes::measure(recorded, options.quick)?,
        ("memory", _) => memory::measure(recorded, options.quick)?,
        ("sizes", Some(scene)) => sizes::measure(scene, options.quick)?,
        ("episode", Some(scene)) => episode::measure(scene, options.quick)?,
        (_, Some(scene)) => support::measure(scene, &options.out)?,
        (_, None) => bail!("{part} needs a scene"),
    };
    row["scene"] = opened.as_ref().map_or(Value::Null, OpenedScene::row);
    Ok(row)
}

struct Options {
    out: PathBuf,
    scene: PathBuf,
    parts: Vec<String>,
    quick: bool,
}

impl Options {
    fn parse(args: &[String]) -> Result<Self> {
        let mut parsed = Self {
            out: PathBuf::from("docs/benchmarks"),
            scene: PathBuf::from(DEMO),
            parts: PARTS.map(str::to_owned).to_vec(),
            quick: false,
        };
        let mut rest = args.iter();
        while let Some(argument) = rest.next() {
            match argument.as_str() {
                "--quick" => parsed.quick = true,
                "--out" => parsed.out = rest.next().context("--out needs a folder")?.into(),
                "--scene" => parsed.scene = rest.next().context("--scene needs a path")?.into(),
                "--only" => parsed.parts = arguments::parts(rest.next(), &PARTS)?,
                other => bail!(
                    "unknown argument {other:?}, expected --quick, --only PARTS, --scene PATH or \
                     --out DIR"
                ),
            }
        }
        ensure!(
            parsed.scene.exists()
                || parsed
                    .parts
                    .iter()
                    .all(|own| SYNTHETIC.contains(&own.as_str())),
            "there is no scene {}: `cargo xtask demo` makes one, or name another with --scene",
            parsed.scene.display()
        );
        Ok(parsed)
    }
}
