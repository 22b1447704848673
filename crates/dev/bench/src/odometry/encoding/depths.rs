//! Depth of the same images against ground truth of some of them.
//!
//! Images are rectified and matched as in `paws-reconstruct`, in `balanced`, over all disparities
//! of the scenes.

use anyhow::{Context, Result};
use depth::evaluate::Scores;
use depth::{Band, Config, Matcher, Preset};
use harness::sequences::{OwnedFrameSet, Sequence};
use serde::Serialize;

use crate::depth::frames::{Frame, Walk};
use crate::depth::race::BAD_2;

/// Sampling stride of the sets; the first one is at half the stride.
const EVERY: usize = 60;

/// Depth of the sampled frames.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct Depth {
    /// Pixels with ground truth, visible in both images.
    pub(super) pixels: u64,
    /// Share of them that have a disparity.
    pub(super) density: f64,
    /// Ratio of the disparities with an error of more than 2 px.
    pub(super) bad_2: f64,
    /// Ratio of the pixels with an error of more than 2 px or without disparity.
    pub(super) bad_2_of_all: f64,
    /// Mean error of the disparities, px.
    pub(super) mean_error_px: f64,
    /// Share of the disparities within two sigma of the truth.
    pub(super) inside: f64,
}

/// The sampled frames.
pub(super) struct Depths {
    walk: Walk,
    /// Camera, set, and the frame.
    frames: Vec<(usize, usize, Frame)>,
}

impl Depths {
    /// Renders the truth of a walk.
    ///
    /// # Errors
    /// A pair cannot be rectified.
    pub(super) fn of(sequence: &Sequence) -> Result<Self> {
        let simulation = sequence.truth().simulation();
        let walk = Walk::of(simulation.context("a walk is simulated")?.clone());
        let sets: Vec<usize> = (EVERY / 2..sequence.len()).step_by(EVERY).collect();
        let numbers: Vec<u64> = sets.iter().map(|k| *k as u64).collect();
        let mut frames = Vec::new();
        for camera in 0..walk.cameras() {
            let own = walk.frames(camera, &numbers)?;
            let own = sets
                .iter()
                .zip(own)
                .map(|(set, frame)| (camera, *set, frame));
            frames.extend(own);
        }
        Ok(Self { walk, frames })
    }

    /// Matches the images of these sets.
    ///
    /// # Errors
    /// An image is missing, or of another size.
    pub(super) fn score(&self, sets: &[OwnedFrameSet]) -> Result<Depth> {
        let mut scores = Scores::default();
        for (camera, set, frame) in &self.frames {
            let view = sets[*set].views[*camera].as_ref();
            let view =
                view.with_context(|| format!("set {set} has no image of camera {camera}"))?;
            let frame = Frame {
                eyes: self.walk.rectified(*camera, [&view.left, &view.right])?,
                ..frame.clone()
            };
            let settings = Config::preset(Preset::Balanced);
            let mut matcher = Matcher::new(settings, frame.width, frame.height)?;
            let [left, right] = frame.images();
            let band = Band::full(0, frame.range, frame.height)?;
            scores.add(&Scores::of(
                matcher.run(&left, &right, &band)?,
                frame.truth(),
            )?);
        }
        Ok(Depth {
            pixels: scores.pixels,
            density: scores.density(),
            bad_2: scores.bad_ratio(BAD_2),
            bad_2_of_all: scores.bad_ratio_of_all(BAD_2),
            mean_error_px: scores.mean_error_px(),
            inside: scores.coverage(),
        })
    }
}
