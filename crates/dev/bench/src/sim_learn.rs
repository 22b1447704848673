//! `sim_learn`: what learns from the Python package of the simulators, and how fast it steps.
//!
//! 1. `speed`: steps of 1024 environments together through `VectorEnv.step`, at least 1 % of which
//!    reset.
//! 2. `state`: PPO of Stable-Baselines3 on the state alone, with one thread of PyTorch: goals up to
//!    5 m with obstacles and a detour of at least 1.1. A second run of the same seed must give the
//!    same curve.
//! 3. `images`: a policy that sees 48x36 px of color and depth, the same network with black images,
//!    and random actions; differences of returns in their standard deviations.
//! 4. `trainers`: the real runners of Stable-Baselines3 and RSL-RL through the adapters of the
//!    package.
//!
//! 200 goals that no training saw are the exam of 2 to 4.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use serde_json::{Value, json};

mod charts;
mod summary;

use crate::{arguments, python, report, stamp};

const PARTS: [&str; 4] = ["speed", "state", "images", "trainers"];
const EXAMPLES: &str = "simulation/python/examples";
const DEMO: &str = "target/demo/walk.scene";
/// Goals of the exam; a quick run only shows that everything works.
const GOALS: usize = 200;
const QUICK_GOALS: usize = 50;
const QUICK_STEPS: usize = 4096;
/// Steps of a training at most.
const STATE_STEPS: usize = 200_000;
const IMAGE_STEPS: usize = 100_000;
const TRAINER_STEPS: usize = 100_000;
const ENVIRONMENTS: usize = 1024;
const MEASURED_STEPS: usize = 300;
const QUICK_MEASURED_STEPS: usize = 20;

/// Runs the benchmark: `[--quick] [--only PART,...] [--scene PATH] [--out DIR]`. Parts that are not
/// run keep their results. Without the scene of the demo only the synthetic room is used.
///
/// # Errors
/// Bad arguments, an I/O error, or no interpreter with the package. A missed goal is a result and
/// no error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let options = Options::parse(args)?;
    let scenes = scenes(&options.scene)?;
    fs::create_dir_all(&options.out)
        .with_context(|| format!("making {}", options.out.display()))?;
    let path = options.out.join("sim_learn.json");
    let mut whole = report::read(&path)?;
    for part in &options.parts {
        let question = question(part, &scenes, options.quick)?;
        let script = format!("sim_learn/{part}.py");
        let answer = python::ask_in(python::LEARNING, &script, &question)?;
        let rows = answer["rows"].as_array().context("rows of the answer")?;
        ensure!(!rows.is_empty(), "no rows in the answer of {script}");
        for row in rows {
            println!("{part}, {}", summary::line(part, row));
        }
        let entry = json!({
            "stamp": stamp::stamp("sim_learn", args)?,
            "packages": answer["packages"],
            "goals": summary::goals(part),
            "rows": rows,
        });
        whole.insert(part.clone(), entry);
        report::write(&path, &whole)?;
        report::write_charts(&options.out, charts::draw(&whole))?;
    }
    Ok(())
}

/// Scenes by name, as the package opens them.
fn scenes(scene: &Path) -> Result<Value> {
    let mut scenes = json!({ "room": "synthetic:room" });
    match scene.is_dir() {
        true => scenes["walk"] = json!(fs::canonicalize(scene)?),
        false => println!("no scene at {}, its part is left out", scene.display()),
    }
    Ok(scenes)
}

/// The folder of the repository.
fn root() -> Result<&'static Path> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(3);
    root.context("the workspace's folder")
}

/// What the script of a part is to do.
fn question(part: &str, scenes: &Value, quick: bool) -> Result<Value> {
    let steps = match part {
        _ if quick => QUICK_STEPS,
        "state" => STATE_STEPS,
        "images" => IMAGE_STEPS,
        _ => TRAINER_STEPS,
    };
    Ok(json!({
        "examples": root()?.join(EXAMPLES),
        "scenes": scenes,
        "seed": 0,
        "steps": steps,
        "goals": if quick { QUICK_GOALS } else { GOALS },
        "environments": ENVIRONMENTS,
        "measured_steps": if quick { QUICK_MEASURED_STEPS } else { MEASURED_STEPS },
    }))
}

struct Options {
    quick: bool,
    parts: Vec<String>,
    scene: PathBuf,
    out: PathBuf,
}

impl Options {
    fn parse(args: &[String]) -> Result<Self> {
        let mut parsed = Self {
            quick: false,
            parts: PARTS.map(str::to_owned).to_vec(),
            scene: root()?.join(DEMO),
            out: PathBuf::from("docs/benchmarks"),
        };
        let mut rest = args.iter();
        while let Some(argument) = rest.next() {
            match argument.as_str() {
                "--quick" => parsed.quick = true,
                "--only" => parsed.parts = arguments::parts(rest.next(), &PARTS)?,
                "--scene" => parsed.scene = rest.next().context("--scene needs a path")?.into(),
                "--out" => parsed.out = rest.next().context("--out needs a folder")?.into(),
                other => bail!(
                    "unknown argument {other:?}, expected --quick, --only PARTS, --scene PATH or \
                     --out DIR"
                ),
            }
        }
        Ok(parsed)
    }
}
