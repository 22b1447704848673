//! `sim_render`: images per second of the simulator's cameras on a reconstructed scene, with their
//! PSNR to the exact renderer.
//!
//! 1. `sizes`: PAWS-Sim's table: 64 to 1024 px and 1280x720, colors and depth, over the size of a
//!    batch. Poses are recorded ones with offsets up to 3 m and 30 degrees; views with more than
//!    half sky or a surface nearer than 0.5 m are drawn again. Images are 8 bits per channel, depth
//!    in f32 and a mask, in memory of the caller: what a copy to Python would start from.
//! 2. `episode`: Beogym's: 1280x720 on one thread, 200 steps of an agent on the ground with motion
//!    and look-ups in the map.
//! 3. `support`: predicted and real PSNR of held-out views, and the grid of predictions over the
//!    ground: its cost, and where it lets episodes start and ends them.
//! 4. `changes`: frames at changes of sectors, loaded ahead, cross-faded and cold, on a synthetic
//!    loop of four sectors.
//!
//! Beside the elapsed time stands the processor time, which other load of the machine changes less.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};
use serde_json::Value;

mod changes;
mod charts;
mod episode;
mod opened_scene;
mod sizes;
mod support;
mod support_charts;

use crate::{arguments, report, stamp};
use opened_scene::OpenedScene;

const PARTS: [&str; 4] = ["sizes", "episode", "support", "changes"];
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
        let mut row = match part.as_str() {
            "changes" => changes::measure(options.quick)?,
            _ => of_scene(part, &mut scene, &options)?,
        };
        row["stamp"] = stamp.clone();
        println!("{row:#}");
        report.insert(part.clone(), row);
        report::write(&path, &report)?;
    }
    report::write_charts(&options.out, charts::draw(&report))?;
    Ok(())
}

/// A part that is measured on the scene, which is opened for the first of them.
fn of_scene(part: &str, opened: &mut Option<OpenedScene>, options: &Options) -> Result<Value> {
    let scene = match opened {
        Some(scene) => scene,
        None => opened.insert(OpenedScene::new(&options.scene)?),
    };
    let mut row = match part {
        "sizes" => sizes::measure(scene, options.quick)?,
        "episode" => episode::measure(scene, options.quick)?,
        _ => support::measure(scene)?,
    };
    row["scene"] = scene.row();
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
            parsed.scene.exists() || parsed.parts == ["changes"],
            "there is no scene {}: `cargo xtask demo` makes one, or name another with --scene",
            parsed.scene.display()
        );
        Ok(parsed)
    }
}
