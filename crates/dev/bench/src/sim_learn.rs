//! `sim_learn`: what learns from the Python package of the simulators, and how fast it steps.
//!
//! PPO of Stable-Baselines3 trains on the state alone with one thread of PyTorch: goals up to 5 m
//! with obstacles and a detour of at least 1.1. 200 goals of another seed are the exam. A second
//! run of the same seed must give the same curve. Beside it: steps of 1024 environments together
//! through `VectorEnv.step`, with at least 1 % of them resetting.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use serde_json::{Value, json};

use crate::{python, stamp};

const SCRIPT: &str = "sim_learn.py";
const EXAMPLE: &str = "simulation/python/examples/train_point_goal.py";
const DEMO: &str = "target/demo/walk.scene";
/// Goals of the exam, and steps of the training at most.
const GOALS: usize = 200;
const STEPS: usize = 200_000;
const ENVIRONMENTS: usize = 1024;
const MEASURED_STEPS: usize = 300;
/// Required success before and after the training.
const SUCCESS: [f64; 2] = [0.10, 0.80];
/// Required steps per second, and resets per step.
const SPEED: [f64; 2] = [200_000.0, 0.01];

/// Runs the benchmark: `[--quick] [--scene PATH] [--out DIR]`. `--quick` measures the speed only.
/// Without the scene of the demo only the synthetic room is used.
///
/// # Errors
/// Bad arguments, an I/O error, or no interpreter with the package. A missed goal is a result and
/// no error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let options = Options::parse(args)?;
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(3);
    let root = root.context("the workspace's folder")?;
    let mut scenes = json!({ "room": "synthetic:room" });
    let scene = options.scene.unwrap_or_else(|| root.join(DEMO));
    match scene.is_dir() {
        true => scenes["walk"] = json!(fs::canonicalize(&scene)?),
        false => println!("no scene at {}, its part is left out", scene.display()),
    }
    let question = json!({
        "example": root.join(EXAMPLE),
        "scenes": scenes,
        "steps": if options.quick { 0 } else { STEPS },
        "seed": 0,
        "goals": GOALS,
        "environments": ENVIRONMENTS,
        "measured_steps": MEASURED_STEPS,
    });
    let answer = python::ask_in(python::LEARNING, SCRIPT, &question)?;
    let rows = answer["rows"].as_array().context("rows of the answer")?;
    ensure!(!rows.is_empty(), "no rows in the answer");
    for row in rows {
        print_row(row);
    }
    fs::create_dir_all(&options.out)
        .with_context(|| format!("making {}", options.out.display()))?;
    let path = options.out.join("sim_learn.json");
    let report = json!({
        "stamp": stamp::stamp("sim_learn", args)?,
        "goals": {
            "success_before": SUCCESS[0],
            "success_after": SUCCESS[1],
            "steps": STEPS,
            "steps_per_s": SPEED[0],
            "resets_per_step": SPEED[1],
        },
        "rows": rows,
    });
    fs::write(&path, format!("{report:#}\n")).with_context(|| format!("writing {}", path.display()))
}

fn print_row(row: &Value) {
    let number = |value: &Value| value.as_f64().unwrap_or(f64::NAN);
    let speed = &row["speed"];
    println!(
        "{}: {:.0} steps/s (goal {:.0}), {:.0} per second of processor time, {:.2} % resets (goal \
         {:.0} %), step p50 {:.2} p99 {:.2} ms",
        row["scene"].as_str().unwrap_or_default(),
        number(&speed["steps_per_s"]),
        SPEED[0],
        number(&speed["steps_per_cpu_s"]),
        100.0 * number(&speed["resets_per_step"]),
        100.0 * SPEED[1],
        number(&speed["step_ms"]["p50"]),
        number(&speed["step_ms"]["p99"]),
    );
    let learning = &row["learning"];
    if learning.is_null() {
        return;
    }
    println!(
        "  success on {GOALS} unseen goals: {:.1} % before (goal below {:.0} %), {:.1} % after {} \
         steps (goal {:.0} %), SPL {:.2}; same seed, same curve: {}; {:.0} s, {:.0} s of \
         processor time",
        100.0 * number(&learning["random"]["success"]),
        100.0 * SUCCESS[0],
        100.0 * number(&learning["trained"]["success"]),
        learning["steps"],
        100.0 * SUCCESS[1],
        number(&learning["trained"]["spl"]),
        learning["same_seed_same_curve"],
        number(&learning["times"][0]["wall_s"]),
        number(&learning["times"][0]["cpu_s"]),
    );
}

struct Options {
    quick: bool,
    scene: Option<PathBuf>,
    out: PathBuf,
}

impl Options {
    fn parse(args: &[String]) -> Result<Self> {
        let mut parsed = Self {
            quick: false,
            scene: None,
            out: PathBuf::from("docs/benchmarks"),
        };
        let mut rest = args.iter();
        while let Some(argument) = rest.next() {
            match argument.as_str() {
                "--quick" => parsed.quick = true,
                "--scene" => {
                    parsed.scene = Some(rest.next().context("--scene needs a path")?.into());
                }
                "--out" => parsed.out = rest.next().context("--out needs a folder")?.into(),
                other => {
                    bail!("unknown argument {other:?}, expected --quick, --scene PATH or --out DIR")
                }
            }
        }
        Ok(parsed)
    }
}
