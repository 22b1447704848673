//! What the cells of a tag show, against what its code says.

use cad_transforms::RigidTransform;

use crate::levels::Levels;
use crate::patch::{Window, cell_at};
use crate::tag::Tag;
use crate::tone::Tone;
use crate::view::{Motion, PlanePoint};

/// Deviation from which on something hides a cell, and from which on its bit is wrong: 1 is that of
/// a cell of the other color.
const HIDDEN: f64 = 0.4;
const WRONG: f64 = 0.5;

/// Minimum share of a cell in the pattern at its middle by which deviations are scaled: where
/// cells are blurred into each other, a deviation of all of them is noise. The second one is for
/// what hides cells that motion blurs, which is several of them.
const MIN_SHARE: f64 = 0.4;
const MIN_HIDDEN_SHARE: f64 = 0.7;

/// Mean deviations of the cells of a tag in an eye.
#[derive(Clone, Debug)]
pub(crate) struct Cells {
    /// Row by row with margins, relative to a cell of the other color that is not blurred; `None`
    /// outside the image.
    deviations: Vec<Option<f64>>,
    /// Share of a cell in the pattern at its middle, and whether that is by motion.
    own_share: (f64, bool),
}

impl Cells {
    /// Compares all pixels of a window; `light` is the pattern at a place of the plane, and
    /// `own_share` what a cell contributes to it at its middle, and whether motion blurs
    /// it.
    pub(crate) fn new(
        window: &Window<'_>,
        tag: &Tag,
        pose: &RigidTransform,
        motion: &Motion,
        (levels, tone): (&Levels, &Tone),
        (light, own_share): (impl Fn(&PlanePoint) -> f64, (f64, bool)),
    ) -> Self {
        let count = tag.cells() * tag.cells();
        let mut sums = vec![[0.0; 2]; count];
        window.for_each(pose, motion, |pixel, _, point| {
            let Some(cell) = cell_at(tag, point.at) else {
                return;
            };
            let expected = f64::from(tone.at(light(point) as f32).0);
            let found = (pixel.level - levels.black) / levels.contrast();
            // Pixels near the middle of a cell depend on it most.
            let from_middle = point.at.map(|v| {
                let place = v / tag.cell_m() + tag.half_cells();
                place - place.floor() - 0.5
            });
            let weight = from_middle
                .map(|v| (1.0 - 4.0 * v * v).powi(2))
                .iter()
                .product::<f64>();
            sums[cell][0] += weight * (found - expected);
            sums[cell][1] += weight;
        });
        let deviation = |[sum, weight]: [f64; 2]| (weight > 0.05).then(|| sum / weight);
        Self {
            deviations: sums.into_iter().map(deviation).collect(),
            own_share,
        }
    }

    /// Cells that something hides.
    pub(crate) fn is_hidden(&self) -> Vec<bool> {
        let (own_share, is_moving) = self.own_share;
        let least_share = if is_moving {
            MIN_HIDDEN_SHARE
        } else {
            MIN_SHARE
        };
        let least = HIDDEN * own_share.max(least_share);
        let hidden = |d: &Option<f64>| d.is_none_or(|d| d.abs() > least);
        self.deviations.iter().map(hidden).collect()
    }

    /// Share of cells that agree with the code, relative to what blur leaves of them.
    pub(crate) fn agreeing_share(&self) -> f64 {
        let least = HIDDEN * self.own_share.0.max(MIN_SHARE);
        let agreeing = self.deviations.iter().flatten();
        let agreeing = agreeing.filter(|d| d.abs() < least).count();
        agreeing as f64 / self.deviations.len() as f64
    }

    /// Share of cells that show the tag.
    pub(crate) fn visible_share(&self) -> f64 {
        let hidden = self
            .is_hidden()
            .into_iter()
            .filter(|hidden| *hidden)
            .count();
        1.0 - hidden as f64 / self.deviations.len() as f64
    }

    /// Number of bits that contradict the code, or are outside the image.
    pub(crate) fn wrong_bits(&self, tag: &Tag) -> u32 {
        let bits = tag.bits();
        let cells = bits
            .clone()
            .flat_map(|row| bits.clone().map(move |column| (row, column)));
        let wrong = cells.filter(|&(row, column)| {
            let towards = if tag.is_white(row, column) { -1.0 } else { 1.0 };
            let deviation = self.deviations[row * tag.cells() + column];
            let least = WRONG * self.own_share.0.max(MIN_SHARE);
            deviation.is_none_or(|deviation| towards * deviation > least)
        });
        wrong.count() as u32
    }
}
