//! `tag_detectors`: our search for tags and our template fit beside other detectors of AprilTags,
//! in one run on the same images.
//!
//! - [`conditions`]: what the images differ in.
//! - [`scene`], [`render`]: a tag on a shoe over ground, drawn at random; its images.
//! - [`methods`], [`peers`]: ours and theirs.
//! - [`scores`], [`measured`]: against ground truth.
//! - [`photos`]: real photos, where the recordings are found.
//!
//! Detectors get the whole left image. The fit gets a prediction, as in the tracker: a pose that is
//! wrong by up to a cell along the tag and some degrees, and a velocity.

use anyhow::Result;
use rayon::prelude::*;
use serde_json::json;

use self::conditions::{Condition, Resolution, USUAL, sweeps};
use self::measured::{Measurements, Point, Step};
use self::render::Renderer;
use self::scene::{Camera, Scene};
use self::scores::{Score, score};
use crate::arguments::Arguments;
use crate::odometry::results;
use crate::stamp;

mod charts;
mod conditions;
mod measured;
mod methods;
mod peers;
mod photos;
mod render;
mod scene;
mod scores;

/// Seed of the first image of every condition: conditions differ in nothing else.
const FIRST_SEED: u64 = 70_001;
/// That of images without a tag.
const FIRST_WITHOUT: u64 = 90_001;
/// Images per condition, per condition at the higher resolution, and without a tag; of quick runs.
const IMAGES: [u64; 3] = [60, 20, 60];
const QUICK_IMAGES: [u64; 3] = [12, 6, 12];

/// Runs the benchmark: `[--quick] [--out DIR]`.
///
/// # Errors
/// Bad arguments, no interpreter with `pupil-apriltags`, a peer that fails, or an I/O error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let Arguments { quick, out } = Arguments::parse(args)?;
    if !peers::has_kornia() {
        eprintln!("kornia-apriltag is left out: no program is named");
    }
    let [count, large, without] = if quick { QUICK_IMAGES } else { IMAGES };
    let vga = Studio::new(Resolution::Vga, (FIRST_SEED, count))?;
    let hd = Studio::new(Resolution::Hd, (FIRST_SEED, large))?;
    let studio = |condition: &Condition| match condition.camera {
        Resolution::Vga => &vga,
        Resolution::Hd => &hd,
    };
    let mut measured = Measurements::default();
    let mut conditions: Vec<Condition> = Vec::new();
    for sweep in sweeps(quick) {
        for (value, condition) in sweep.points {
            let known = conditions.iter().position(|own| *own == condition);
            let point = known.unwrap_or(conditions.len());
            if known.is_none() {
                conditions.push(condition);
            }
            measured.steps.push(Step {
                variable: sweep.variable,
                value,
                point,
            });
        }
    }
    // Times are of the processor, so that conditions may be measured at the same time.
    let scores = conditions
        .par_iter()
        .map(|condition| studio(condition).scores(condition, true));
    let scores: Vec<Scores> = scores.collect::<Result<_>>()?;
    for (condition, own) in conditions.into_iter().zip(scores) {
        measured.versions = own.versions;
        measured.points.push(Point {
            condition,
            scores: own.scores,
        });
    }
    println!("images without a tag");
    let studio = Studio::new(Resolution::Vga, (FIRST_WITHOUT, without))?;
    measured.without_tag = studio.scores(&USUAL, false)?.scores;
    let photos = photos::run()?;

    let stamp = stamp::stamp("tag_detectors", args)?;
    let mut files = charts::draw(&measured, &stamp::line(&stamp));
    let report = json!({
        "benchmark": "tag_detectors",
        "stamp": stamp,
        "simulated": measured,
        "photos": photos,
    });
    files.push(("tag_detectors.json".to_owned(), format!("{report:#}\n")));
    results::write(&out, files)
}

/// Scores of all methods, and versions of the peers.
struct Scores {
    versions: Vec<String>,
    scores: Vec<Score>,
}

/// A camera, and the grounds of its images.
struct Studio {
    renderer: Renderer,
    first_seed: u64,
    grounds: Vec<Vec<f32>>,
}

impl Studio {
    fn new(resolution: Resolution, (first_seed, count): (u64, u64)) -> Result<Self> {
        let renderer = Renderer::new(Camera::new(resolution))?;
        let seeds: Vec<u64> = (first_seed..first_seed + count).collect();
        let grounds = seeds
            .par_iter()
            .map(|&seed| renderer.ground(seed))
            .collect();
        Ok(Self {
            renderer,
            first_seed,
            grounds,
        })
    }

    /// All methods on images under a condition.
    fn scores(&self, condition: &Condition, has_tag: bool) -> Result<Scores> {
        let camera = self.renderer.camera();
        let grounds = self.grounds.par_iter().enumerate();
        let rendered = grounds.map(|(n, ground)| {
            let seed = self.first_seed + n as u64;
            let scene = Scene::new(camera, condition, seed, has_tag)?;
            let images = self.renderer.images(&scene, condition, ground)?;
            Ok((scene, images))
        });
        let rendered: Vec<(Scene, [Vec<u8>; 2])> = rendered.collect::<Result<_>>()?;
        let (scenes, images): (Vec<Scene>, Vec<[Vec<u8>; 2]>) = rendered.into_iter().unzip();
        let mut answers = methods::answers(camera, &scenes, &images)?;
        let left: Vec<&[u8]> = images.iter().map(|[left, _]| &left[..]).collect();
        let peers = peers::answers(&left, camera.size)?;
        answers.extend(peers.answers);
        let scores = answers.iter().map(|own| score(camera, &scenes, own));
        let scores: Vec<Score> = scores.collect::<Result<_>>()?;
        let lines: Vec<String> = scores.iter().map(line).collect();
        println!("{condition:?}\n{}", lines.join("\n"));
        Ok(Scores {
            versions: peers.versions,
            scores,
        })
    }
}

fn line(score: &Score) -> String {
    format!(
        "  {:<28} found {:5.1} %, wrong {:2}, corners {:5.2} px (p95 {:5.2}, outward {:+5.2}), range {:5.2} %, \
         tilt {:5.2}° (p95 {:5.2}), {:6.2} ms",
        score.method,
        score.recall_percent(),
        score.wrong,
        score.corner_rms_px,
        score.corner_p95_px,
        score.corner_outward_px,
        score.range_rms_percent,
        score.tilt_median_deg,
        score.tilt_p95_deg,
        score.ms,
    )
}

#[cfg(test)]
mod tests;
