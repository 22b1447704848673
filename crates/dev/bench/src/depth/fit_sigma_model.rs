//! Test of the stated sigmas, and fit of their tables.

use anyhow::{Context, Result};
use depth::evaluate::Scores;
use depth::sigma::{Model, Sample};
use depth::{Band, Config, Matcher, Preset};
use serde_json::{Value, json};

use super::frames::Frame;
use super::test_set::{self, Found, Place};

/// Sampling stride, pixels.
const SAMPLE_STRIDE: usize = 8;

/// Fits the models of the presets and returns their source code, as in
/// `crates/vision/depth/src/sigma/tables.rs`.
pub(super) fn fit() -> Result<String> {
    let frames = test_set::render(&test_set::to_fit())?;
    let mut text = String::new();
    for (name, presets) in [
        ("THREE", &[Preset::Fast][..]),
        ("EIGHT", &[Preset::Balanced, Preset::Accurate]),
    ] {
        let mut samples = Vec::new();
        for preset in presets {
            for (k, (_, frame)) in frames.iter().enumerate() {
                samples.extend(samples_of(*preset, frame, k)?);
            }
        }
        let model = Model::fit(&samples).context("too few samples")?;
        text += &format!(
            "// {} samples\npub(super) const {name}: Model = {};\n",
            samples.len(),
            model.source()
        );
    }
    Ok(text)
}

fn samples_of(preset: Preset, frame: &Frame, number: usize) -> Result<Vec<Sample>> {
    let [left, right] = frame.images();
    // Results of smaller images use the same model.
    let mut config = Config::preset(preset);
    config.downsample = None;
    let mut matcher = Matcher::new(config, frame.width, frame.height)?.with_evidence();
    matcher.run(&left, &right, &Band::full(0, frame.range, frame.height)?)?;
    let map = matcher.map();
    // Every n-th pixel, not the same columns in each row.
    let chosen = (0..map.disparity.len())
        .filter(|i| (i * 7 + i / frame.width * 3 + number).is_multiple_of(SAMPLE_STRIDE));
    let known = chosen
        .filter(|i| frame.visible[*i] && !frame.truth[*i].is_nan() && !map.disparity[*i].is_nan());
    let sample = |i: usize| Sample {
        evidence: matcher.evidence()[i],
        error_px: (map.disparity[i] - frame.truth[i]).abs(),
    };
    Ok(known.map(sample).collect())
}

/// Scores of a preset over all frames of a walk.
pub(super) struct Group {
    pub(super) name: String,
    pub(super) preset: Preset,
    pub(super) scores: Scores,
}

impl Group {
    pub(super) fn json(&self) -> Value {
        json!({
            "frames": self.name,
            "preset": self.preset.name(),
            "pixels": self.scores.pixels,
            "density": self.scores.density(),
            "bad_1": self.scores.bad_ratio(1),
            "bad_2": self.scores.bad_ratio(2),
            "mean_error_px": self.scores.mean_error_px(),
            "within_two_sigma": self.scores.coverage(),
        })
    }
}

/// All of them.
pub(super) fn json(groups: &[Group]) -> Value {
    for group in groups {
        println!(
            "sigma: {:24} {:9} {:.1} % within two, density {:.3}, bad-2 {:.2} %",
            group.name,
            group.preset.name(),
            100.0 * group.scores.coverage(),
            group.scores.density(),
            100.0 * group.scores.bad_ratio(2)
        );
    }
    Value::Array(groups.iter().map(Group::json).collect())
}

/// Scores of each preset on each walk.
pub(super) fn check(places: &[Place], frames: &[Found]) -> Result<Vec<Group>> {
    let mut groups = Vec::new();
    for preset in Preset::ALL {
        for (k, place) in places.iter().enumerate() {
            let mut scores = Scores::default();
            for (_, frame) in frames.iter().filter(|(of, _)| *of == k) {
                scores.add(&score(preset, frame)?);
            }
            groups.push(Group {
                name: place.name(),
                preset,
                scores,
            });
        }
    }
    Ok(groups)
}

/// Scores of a preset on a frame.
pub(super) fn score(preset: Preset, frame: &Frame) -> Result<Scores> {
    let [left, right] = frame.images();
    let mut matcher = Matcher::new(Config::preset(preset), frame.width, frame.height)?;
    let map = matcher.run(&left, &right, &Band::full(0, frame.range, frame.height)?)?;
    Ok(Scores::of(map, frame.truth())?)
}

/// Scores of each preset on one frame.
///
/// # Errors
/// A frame that cannot be matched.
pub(super) fn alone(frame: &Frame) -> Result<Vec<Group>> {
    let group = |preset: Preset| {
        Ok(Group {
            name: frame.name.clone(),
            preset,
            scores: score(preset, frame)?,
        })
    };
    Preset::ALL.into_iter().map(group).collect()
}
