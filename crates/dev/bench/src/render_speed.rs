//! `render`: images per second of reconstructed scenes against their PSNR to the exact renderer.
//!
//! Scenes are trained on simulated walks; nothing thins them. Cameras are pinhole cameras with 90
//! degrees from left to right, at reference poses near the path. An image is color, expected and
//! median depth and alpha. The exact renderer is `Renderer::render` of all Gaussians, the fast one
//! `Renderer::render_detail_batch`.
//!
//! 1. `batches`: 64 and 96 px over the size of a batch, with the quality of all reference views.
//! 2. `sizes`: 256 to 1024 px and 1280x720, as they are, beside PAWS-Sim's published figures.
//! 3. `levels`: images per second against PSNR over the largest scale of coarser Gaussians, at
//!    64 px, on the walks for tuning and on the others.
//!
//! All on two threads. Beside the elapsed time stands the processor time of an image, which other
//! load of the machine changes less: two threads on idle cores render 2 / (processor time) images
//! per second.

use std::fs;
use std::path::PathBuf;

use anyhow::{Context, Result, bail, ensure};
use serde_json::{Map, Value, json};
use splats::{Camera, DetailConfig, DetailScene, RenderConfig, Renderer};

mod charts;
pub(crate) mod measure;
pub(crate) mod poses;
mod scenes;

pub(crate) use charts::PAWS_SIM;
use measure::{Quality, Speed};
use poses::{camera, reference_poses};
use scenes::{Reconstruction, TUNING, WALKS, Walk};

use crate::{arguments, report, stamp};

const PARTS: [&str; 3] = ["batches", "sizes", "levels"];
const THREADS: usize = 2;
/// Reference views of a scene.
const VIEWS: usize = 512;
const SMALL: [u32; 2] = [64, 96];
const BATCHES: [usize; 5] = [1, 4, 16, 64, 256];
const LARGE: [[u32; 2]; 4] = [[256, 256], [512, 512], [1024, 1024], [1280, 720]];
/// Images of one size in all, at least.
const LARGE_PIXELS: usize = 40 << 20;
/// Values of `max_sigma_px`.
const SIGMAS_PX: [f32; 7] = [0.0, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0];

/// Runs the benchmark: `[--quick] [--only PART,...] [--walk NAME] [--out DIR]`.
///
/// # Errors
/// Bad arguments, or an I/O error. A missed target is a result and no error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let options = Options::parse(args)?;
    fs::create_dir_all(&options.out)
        .with_context(|| format!("making {}", options.out.display()))?;
    let stamp = stamp::stamp("render", args)?;
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(THREADS)
        .build()?;
    let path = options.out.join("render.json");
    let mut report = report::read(&path)?;
    for part in &options.parts {
        for walk in options.walks(part) {
            // Training uses all processors, measurements two threads.
            let scene = walk.reconstruction()?;
            let row = pool.install(|| match part.as_str() {
                "batches" => batches(&walk, &scene, &options),
                "sizes" => sizes(&walk, &scene, &options),
                _ => levels(&walk, &scene, &options),
            })?;
            println!("{row:#}");
            add_row(&mut report, part, row, &stamp);
            report::write(&path, &report)?;
        }
    }
    report::write_charts(&options.out, charts::draw(&report))?;
    Ok(())
}

/// A scene with its reference views.
struct Views {
    renderer: Renderer,
    poses: Vec<cad_transforms::RigidTransform>,
}

impl Views {
    fn new(scene: &Reconstruction, options: &Options) -> Result<Self> {
        let renderer = Renderer::new(RenderConfig::default())?;
        let poses = reference_poses(&renderer, &scene.scene, &scene.path, options.views)?;
        ensure!(
            poses.len() == options.views,
            "found {} views with less than half sky and nothing near, expected {}",
            poses.len(),
            options.views
        );
        Ok(Self { renderer, poses })
    }

    fn cameras(&self, size: [u32; 2], count: usize) -> Result<Vec<Camera>> {
        let poses = self.poses.iter().take(count);
        Ok(poses
            .map(|pose| camera(size, pose))
            .collect::<Result<_, _>>()?)
    }
}

fn scene_row(walk: &Walk, scene: &Reconstruction) -> Value {
    json!({
        "walk": walk.name(),
        "gaussians": scene.scene.splats.len(),
        "degree": scene.scene.splats.degree(),
        "training_psnr_db": scene.psnr_db,
    })
}

fn batches(walk: &Walk, scene: &Reconstruction, options: &Options) -> Result<Value> {
    let views = Views::new(scene, options)?;
    let detail = DetailScene::new(&scene.scene, &DetailConfig::default())?;
    let mut row = scene_row(walk, scene);
    let sizes = SMALL.iter().map(|edge| {
        let cameras = views.cameras([*edge; 2], options.views)?;
        let batches = BATCHES.iter().filter(|batch| **batch <= cameras.len());
        let speeds: Vec<Value> = batches
            .map(|batch| {
                let speed = Speed::of(&views.renderer, &detail, &cameras, *batch);
                let mut row = json!(speed);
                row["batch"] = json!(batch);
                row
            })
            .collect();
        Ok(json!({
            "edge": edge,
            "views": cameras.len(),
            "candidates": mean(cameras.iter().map(|camera| detail.count(camera) as f64)),
            "exact": Speed::exact(&views.renderer, &scene.scene, &cameras),
            "quality": Quality::of(&views.renderer, &scene.scene, &detail, &cameras),
            "speeds": speeds,
        }))
    });
    row["sizes"] = Value::Array(sizes.collect::<Result<_>>()?);
    Ok(row)
}

fn sizes(walk: &Walk, scene: &Reconstruction, options: &Options) -> Result<Value> {
    let views = Views::new(scene, options)?;
    let detail = DetailScene::new(&scene.scene, &DetailConfig::default())?;
    let mut row = scene_row(walk, scene);
    let sizes = LARGE.iter().map(|[width, height]| {
        let count = LARGE_PIXELS / (*width as usize * *height as usize);
        let cameras = views.cameras([*width, *height], count.min(64))?;
        Ok(json!({
            "width": width,
            "height": height,
            "views": cameras.len(),
            "exact": Speed::exact(&views.renderer, &scene.scene, &cameras),
            "quality": Quality::of(&views.renderer, &scene.scene, &detail, &cameras),
            "speed": Speed::of(&views.renderer, &detail, &cameras, 16),
        }))
    });
    row["sizes"] = Value::Array(sizes.collect::<Result<_>>()?);
    Ok(row)
}

fn levels(walk: &Walk, scene: &Reconstruction, options: &Options) -> Result<Value> {
    let views = Views::new(scene, options)?;
    let cameras = views.cameras([64; 2], options.views)?;
    let mut row = scene_row(walk, scene);
    row["is_tuning"] = json!(TUNING.iter().any(|own| own.name() == walk.name()));
    let curve = SIGMAS_PX.iter().map(|max_sigma_px| {
        let mut config = DetailConfig::default();
        config.max_sigma_px = *max_sigma_px;
        let detail = DetailScene::new(&scene.scene, &config)?;
        Ok(json!({
            "max_sigma_px": max_sigma_px,
            "candidates": mean(cameras.iter().map(|camera| detail.count(camera) as f64)),
            "quality": Quality::of(&views.renderer, &scene.scene, &detail, &cameras),
            "speed": Speed::of(&views.renderer, &detail, &cameras, 64),
        }))
    });
    row["chosen"] = json!(DetailConfig::default().max_sigma_px);
    row["curve"] = Value::Array(curve.collect::<Result<_>>()?);
    Ok(row)
}

fn mean(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    values.sum::<f64>() / count
}

/// Adds the row of a walk, with its source; those of others remain.
fn add_row(report: &mut Map<String, Value>, part: &str, mut row: Value, stamp: &Value) {
    row["source"] = stamp::source(stamp).into();
    let old = report
        .get(part)
        .map_or(&Value::Null, |entry| &entry["rows"]);
    let old = old.as_array().map_or(&[][..], Vec::as_slice);
    let others = old.iter().filter(|own| own["walk"] != row["walk"]);
    let mut all: Vec<Value> = others.cloned().collect();
    all.push(row);
    let place = |row: &Value| {
        let mut walks = TUNING.iter().chain(&WALKS);
        walks.position(|walk| row["walk"] == walk.name())
    };
    all.sort_by_key(place);
    report.insert(part.to_owned(), json!({ "stamp": stamp, "rows": all }));
}

struct Options {
    out: PathBuf,
    parts: Vec<String>,
    /// Begin of the names of the walks to run; empty for all.
    walk: String,
    /// Reference views.
    views: usize,
    quick: bool,
}

impl Options {
    fn parse(args: &[String]) -> Result<Self> {
        let mut parsed = Self {
            out: PathBuf::from("docs/benchmarks"),
            parts: PARTS.map(str::to_owned).to_vec(),
            walk: String::new(),
            views: VIEWS,
            quick: false,
        };
        let mut rest = args.iter();
        while let Some(argument) = rest.next() {
            match argument.as_str() {
                "--quick" => (parsed.quick, parsed.views) = (true, 64),
                "--out" => parsed.out = rest.next().context("--out needs a folder")?.into(),
                "--walk" => parsed.walk = rest.next().context("--walk needs a name")?.clone(),
                "--only" => parsed.parts = arguments::parts(rest.next(), &PARTS)?,
                other => bail!(
                    "unknown argument {other:?}, expected --quick, --only PARTS, --walk NAME or \
                     --out DIR"
                ),
            }
        }
        Ok(parsed)
    }

    /// The walks of a part; a quick run has the first only.
    fn walks(&self, part: &str) -> Vec<Walk> {
        let tuning = match part {
            "levels" => &TUNING[..],
            _ => &[],
        };
        let mut walks: Vec<Walk> = tuning.iter().chain(&WALKS).copied().collect();
        walks.retain(|walk| walk.name().starts_with(&self.walk));
        walks.truncate(if self.quick { 1 } else { usize::MAX });
        walks
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
        for row in [row(&second, 1), row(&first, 2), row(&second, 3)] {
            add_row(&mut report, "sizes", row, &stamp);
        }
        let rows = report["sizes"]["rows"].as_array().unwrap();
        let values: Vec<u64> = rows
            .iter()
            .filter_map(|row| row["value"].as_u64())
            .collect();
        assert_eq!(values, [2, 3]);
        assert_eq!(rows[0]["source"], "abc 2026-01-01");
    }
}
