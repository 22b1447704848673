//! Depth of the same pictures against the truth of some of them.
//!
//! Pictures are rectified and matched as `paws-reconstruct` does it, in `balanced`, over all disparities that the scenes have.

use anyhow::{Context, Result};
use depth::evaluate::Scores;
use depth::{Band, Matcher, Preset, Settings};
use serde::Serialize;
use tests::sequences::{OwnedFrameSet, Sequence};

use crate::depth::frames::{Frame, Walk};
use crate::depth::race::BAD_2;

/// Of so many sets one is looked at, from the first after half as many on.
const EVERY: usize = 60;

/// Depth of the frames that were looked at.
#[derive(Clone, Copy, Debug, Serialize)]
pub(super) struct Depth {
    /// Pixels with a truth that both eyes see.
    pub(super) pixels: u64,
    /// Share of them that have a disparity.
    pub(super) density: f64,
    /// Share of the disparities that are off by more than 2 px.
    pub(super) bad_2: f64,
    /// Share of the pixels that are off by more than 2 px or have none.
    pub(super) bad_2_of_all: f64,
    /// Mean error of the disparities, px.
    pub(super) mean_error_px: f64,
    /// Share of the disparities within two sigma of the truth.
    pub(super) inside: f64,
}

/// The frames that are looked at.
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

    /// Matches the pictures of these sets.
    ///
    /// # Errors
    /// A picture is missing, or of another size.
    pub(super) fn score(&self, sets: &[OwnedFrameSet]) -> Result<Depth> {
        let mut scores = Scores::default();
        for (camera, set, frame) in &self.frames {
            let view = sets[*set].views[*camera].as_ref();
            let view =
                view.with_context(|| format!("set {set} has no picture of camera {camera}"))?;
            let frame = Frame {
                eyes: self.walk.rectified(*camera, [&view.left, &view.right])?,
                ..frame.clone()
            };
            let settings = Settings::preset(Preset::Balanced);
            let mut matcher = Matcher::new(settings, frame.width, frame.height)?;
            let [left, right] = frame.pictures();
            let band = Band::full(0, frame.range, frame.height)?;
            scores.add(&Scores::of(
                matcher.run(&left, &right, &band)?,
                frame.truth(),
            )?);
        }
        Ok(Depth {
            pixels: scores.pixels,
            density: scores.density(),
            bad_2: scores.bad(BAD_2),
            bad_2_of_all: scores.bad_of_all(BAD_2),
            mean_error_px: scores.mean_error_px(),
            inside: scores.inside(),
        })
    }
}
