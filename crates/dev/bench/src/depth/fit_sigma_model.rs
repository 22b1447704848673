//! Test of the stated sigmas, in every quarter of the stated sigma, and fit of their tables.

use anyhow::{Context, Result};
use depth::evaluate::Scores;
use depth::sigma::{Model, Sample};
use depth::{Band, Config, Matcher, Preset};
use serde_json::{Value, json};

use super::changes;
use super::coverage::Coverage;
use super::frames::Frame;
use super::imperfect;
use super::test_set::{self, Place, PlaceFrame};

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
                samples.extend(samples_of(*preset, &changes::FOR_FIT.apply(frame), k)?);
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
    // What the pair does not show is added to the sigma of the model.
    (config.column_offset_sigma_px, config.column_offset_ratio) = (0.0, 0.0);
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
    pub(super) coverage: Coverage,
}

impl Group {
    fn new(name: &str, preset: Preset) -> Self {
        Self {
            name: name.to_owned(),
            preset,
            scores: Scores::default(),
            coverage: Coverage::default(),
        }
    }

    /// Matches a frame and adds its scores.
    fn add(&mut self, frame: &Frame) -> Result<()> {
        let [left, right] = frame.images();
        let config = Config::preset(self.preset);
        let mut matcher = Matcher::new(config, frame.width, frame.height)?;
        let map = matcher.run(&left, &right, &Band::full(0, frame.range, frame.height)?)?;
        self.scores.add(&Scores::of(map, frame.truth())?);
        self.coverage.add(map, frame);
        Ok(())
    }

    fn json(self) -> Value {
        let shares = self.coverage.shares();
        let (parts, median) = (shares.quarters, shares.median_sigma);
        println!(
            "sigma: {:32} {:9} {:.1} % within two, in quarters {:.1} {:.1} {:.1} {:.1}, median {median:.3} px, density {:.3}, bad-2 {:.2} %",
            self.name,
            self.preset.name(),
            100.0 * shares.all,
            100.0 * parts[0],
            100.0 * parts[1],
            100.0 * parts[2],
            100.0 * parts[3],
            self.scores.density(),
            100.0 * self.scores.bad_ratio(2)
        );
        json!({
            "frames": self.name,
            "preset": self.preset.name(),
            "pixels": self.scores.pixels,
            "density": self.scores.density(),
            "bad_1": self.scores.bad_ratio(1),
            "bad_2": self.scores.bad_ratio(2),
            "mean_error_px": self.scores.mean_error_px(),
            "within_two_sigma": shares.all,
            "within_two_sigma_in_quarters": parts,
            "median_sigma_px": median,
        })
    }
}

/// All of them.
pub(super) fn json(groups: Vec<Group>) -> Value {
    Value::Array(groups.into_iter().map(Group::json).collect())
}

/// Scores of each preset on each walk.
///
/// # Errors
/// A frame that cannot be matched.
pub(super) fn check(places: &[Place], frames: &[PlaceFrame]) -> Result<Vec<Group>> {
    let mut groups = Vec::new();
    for preset in Preset::ALL {
        for (k, place) in places.iter().enumerate() {
            let mut group = Group::new(&place.name(), preset);
            for (_, frame) in frames.iter().filter(|(of, _)| *of == k) {
                group.add(frame)?;
            }
            groups.push(group);
        }
    }
    Ok(groups)
}

/// Scores of each preset on frames with each of the imperfections.
///
/// # Errors
/// A frame that cannot be matched.
pub(super) fn imperfect(frames: &[PlaceFrame]) -> Result<Vec<Group>> {
    let mut groups = Vec::new();
    for preset in Preset::ALL {
        for (k, imperfection) in imperfect::FOR_TEST.iter().enumerate() {
            let mut own = frames.iter().filter(|(of, _)| *of == k).peekable();
            if own.peek().is_none() {
                continue;
            }
            let mut group = Group::new(&format!("imperfect: {}", imperfection.name), preset);
            for (_, frame) in own {
                group.add(frame)?;
            }
            groups.push(group);
        }
    }
    Ok(groups)
}

/// Scores of each preset on one frame.
///
/// # Errors
/// A frame that cannot be matched.
pub(super) fn alone(frame: &Frame) -> Result<Vec<Group>> {
    let group = |preset: Preset| {
        let mut group = Group::new(&frame.name, preset);
        group.add(frame)?;
        Ok(group)
    };
    Preset::ALL.into_iter().map(group).collect()
}
