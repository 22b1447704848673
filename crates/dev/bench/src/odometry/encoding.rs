//! `odometry_encoding`: effect of the recording's compression on poses and depth.
//!
//! Two simulated walks are rendered in color at the quality for tests, encoded as the daemon
//! encodes them (left and right side by side, one thread, a key frame each half second), decoded,
//! and tracked. The daemon's encoder at several quality targets is compared with the same element
//! at slower speed presets, which the daemon does not offer, through `gst-launch-1.0` with the
//! daemon's other properties, and the other software encoders that the daemon knows. Errors are
//! against the truth; uncompressed images are included for comparison. Errors of single walks vary
//! irregularly from one quality to the next, since any change of images changes which corners are
//! tracked; so the number of inliers is given too, which varies smoothly.
//!
//! Images are in the folder of rendered walks (2 GB).

use std::sync::Arc;

use anyhow::{Context, Result};
use harness::sequences::{OwnedFrameSet, Sequence};
use harness::tracking::{self, Tracking};
use serde::Serialize;
use serde_json::json;

mod charts;
mod codec;
mod depths;
mod material;

use super::figures::Figures;
use super::options::Options;
use super::{results, settings};
use crate::stamp;
use codec::{Encoding, EncodingResult};
use depths::{Depth, Depths};
use material::Material;

/// Walks, of 40 s.
const WALKS: [&str; 2] = ["pavement-day-21-40", "corridor-flicker-22-40"];
/// Those of a trial.
const QUICK: [&str; 1] = ["pavement-day-21-8"];
/// Quality targets of the daemon's encoder, dB; it offers 30 and above.
const TARGETS_DB: [f64; 10] = [21.0, 24.0, 27.0, 30.0, 33.0, 36.0, 39.0, 42.0, 45.0, 48.0];
/// Those of the others.
const OTHERS_DB: [f64; 4] = [33.0, 36.0, 39.0, 45.0];

/// One encoding of one walk, or none.
#[derive(Clone, Debug, Serialize)]
struct Point {
    walk: &'static str,
    /// Its name in charts; `not encoded` for the images themselves.
    encoding: String,
    /// Quality target, dB.
    target_db: Option<f64>,
    /// Result and cost of encoding.
    #[serde(rename = "made")]
    result: Option<EncodingResult>,
    /// Number of inliers, mean of all sets.
    inliers: f64,
    depth: Depth,
    causal: Figures,
    adjusted: Figures,
}

/// Runs the benchmark: `[--quick] [--only PART,...] [--walks DIR] [--out DIR]`; parts are `daemon`,
/// `presets`, `encoders`.
///
/// # Errors
/// Bad arguments, an encoder that fails, or an I/O error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let options = Options::parse(args, &["daemon", "presets", "encoders"])?;
    let stamp = stamp::stamp("odometry_encoding", args)?;
    let mut points: Vec<Point> = Vec::new();
    let walks: &[&'static str] = if options.quick { &QUICK } else { &WALKS };
    for walk in walks.iter().copied().filter(|w| options.takes(w)) {
        let (material, sequence) = Material::of(walk, &options.walks)?;
        let depths = Depths::of(&sequence)?;
        let walked = WalkData {
            name: walk,
            sequence,
            depths,
        };
        let sets = Arc::new(material.sets()?);
        points.push(point(&walked, &sets, None)?);
        for encoding in encodings(&options) {
            let (decoded, result) = (codec::pass(&material, &encoding))
                .with_context(|| format!("{} on {walk}", encoding.name()))?;
            points.push(point(
                &walked,
                &Arc::new(decoded),
                Some((&encoding, result)),
            )?);
        }
    }
    let report = json!({
        "benchmark": "odometry_encoding",
        "stamp": stamp,
        "settings": "balanced",
        "points": points,
    });
    let mut files = vec![("odometry_encoding.json".to_owned(), format!("{report:#}\n"))];
    files.extend(charts::draw(&points, &stamp::line(&stamp)));
    results::write(&options.out, files)
}

/// Encodings of each walk.
fn encodings(options: &Options) -> Vec<Encoding> {
    let mut encodings = Vec::new();
    let of = |target_db: &f64, element: &'static str, preset: Option<&'static str>| Encoding {
        element,
        preset,
        target_db: *target_db,
    };
    for part in &options.parts {
        match part.as_str() {
            "daemon" => {
                encodings.extend(TARGETS_DB.iter().map(|db| of(db, codec::DAEMONS, None)));
            }
            "presets" => {
                for preset in ["superfast", "medium"] {
                    let others = OTHERS_DB.iter();
                    encodings.extend(others.map(|db| of(db, codec::DAEMONS, Some(preset))));
                }
            }
            _ => {
                for element in ["x265enc", "openh264enc"] {
                    encodings.extend(OTHERS_DB.iter().map(|db| of(db, element, None)));
                }
            }
        }
    }
    if options.quick {
        encodings.retain(|e| [33.0, 42.0].contains(&e.target_db));
    }
    encodings
}

/// A walk and its ground truth.
struct WalkData {
    name: &'static str,
    sequence: Sequence,
    depths: Depths,
}

fn point(
    walk: &WalkData,
    sets: &Arc<Vec<OwnedFrameSet>>,
    encoded: Option<(&Encoding, EncodingResult)>,
) -> Result<Point> {
    let sequence = walk.sequence.clone().with_images(sets)?;
    let mut tracking = Tracking::new(sequence.rig(), settings::parse("balanced")?, true);
    let mut inliers = 0;
    sequence.for_each(|set| {
        inliers += tracking.add(&set)?.inliers;
        Ok(())
    })?;
    let truth = tracking::truth(&sequence)?;
    let causal = Figures::of(tracking.causal(), &truth)?;
    let adjusted = tracking.refine()?.context("there is a mapping")?;
    let point = Point {
        walk: walk.name,
        encoding: encoded
            .as_ref()
            .map_or("not encoded".to_owned(), |(e, _)| e.name()),
        target_db: encoded.as_ref().map(|(e, _)| e.target_db),
        result: encoded.map(|(_, result)| result),
        inliers: inliers as f64 / sequence.len() as f64,
        depth: walk.depths.score(sets)?,
        causal,
        adjusted: Figures::of(&adjusted.trajectory, &truth)?,
    };
    let percent = |f: &Figures| {
        f.ate_percent
            .map_or("lost".to_owned(), |p| format!("{p:.3} %"))
    };
    println!(
        "{:24} {:18} {:>5} dB: {} causal {}, adjusted {}, {:.0} inliers, depth density {:.3} with bad-2 {:.4}",
        point.walk,
        point.encoding,
        point.target_db.map_or(String::new(), |db| db.to_string()),
        point.result.as_ref().map_or(String::new(), |m| format!(
            "{:.2} Mbit/s, PSNR {:.1} dB, {:.1} ms CPU;",
            m.mbit_s, m.psnr_db, m.cpu_ms
        )),
        percent(&point.causal),
        percent(&point.adjusted),
        point.inliers,
        point.depth.density,
        point.depth.bad_2
    );
    Ok(point)
}
