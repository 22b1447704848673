//! What the cells of a tag show, against what its code says.

use crate::batch::PlaneBatch;
use crate::levels::Levels;
use crate::linearization::{PatchModel, Sample, State};
use crate::patch::{Window, cell_at, plane};
use crate::tag::Tag;
use crate::template::PatternBatch;
use crate::view::Motion;

/// Deviation from which on something hides a cell, and from which on its bit is wrong: 1 is that of
/// a cell of the other color.
const HIDDEN: f64 = 0.4;
const WRONG: f64 = 0.5;

/// Minimum share of a cell in the pattern at its middle by which deviations are scaled: where
/// cells are blurred into each other, a deviation of all of them is noise. The second one is for
/// what hides cells that motion blurs, which is several of them.
const MIN_SHARE: f64 = 0.4;
const MIN_HIDDEN_SHARE: f64 = 0.7;

/// Pixels of a window per cell that are compared at most.
const PIXELS_PER_CELL: usize = 30;

/// Pixels near the middle of a cell depend on it most: weight along one axis of a place, cells
/// about the middle of the tag.
fn middle_weight(at: f32, half_cells: f32) -> f32 {
    let place = at + half_cells;
    let from_middle = place - (place as i32) as f32 - 0.5;
    let share = 1.0 - 4.0 * from_middle * from_middle;
    share * share
}

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
    /// Compares the pixels of a window, of large tags an evenly spread part of them, with the
    /// pattern that was fitted.
    pub(crate) fn new(
        window: &Window<'_>,
        own: &PatchModel<'_>,
        tag: &Tag,
        (state, levels): (&State, &Levels),
        motion: &Motion,
        blurred_cells: f64,
    ) -> Self {
        let count = tag.cells() * tag.cells();
        let mut sums = vec![[0.0; 2]; count];
        let half = tag.half_cells();
        let stride = window.stride(count * PIXELS_PER_CELL);
        let pixels = window.near(tag, (&state.pose, motion), [half; 2], stride, |_| true);
        if let Some(plane) = plane(&window.view, tag, (&state.pose, motion), &pixels) {
            let tone = levels.tone(state.tone);
            let (black, by_contrast) = (levels.black as f32, 1.0 / levels.contrast() as f32);
            let (mut point, mut pattern) = (PlaneBatch::ZERO, PatternBatch::ZERO);
            for (number, batch) in pixels.batches.iter().enumerate() {
                simd_dispatch::run(Sample {
                    plane: &plane,
                    template: own.template(),
                    growth: own.growth(state.log_blur),
                    pixels: batch,
                    point: &mut point,
                    pattern: &mut pattern,
                });
                for k in 0..pixels.count_of(number) {
                    let at = [point.x[k], point.y[k]];
                    let found = (batch.level[k] - black) * by_contrast;
                    let deviation = found - tone.at(pattern.value[k]).0;
                    let weight =
                        middle_weight(at[0], half as f32) * middle_weight(at[1], half as f32);
                    let sum = &mut sums[cell_at(tag, at)];
                    sum[0] += f64::from(weight * deviation);
                    sum[1] += f64::from(weight);
                }
            }
        }
        let deviation = |[sum, weight]: [f64; 2]| (weight > 0.05).then(|| sum / weight);
        Self {
            deviations: sums.into_iter().map(deviation).collect(),
            own_share: (
                own.blur.own_share(),
                own.blur.motion_cells() > blurred_cells,
            ),
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
