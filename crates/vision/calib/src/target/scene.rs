//! What the boards of an image are found from, and what is found.

use super::blur::Border;
use super::config::Config;
use super::link::{self, Links};
use super::saddle::{self, Saddle};
use super::smooth::Smooth;

/// The crossings of an image and their links.
pub(super) struct Scene {
    pub(super) config: Config,
    pub(super) smooth: Smooth,
    pub(super) saddles: Vec<Saddle>,
    pub(super) links: Links,
}

impl Scene {
    pub(super) fn of(smooth: Smooth, config: &Config) -> Self {
        let saddles = saddle::find(&smooth, config);
        let links = link::join(&smooth, &saddles, &config.links);
        Self {
            config: *config,
            smooth,
            saddles,
            links,
        }
    }
}

/// A corner before the final refinement.
#[derive(Clone, Copy, Debug)]
pub(super) struct CornerCandidate {
    pub(super) id: u32,
    pub(super) at: [f64; 2],
    /// Along the two borders, the distance without other print, pixels.
    pub(super) sides: [[f64; 2]; 2],
    /// Distance to the nearest other corner along a border, pixels.
    pub(super) gap: f64,
}

/// A board before the final refinement.
#[derive(Clone, Debug, Default)]
pub(super) struct BoardCandidate {
    pub(super) corners: Vec<CornerCandidate>,
    pub(super) borders: Vec<Border>,
    pub(super) half_turn: bool,
    pub(super) remark: Option<&'static str>,
}

impl BoardCandidate {
    /// Converts from half the image size to full size.
    pub(super) fn enlarge(&mut self) {
        let up = |at: [f64; 2]| at.map(|v| 2.0 * v + 0.5);
        for corner in &mut self.corners {
            corner.at = up(corner.at);
            corner.gap *= 2.0;
            corner.sides = corner.sides.map(|side| side.map(|v| 2.0 * v));
        }
        for border in &mut self.borders {
            (border.ends, border.clear) = (border.ends.map(up), 2.0 * border.clear);
        }
    }
}
