//! Test of the stated sigmas, in every quarter of the stated sigma, and fit of their tables.

use anyhow::{Context, Result};
use depth::evaluate::Scores;
use depth::sigma::{Model, Sample};
use depth::{Band, Config, Matcher, Preset};
use serde_json::{Value, json};

use super::frames::Frame;
use super::imperfect;
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
                samples.extend(samples_of(*preset, &imperfect::FOR_FIT.apply(frame), k)?);
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
    /// Sigma of each disparity that counts, and whether the error is within two of it.
    pub(super) sigmas: Vec<(f32, bool)>,
}

/// Parts of equal size, from the smallest to the largest sigma.
const PARTS: usize = 4;

impl Group {
    fn new(name: &str, preset: Preset) -> Self {
        Self {
            name: name.to_owned(),
            preset,
            scores: Scores::default(),
            sigmas: Vec::new(),
        }
    }

    /// Matches a frame and adds its scores.
    fn add(&mut self, frame: &Frame) -> Result<()> {
        let [left, right] = frame.images();
        let config = Config::preset(self.preset);
        let mut matcher = Matcher::new(config, frame.width, frame.height)?;
        let map = matcher.run(&left, &right, &Band::full(0, frame.range, frame.height)?)?;
        self.scores.add(&Scores::of(map, frame.truth())?);
        for i in 0..map.disparity.len() {
            let error = (map.disparity[i] - frame.truth[i]).abs();
            if frame.visible[i] && !error.is_nan() {
                self.sigmas
                    .push((map.sigma[i], error <= 2.0 * map.sigma[i]));
            }
        }
        Ok(())
    }

    /// Sorts by sigma and gives the median, px, and the share within two sigmas of each part.
    fn finish(&mut self) -> (f32, [f64; PARTS]) {
        self.sigmas.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
        let count = self.sigmas.len();
        let median = self
            .sigmas
            .get(count / 2)
            .map_or(f32::NAN, |(sigma, _)| *sigma);
        let parts = std::array::from_fn(|k| {
            let part = &self.sigmas[k * count / PARTS..(k + 1) * count / PARTS];
            let within = part.iter().filter(|(_, within)| *within).count();
            within as f64 / part.len().max(1) as f64
        });
        (median, parts)
    }

    fn json(&mut self) -> Value {
        let (median, parts) = self.finish();
        println!(
            "sigma: {:32} {:9} {:.1} % within two, in quarters {:.1} {:.1} {:.1} {:.1}, median {median:.3} px, density {:.3}, bad-2 {:.2} %",
            self.name,
            self.preset.name(),
            100.0 * self.scores.coverage(),
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
            "within_two_sigma": self.scores.coverage(),
            "within_two_sigma_in_quarters": parts,
            "median_sigma_px": median,
        })
    }
}

/// All of them.
pub(super) fn json(groups: &mut [Group]) -> Value {
    Value::Array(groups.iter_mut().map(Group::json).collect())
}

/// Scores of each preset on each walk.
///
/// # Errors
/// A frame that cannot be matched.
pub(super) fn check(places: &[Place], frames: &[Found]) -> Result<Vec<Group>> {
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

/// Scores of each preset on all frames with each of the imperfections.
///
/// # Errors
/// A frame that cannot be matched.
pub(super) fn imperfect(frames: &[Found]) -> Result<Vec<Group>> {
    let mut groups = Vec::new();
    for preset in Preset::ALL {
        for (name, imperfections) in imperfect::FOR_TEST {
            let mut group = Group::new(&format!("imperfect: {name}"), preset);
            for (_, frame) in frames {
                group.add(&imperfections.apply(frame))?;
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
