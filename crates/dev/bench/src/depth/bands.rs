//! Time saved by restricting the disparity range to the needs of a scene, and the loss of answers.

use anyhow::Result;
use depth::band::plan::Plane;
use depth::{Band, BandedMatcher, Config, Matcher, Preset};
use rig_sim::camera::Quality;
use rig_sim::scene::{Kind, Lighting};
use serde_json::{Value, json};

use super::frames::{Frame, Walk};
use super::imperfect;
use super::race::BAD_2;
use super::test_set::{SECONDS, SIZE};
use crate::meter::timed;

/// Frames of each walk, one after the other.
const FRAMES: std::ops::Range<u64> = 120..140;

/// Counts over the frames of one camera.
#[derive(Default)]
struct Sums {
    /// Pixels visible in both images.
    pixels: u64,
    /// Correct answers with the full disparity range, and those of them that a band loses.
    right: u64,
    lost: u64,
    /// Correct answers that only a band has.
    gained: u64,
    full_s: f64,
    band_s: f64,
    share: f64,
    again: u32,
}

/// With and without bands, for each camera of three walks.
///
/// # Errors
/// There is no such walk.
pub(super) fn bands(quick: bool) -> Result<Value> {
    let kinds = [Kind::Plaza, Kind::Stairs, Kind::Corridor];
    let numbers: Vec<u64> = FRAMES
        .take(if quick { 4 } else { FRAMES.count() })
        .collect();
    let mut rows = Vec::new();
    for kind in &kinds[..if quick { 1 } else { kinds.len() }] {
        let walk = Walk::new(
            *kind,
            Lighting::Day,
            8,
            SECONDS,
            SIZE,
            Quality::ACCURATE,
            &imperfect::NONE,
        )?;
        for camera in 0..walk.cameras() {
            let frames = walk.frames(camera, &numbers)?;
            for preset in Preset::ALL {
                let sums = compare(&frames, preset)?;
                let per = |part: u64| part as f64 / sums.pixels.max(1) as f64;
                let count = frames.len() as f64;
                let row = json!({
                    "walk": kind.name(),
                    "camera": camera,
                    "preset": preset.name(),
                    "frames": frames.len(),
                    "full_ms": 1e3 * sums.full_s / count,
                    "band_ms": 1e3 * sums.band_s / count,
                    "share_of_disparities": sums.share / count,
                    "runs_again": sums.again,
                    "right": per(sums.right),
                    "lost": per(sums.lost),
                    "gained": per(sums.gained),
                });
                println!("bands: {row}");
                rows.push(row);
            }
        }
    }
    Ok(Value::Array(rows))
}

fn compare(frames: &[Frame], preset: Preset) -> Result<Sums> {
    let mut sums = Sums::default();
    let Some(first) = frames.first() else {
        return Ok(sums);
    };
    let settings = Config::preset(preset);
    let band = Band::full(0, first.range, first.height)?;
    let mut matcher = Matcher::new(settings, first.width, first.height)?;
    let mut banded = BandedMatcher::new(settings, first.width, band.clone())?;
    for frame in frames {
        let [left, right] = frame.images();
        let (result, took) = timed(|| matcher.run(&left, &right, &band).map(drop));
        result?;
        sums.full_s += took.wall_s;
        let plane = ground(frame);
        let ground = Some((&frame.geometry, &plane));
        let (result, took) = timed(|| banded.run(&left, &right, ground).map(|(_, stats)| stats));
        let stats = result?;
        sums.band_s += took.wall_s;
        sums.share += stats.searched_ratio;
        sums.again += stats.reruns;
        let maps = [matcher.map(), banded.matcher().map()];
        for i in 0..frame.truth.len() {
            if !frame.visible[i] || frame.truth[i].is_nan() {
                continue;
            }
            sums.pixels += 1;
            let limit = depth::evaluate::BAD_PX[BAD_2];
            let is_right = maps.map(|map| (map.disparity[i] - frame.truth[i]).abs() <= limit);
            sums.right += u64::from(is_right[0]);
            sums.lost += u64::from(is_right[0] && !is_right[1]);
            sums.gained += u64::from(!is_right[0] && is_right[1]);
        }
    }
    Ok(sums)
}

/// Ground plane at the start of the walk, in the left frame. Stairs deviate from it, which only
/// costs time.
fn ground(frame: &Frame) -> Plane {
    let up = frame.world_from_left.inverse().rotate([0.0, 0.0, 1.0]);
    Plane {
        normal: up,
        distance_m: -frame.world_from_left.translation_m()[2],
    }
}
