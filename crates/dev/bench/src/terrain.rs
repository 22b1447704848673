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
//! All use two threads.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use serde_json::{Map, Value, json};
use terrain::FusionConfig;
use terrain::ground::Ground;
use terrain::mesh::Mesh;

mod charts;
mod keyframes;
mod kitchen;
mod open3d;
mod parts;
mod scores;
mod surface;
mod truth;
mod voxels;
mod walks;

use keyframes::{DepthFrame, Source, depth_frames};
use scores::Quantiles;
use truth::Truth;
use walks::{Prepared, WALKS, Walk};

use crate::stamp;

const PARTS: [&str; 3] = ["walks", "voxels", "open3d"];

/// Runs the benchmark: `[--quick] [--only PART,...] [--walk NAME] [--out DIR]`.
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
    let mut report = read(&path)?;
    for part in &options.parts {
        let found = match part.as_str() {
            "walks" => walks(&options)?,
            "voxels" => voxels(&options)?,
            _ => open3d(&options)?,
        };
        report.insert(part.clone(), json!({ "stamp": stamp, "found": found }));
        let text = format!("{:#}\n", Value::Object(report.clone()));
        fs::write(&path, text).with_context(|| format!("writing {}", path.display()))?;
    }
    for (name, svg) in charts::draw(&report) {
        let path = options.out.join(name);
        fs::write(&path, svg).with_context(|| format!("writing {}", path.display()))?;
    }
    Ok(())
}

/// A walk with its truth and depth maps.
fn with_walk<T>(
    walk: Walk,
    sources: &[Source],
    mut of: impl FnMut(&Truth<'_>, Source, Vec<DepthFrame>) -> Result<T>,
) -> Result<Vec<T>> {
    let prepared: Prepared = walk.prepare()?;
    let ids = prepared.keyframes()?;
    let rendered = keyframes::keyframes(&prepared, &ids)?;
    let truth = Truth::new(&prepared);
    println!("{}: {} keyframes", walk.name(), rendered.len());
    let run = |source: &Source| of(&truth, *source, depth_frames(&rendered, *source)?);
    sources.iter().map(run).collect()
}

fn walks(options: &Options) -> Result<Value> {
    let mut rows = Vec::new();
    for walk in options.walks(&WALKS) {
        let of_walk = with_walk(
            walk,
            &[Source::Stereo, Source::Truth],
            |truth, source, frames| {
                let surface = surface::surface(&frames, FusionConfig::default())?;
                let scores = scores::scores(&surface, truth);
                let parts = match source {
                    Source::Stereo => parts::curve(&surface, truth),
                    Source::Truth => Vec::new(),
                };
                let row = json!({
                    "walk": walk.name(),
                    "scene": walk.kind.name(),
                    "light": walk.light.name(),
                    "columns": walk.size[0],
                    "depth": source.name(),
                    "keyframes": surface.costs.keyframes,
                    "fusion_ms": surface.costs.fusion_ms,
                    "refinement_ms": surface.costs.refinement_ms,
                    "end_s": surface.costs.end_s,
                    "mbytes": 1e-6 * surface.costs.stats.bytes as f64,
                    "scores": scores,
                    "parts": parts,
                });
                println!("{row:#}");
                Ok(row)
            },
        )?;
        rows.extend(of_walk);
    }
    Ok(Value::Array(rows))
}

fn voxels(options: &Options) -> Result<Value> {
    let mut rows = Vec::new();
    // Stairs and rough ground.
    for walk in options.walks(&[WALKS[1], WALKS[2], WALKS[6]]) {
        let curves = with_walk(walk, &[Source::Stereo], |truth, _, frames| {
            voxels::curve(&frames, truth, options.quick)
        })?;
        let row = json!({ "walk": walk.name(), "curve": curves.concat() });
        println!("{row:#}");
        rows.push(row);
    }
    Ok(json!({ "rows": rows, "chosen_m": FusionConfig::default().voxel_m }))
}

fn open3d(options: &Options) -> Result<Value> {
    let repeats = if options.quick { 1 } else { 5 };
    if let Err(reason) = crate::python::interpreter_in(crate::python::OPEN3D) {
        eprintln!("skipped: Open3D: {reason:#}");
        return Ok(json!({ "skipped": format!("{reason:#}") }));
    }
    let mut rows = Vec::new();
    let mut version = String::new();
    for walk in options.walks(&[WALKS[1], WALKS[0], WALKS[2]]) {
        with_walk(walk, &[Source::Stereo], |truth, _, frames| {
            let (fused, of) = open3d::race(&frames, repeats)?;
            version = of;
            for own in &fused {
                let [sole, near] = height_errors(&own.mesh, truth);
                rows.push(json!({
                    "frames": walk.name(),
                    "count": frames.len(),
                    "size": walk.size,
                    "name": own.name,
                    "ms": own.timing,
                    "triangles": own.mesh.triangles.len(),
                    "sole_height": sole,
                    "near_height": near,
                }));
            }
            Ok(())
        })?;
    }
    match harness::data::sets([kitchen::FOLDER]) {
        Ok([folder]) => {
            let frames = kitchen::frames(&folder)?;
            let (fused, _) = open3d::race(&frames, repeats)?;
            let peers: Vec<&Mesh> = fused.iter().map(|own| &own.mesh).collect();
            for own in &fused {
                let (distances, share) = kitchen::agreement(&own.mesh, peers[peers.len() - 1]);
                rows.push(json!({
                    "frames": "kitchen",
                    "count": frames.len(),
                    "size": frames[0].size,
                    "name": own.name,
                    "ms": own.timing,
                    "triangles": own.mesh.triangles.len(),
                    "distance_from_scalable_volume": distances,
                    "share_within_5_cm": share,
                }));
            }
        }
        Err(reason) => eprintln!("{reason}"),
    }
    let found = json!({ "open3d": version, "threads": open3d::THREADS, "voxel_m": open3d::VOXEL_M, "rows": rows });
    println!("{found:#}");
    Ok(found)
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

fn read(path: &Path) -> Result<Map<String, Value>> {
    if !path.exists() {
        return Ok(Map::new());
    }
    let text = fs::read_to_string(path).with_context(|| format!("reading {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| format!("reading {}", path.display()))
}

struct Options {
    quick: bool,
    out: PathBuf,
    parts: Vec<String>,
    /// Begin of the names of the walks to run; empty for all.
    walk: String,
}

impl Options {
    fn parse(args: &[String]) -> Result<Self> {
        let mut parsed = Self {
            quick: false,
            out: PathBuf::from("docs/benchmarks"),
            parts: PARTS.map(str::to_owned).to_vec(),
            walk: String::new(),
        };
        let mut rest = args.iter();
        while let Some(argument) = rest.next() {
            match argument.as_str() {
                "--quick" => parsed.quick = true,
                "--out" => parsed.out = rest.next().context("--out needs a folder")?.into(),
                "--walk" => parsed.walk = rest.next().context("--walk needs a name")?.clone(),
                "--only" => {
                    let list = rest.next().context("--only needs parts")?;
                    parsed.parts = list.split(',').map(str::to_owned).collect();
                    let known = |part: &String| PARTS.contains(&part.as_str());
                    ensure!(
                        parsed.parts.iter().all(known),
                        "found the parts {list:?}, expected some of {}",
                        PARTS.join(", ")
                    );
                }
                other => bail!(
                    "unknown argument {other:?}, expected --quick, --only PARTS, --walk NAME or \
                     --out DIR"
                ),
            }
        }
        Ok(parsed)
    }

    /// The walks to run; a quick run has the first only.
    fn walks(&self, all: &[Walk]) -> Vec<Walk> {
        let named = all
            .iter()
            .filter(|walk| walk.name().starts_with(&self.walk));
        let count = if self.quick { 1 } else { all.len() };
        named.copied().take(count).collect()
    }
}
