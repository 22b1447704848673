//! `terrain`: surface, step edges, maps and convex parts of simulated walks against the truth of
//! the simulator, and the distance field beside Open3D's.
//!
//! Poses are true, and so are the masks of people and of the wearer, widened by 10 pixels: errors
//! are those of depth and of fusion. Keyframes are selected, and depth is computed and rounded, as
//! by `paws-reconstruct` with its preset `balanced`. Each walk is also fused from the true depth,
//! which separates errors of fusion from those of stereo.
//!
//! 1. `walks`: errors against the truth, and convex parts: error against their number.
//! 2. `voxels`: errors, time and memory against the size of voxels.
//! 3. `open3d`: the distance field beside Open3D's, on walks and on frames of a Kinect.
//!
//! All use two threads. Beside times stand processor times of all threads, which other load of the
//! machine changes less; half of one is the time on two idle cores at best.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, bail};
use serde_json::{Map, Value, json};
use terrain::FusionConfig;
use terrain::ground::Ground;
use terrain::mesh::Mesh;

mod charts;
pub(crate) mod keyframes;
mod kitchen;
mod open3d;
pub(crate) mod parts;
mod patches;
pub(crate) mod scores;
pub(crate) mod surface;
pub(crate) mod truth;
mod voxels;
pub(crate) mod walks;

use keyframes::{DepthFrame, Source, depth_frames};
use scores::Quantiles;
use truth::Truth;
use walks::{WALKS, Walk, WalkInputs};

use crate::{arguments, python, report, stamp};

const PARTS: [&str; 3] = ["walks", "voxels", "open3d"];

/// Runs the benchmark: `[--quick] [--only PART,...] [--walk NAME] [--seed N] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error. A missed target is a result and no error; a missing peer is left
/// out with a printed reason.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let options = Options::parse(args)?;
    fs::create_dir_all(&options.out)
        .with_context(|| format!("making {}", options.out.display()))?;
    let stamp = stamp::stamp("terrain", args)?;
    // Results of other parts are kept.
    let path = options.out.join("terrain.json");
    let mut report = report::read(&path)?;
    for part in &options.parts {
        for job in options.jobs(part) {
            let rows = match (part.as_str(), job) {
                ("walks", Job::Walk(walk)) => scored(walk)?,
                ("voxels", Job::Walk(walk)) => voxels(walk, options.quick)?,
                (_, job) => match open3d(job, options.quick)? {
                    Some(rows) => rows,
                    None => continue,
                },
            };
            println!("{:#}", Value::Array(rows.clone()));
            add_rows(&mut report, part, rows, &stamp);
            report::write(&path, &report)?;
        }
    }
    report::write_charts(&options.out, charts::draw(&report))?;
    Ok(())
}

/// What a part runs on.
#[derive(Clone, Copy)]
enum Job {
    Walk(Walk),
    Kitchen,
}

/// Adds rows of one walk, with their source; those of others remain.
fn add_rows(report: &mut Map<String, Value>, part: &str, mut rows: Vec<Value>, stamp: &Value) {
    for row in &mut rows {
        row["source"] = stamp::source(stamp).into();
    }
    let old = report
        .get(part)
        .map_or(&Value::Null, |entry| &entry["rows"]);
    let old = old.as_array().map_or(&[][..], Vec::as_slice);
    let is_other = |own: &&Value| rows.iter().all(|row| row["walk"] != own["walk"]);
    let mut all: Vec<Value> = old.iter().filter(is_other).cloned().collect();
    all.append(&mut rows);
    let place = |row: &Value| WALKS.iter().position(|walk| row["walk"] == walk.name());
    all.sort_by_key(|row| place(row).unwrap_or(WALKS.len()));
    report.insert(part.to_owned(), json!({ "stamp": stamp, "rows": all }));
}

/// A walk with its truth and depth maps.
fn with_walk<T>(
    walk: Walk,
    sources: &[Source],
    mut of: impl FnMut(&Truth<'_>, Source, Vec<DepthFrame>) -> Result<T>,
) -> Result<Vec<T>> {
    let prepared: WalkInputs = walk.prepare()?;
    let ids = prepared.keyframes()?;
    let rendered = keyframes::keyframes(&prepared, &ids)?;
    let truth = Truth::new(&prepared);
    println!("{}: {} keyframes", walk.name(), rendered.len());
    let run = |source: &Source| of(&truth, *source, depth_frames(&rendered, *source)?);
    sources.iter().map(run).collect()
}

fn scored(walk: Walk) -> Result<Vec<Value>> {
    with_walk(
        walk,
        &[Source::Stereo, Source::Truth],
        |truth, source, frames| {
            let surface = surface::surface(&frames, FusionConfig::default())?;
            let parts = match source {
                Source::Stereo => parts::curve(&surface, truth),
                Source::Truth => Vec::new(),
            };
            Ok(json!({
                "walk": walk.name(),
                "scene": walk.kind.name(),
                "light": walk.light.name(),
                "columns": walk.size[0],
                "depth": source.name(),
                "keyframes": surface.costs.keyframes,
                "fusion_ms": surface.costs.fusion_ms,
                "fusion_cpu_ms": surface.costs.fusion_cpu_ms,
                "refinement_ms": surface.costs.refinement_ms,
                "refinement_cpu_ms": surface.costs.refinement_cpu_ms,
                "end_s": surface.costs.end_s,
                "mbytes": 1e-6 * surface.costs.stats.bytes as f64,
                "scores": scores::scores(&surface, truth)?,
                "parts": parts,
            }))
        },
    )
}

fn voxels(walk: Walk, quick: bool) -> Result<Vec<Value>> {
    let curves = with_walk(walk, &[Source::Stereo], |truth, _, frames| {
        voxels::curve(&frames, truth, quick)
    })?;
    Ok(vec![json!({
        "walk": walk.name(),
        "curve": curves.concat(),
        "chosen_m": FusionConfig::default().voxel_m,
    })])
}

/// `None`, with a printed reason, without Open3D or the frames.
fn open3d(job: Job, quick: bool) -> Result<Option<Vec<Value>>> {
    let repeats = if quick { 1 } else { 5 };
    if let Err(reason) = python::interpreter_in(python::OPEN3D) {
        eprintln!("skipped: Open3D: {reason:#}");
        return Ok(None);
    }
    let row = |name: &str, frames: &[DepthFrame], own: &open3d::MeshFusion, version: &str| {
        json!({
            "walk": name,
            "keyframes": frames.len(),
            "size": frames.first().map(|frame| frame.size),
            "threads": open3d::THREADS,
            "voxel_m": open3d::VOXEL_M,
            "open3d": version,
            "name": own.name,
            "ms": own.timing,
            "triangles": own.mesh.triangles.len(),
        })
    };
    let walk = match job {
        Job::Walk(walk) => walk,
        Job::Kitchen => {
            let folder = match harness::data::sets([kitchen::FOLDER]) {
                Ok([folder]) => folder,
                Err(reason) => {
                    eprintln!("{reason}");
                    return Ok(None);
                }
            };
            let frames = kitchen::frames(&folder)?;
            let (fused, version) = open3d::race(&frames, repeats)?;
            let reference = fused.last().context("no surface")?;
            let rows = fused.iter().map(|own| {
                let mut row = row("kitchen", &frames, own, &version);
                let (distances, share) = kitchen::agreement(&own.mesh, &reference.mesh);
                row["reference"] = reference.name.as_str().into();
                row["distance_from_reference"] = json!(distances);
                row["share_within_5_cm"] = json!(share);
                row
            });
            return Ok(Some(rows.collect()));
        }
    };
    let rows = with_walk(walk, &[Source::Stereo], |truth, _, frames| {
        let (fused, version) = open3d::race(&frames, repeats)?;
        let rows = fused.iter().map(|own| {
            let mut row = row(&walk.name(), &frames, own, &version);
            let [sole, near] = height_errors(&own.mesh, truth);
            row["sole_height"] = json!(sole);
            row["near_height"] = json!(near);
            row
        });
        Ok(rows.collect::<Vec<Value>>())
    })?;
    Ok(Some(rows.concat()))
}

/// Height errors of a mesh under soles, and within 0.6 m of footprints.
fn height_errors(mesh: &Mesh, truth: &Truth<'_>) -> [Quantiles; 2] {
    let ground = Ground::new(mesh);
    let error = |x: &[f64; 3]| {
        let error = ground.nearest(*x)?.height_m - x[2];
        (error.abs() < 0.3).then_some(error)
    };
    let soles = truth.footprints.iter().flat_map(|print| &print.ground);
    let near = scores::open_ground(truth);
    [
        Quantiles::of(soles.filter_map(error)),
        Quantiles::of(near.iter().filter_map(error)),
    ]
}

struct Options {
    quick: bool,
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
            quick: false,
            out: PathBuf::from("docs/benchmarks"),
            parts: PARTS.map(str::to_owned).to_vec(),
            walk: String::new(),
            seed: None,
        };
        let mut rest = args.iter();
        while let Some(argument) = rest.next() {
            match argument.as_str() {
                "--quick" => parsed.quick = true,
                "--out" => parsed.out = rest.next().context("--out needs a folder")?.into(),
                "--walk" => parsed.walk = rest.next().context("--walk needs a name")?.clone(),
                "--seed" => {
                    let seed = rest.next().context("--seed needs a number")?;
                    parsed.seed = Some(seed.parse().context("reading the seed")?);
                }
                "--only" => parsed.parts = arguments::parts(rest.next(), &PARTS)?,
                other => bail!(
                    "unknown argument {other:?}, expected --quick, --only PARTS, --walk NAME, \
                     --seed N or --out DIR"
                ),
            }
        }
        Ok(parsed)
    }

    /// What a part runs on; a quick run has the first only.
    fn jobs(&self, part: &str) -> Vec<Job> {
        // Stairs and rough ground; a kerb in front of Open3D.
        let walks = match part {
            "walks" => WALKS.to_vec(),
            "voxels" => vec![WALKS[1], WALKS[2], WALKS[6]],
            _ => vec![WALKS[1], WALKS[0], WALKS[2]],
        };
        let mut jobs: Vec<(String, Job)> = walks
            .into_iter()
            .map(|walk| walk.with_seed(self.seed))
            .map(|walk| (walk.name(), Job::Walk(walk)))
            .collect();
        if part == "open3d" {
            jobs.push(("kitchen".to_owned(), Job::Kitchen));
        }
        jobs.retain(|(name, _)| name.starts_with(&self.walk));
        jobs.truncate(if self.quick { 1 } else { usize::MAX });
        jobs.into_iter().map(|(_, job)| job).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_of_other_walks_remain() {
        let mut report = Map::new();
        let row = |walk: &str, value: u32| json!({ "walk": walk, "value": value });
        let [first, second] = [0, 1].map(|k: usize| WALKS[k].name());
        let stamp = json!({ "commit": "abc", "date": "2026-01-01" });
        add_rows(&mut report, "walks", vec![row(&second, 1)], &stamp);
        add_rows(
            &mut report,
            "walks",
            vec![row(&first, 2), row(&first, 3)],
            &stamp,
        );
        add_rows(&mut report, "walks", vec![row(&second, 4)], &stamp);
        let rows = report["walks"]["rows"].as_array().unwrap();
        let values: Vec<u64> = rows
            .iter()
            .filter_map(|row| row["value"].as_u64())
            .collect();
        assert_eq!(values, [2, 3, 4]);
        assert_eq!(rows[0]["source"], "abc 2026-01-01");
    }
}
