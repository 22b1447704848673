//! `rectify`: time of rectifying one image, ours and OpenCV's, both on one thread.
//!
//! With the ZED Mini's factory file among the recordings; the best of many runs, since another
//! program on the machine can only make one slower. Figures of docs/reference/calibration-files.md.

use std::fs;
use std::path::Path;

use anyhow::{Context, Result};
use camera_models::Eye;
use camera_models::rectify::{Rectification, Remap, View, remap_exact};
use serde_json::{Value, json};

use crate::arguments::Arguments;
use crate::meter::timed;
use crate::{python, stamp};

const FILE: &str = "06_calibration/zed/SN10028708.conf";
const RUNS: usize = 200;

/// Runs the benchmark: `[--quick] [--out DIR]`.
///
/// # Errors
/// Bad arguments, no interpreter in `PAWS_PYTHON`, no factory file in `PAWS_DATA`, or an I/O error.
pub(crate) fn run(args: &[String]) -> Result<()> {
    let Arguments { quick, out } = Arguments::parse(args)?;
    fs::create_dir_all(&out).with_context(|| format!("making {}", out.display()))?;
    let stamp = stamp::stamp("rectify", args)?;
    let data = std::env::var_os("PAWS_DATA")
        .context("PAWS_DATA names no folder with the ZED Mini's factory file")?;
    let file = Path::new(&data).join(FILE);
    let runs = if quick { 10 } else { RUNS };
    let mut sizes = Vec::new();
    for size in [(672, 376), (1280, 720)] {
        let row = one(&file, size, runs)?;
        println!("{row}");
        sizes.push(row);
    }
    let report = json!({ "benchmark": "rectify", "stamp": stamp, "runs": runs, "file": FILE, "sizes": sizes });
    let path = out.join("rectify.json");
    fs::write(&path, format!("{report:#}\n")).with_context(|| format!("writing {}", path.display()))
}

fn one(file: &Path, (width, height): (u32, u32), runs: usize) -> Result<Value> {
    let (pair, _) = calibration_files::read_stereo(file, width, height)
        .with_context(|| format!("reading {}", file.display()))?;
    let rectification = Rectification::new(&pair, View::Filled)?;
    let old = image(width as usize, height as usize);
    let map = rectification.map(Eye::Left);
    let remap = Remap::new(&map, width, height);
    let mut new = vec![0; old.len()];
    let ours = json!({
        "rectification": best_ms(runs, || drop(Rectification::new(&pair, View::Filled))),
        "map": best_ms(runs, || drop(rectification.map(Eye::Left))),
        "map_exact": best_ms(runs.min(10), || drop(rectification.exact_map(Eye::Left))),
        "preparing": best_ms(runs, || drop(Remap::new(&map, width, height))),
        "remap": best_ms(runs, || remap.apply_to(&old, 0, &mut new)),
        "remap_exact": best_ms(runs.min(10), || drop(remap_exact(&map, &old, [width, height], 0))),
    });
    let rotation = rectification
        .rectified_from_left
        .rotation()
        .to_rotation_matrix();
    let opencv = python::ask(
        "rectify.py",
        &json!({
            "runs": runs,
            "size": [width, height],
            "old": pair.left.k_matrix(),
            "new": rectification.camera.k_matrix(),
            "rotation": rotation.matrix().transpose().as_slice(),
            "distortion": pair.left.distortion.coefficients(),
        }),
    )?;
    Ok(json!({ "width": width, "height": height, "ours_ms": ours, "opencv": opencv }))
}

/// An image with edges and slopes.
fn image(width: usize, height: usize) -> Vec<u8> {
    (0..width * height)
        .map(|i| {
            let (x, y) = (i % width, i / width);
            let cell = if (x / 9 + y / 7) % 2 == 0 { 90 } else { 0 };
            (cell + (3 * x + 2 * y) % 160) as u8
        })
        .collect()
}

fn best_ms(runs: usize, mut work: impl FnMut()) -> f64 {
    (0..runs)
        .map(|_| 1e3 * timed(&mut work).1.wall_s)
        .fold(f64::INFINITY, f64::min)
}
