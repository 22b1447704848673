//! Table of the pattern of a tag as an eye sees it: blurred by lens, pixel and motion.
//!
//! Contract: entries lie on a grid over the tag with its margin, in the tag's own axes; between
//! them the pattern and its derivatives are interpolated linearly. That widens the blur by the
//! variance of a triangle, h^2/6 for a step h, which the table has less.

use simd_dispatch::Kernel;

use crate::batch::{BATCH, Lane, PlaneBatch};
use crate::blur::Blur;
use crate::pattern::{PatternSample, Shares};
use crate::tag::Tag;
/// Entries per sigma of the blur, and limits of entries per cell.
const PER_SIGMA: f64 = 2.0;
const PER_CELL_LIMITS: [f64; 2] = [4.0, 16.0];
/// Motion between samples along a blur by motion, cells.
const MOTION_STEP_CELLS: f64 = 0.4;
/// Maximum blur by motion, cells: beyond, nothing is left of the pattern.
const MAX_MOTION_CELLS: f64 = 6.0;

/// Value, gradient per cell, and derivative by the logarithm of the blur of the lens.
type Texel = [f32; 4];

#[derive(Clone, Debug)]
pub(crate) struct Template {
    blur: Blur,
    per_cell: f64,
    half_cells: f64,
    side: usize,
    texels: Vec<Texel>,
}

impl Template {
    /// The pattern of a tag with this blur.
    pub(crate) fn new(tag: &Tag, blur: &Blur) -> Self {
        let smallest = blur.sigma[0].min(blur.sigma[1]);
        let [least, most] = PER_CELL_LIMITS;
        let per_cell = (PER_SIGMA / smallest).ceil().clamp(least, most);
        let motion = blur
            .motion
            .map(|v| v.clamp(-MAX_MOTION_CELLS, MAX_MOTION_CELLS) * per_cell);
        // Samples are in the middle of their parts of the motion, of which the last one ends
        // beyond.
        let step = (MOTION_STEP_CELLS * per_cell).floor().max(1.0);
        let around = motion.map(|v| (0.5 * (v.abs() + step)).ceil() as usize + 1);
        let side = tag.cells() * per_cell as usize + 1;
        let sharp = Grid::new(tag, blur, per_cell as usize, around);
        let is_moving = motion.iter().any(|v| v.abs() > 0.1);
        Self {
            blur: blur.clone(),
            per_cell,
            half_cells: tag.half_cells(),
            side,
            texels: match is_moving {
                true => sharp.along(motion, step, side),
                false => sharp.middle(side),
            },
        }
    }

    /// The blur that it has.
    pub(crate) fn blur(&self) -> &Blur {
        &self.blur
    }

    /// The pattern at a place, cells; beyond the margin as at its end.
    pub(crate) fn at(&self, place: [f64; 2]) -> PatternSample {
        let last = (self.side - 2) as f32;
        let [x, y] = place.map(|v| ((v + self.half_cells) * self.per_cell) as f32);
        let [column, row] = [x, y].map(|v| v.max(0.0).min(last) as usize);
        let weight = |v: f32, from: usize| (v - from as f32).clamp(0.0, 1.0);
        let (s, t) = (weight(x, column), weight(y, row));
        let at = row * self.side + column;
        let top = &self.texels[at..][..2];
        let bottom = &self.texels[at + self.side..][..2];
        let texel = mix(
            &mix(&top[0], &top[1], s),
            &mix(&bottom[0], &bottom[1], s),
            t,
        );
        let [value, x, y, by_log_blur] = texel.map(f64::from);
        PatternSample {
            value,
            gradient: [x, y],
            by_log_blur,
        }
    }
}

/// The pattern where a batch of pixels meets the plane of a tag: value, gradient per cell, and
/// derivative by the logarithm of the blur.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PatternBatch {
    pub(crate) value: Lane,
    pub(crate) x: Lane,
    pub(crate) y: Lane,
    pub(crate) by_log_blur: Lane,
}

impl PatternBatch {
    pub(crate) const ZERO: Self = Self {
        value: [0.0; BATCH],
        x: [0.0; BATCH],
        y: [0.0; BATCH],
        by_log_blur: [0.0; BATCH],
    };
}

impl Template {
    /// The pattern at the places of a batch, as [`Template::at`], and where the logarithm of the
    /// blur is larger by `growth`.
    #[inline(always)]
    pub(crate) fn sample(&self, points: &PlaneBatch, growth: f32, to: &mut PatternBatch) {
        let last = (self.side - 2) as f32;
        let (half, per_cell) = (self.half_cells as f32, self.per_cell as f32);
        let (mut columns, mut rows) = ([0_i32; BATCH], [0_i32; BATCH]);
        let (mut across, mut down) = ([0.0_f32; BATCH], [0.0_f32; BATCH]);
        for k in 0..BATCH {
            let x = (points.x[k] + half) * per_cell;
            let y = (points.y[k] + half) * per_cell;
            let (column, row) = (x.max(0.0).min(last) as i32, y.max(0.0).min(last) as i32);
            across[k] = (x - column as f32).clamp(0.0, 1.0);
            down[k] = (y - row as f32).clamp(0.0, 1.0);
            (columns[k], rows[k]) = (column, row);
        }
        let mut texels = [[0.0_f32; 4]; BATCH];
        for k in 0..BATCH {
            let at = rows[k] as usize * self.side + columns[k] as usize;
            let top = &self.texels[at..at + 2];
            let bottom = &self.texels[at + self.side..at + self.side + 2];
            let top = mix(&top[0], &top[1], across[k]);
            let bottom = mix(&bottom[0], &bottom[1], across[k]);
            texels[k] = mix(&top, &bottom, down[k]);
        }
        for k in 0..BATCH {
            let [value, x, y, by_log_blur] = texels[k];
            to.value[k] = value + growth * by_log_blur;
            (to.x[k], to.y[k], to.by_log_blur[k]) = (x, y, by_log_blur);
        }
    }
}

#[inline(always)]
fn mix(a: &Texel, b: &Texel, t: f32) -> Texel {
    let mut mix = *a;
    for k in 0..4 {
        mix[k] += (b[k] - a[k]) * t;
    }
    mix
}

/// Adds a row of cells to a row of the table, with the shares of the row of cells there.
struct AddRow<'k> {
    /// Value, derivative by x, and by blur across.
    row: &'k [Vec<f32>; 3],
    shares: [f32; 3],
    lens_share: f32,
    sums: &'k mut [Vec<f32>; 4],
}

impl Kernel for AddRow<'_> {
    type Output = ();

    #[inline(always)]
    fn run(self) {
        let [values, slopes, growths] = self.row;
        let [value, slope, growth] = self.shares;
        let [to_value, to_x, to_y, to_growth] = self.sums;
        let count = values.len();
        let (slopes, growths) = (&slopes[..count], &growths[..count]);
        let (to_value, to_x) = (&mut to_value[..count], &mut to_x[..count]);
        let (to_y, to_growth) = (&mut to_y[..count], &mut to_growth[..count]);
        let (down, across) = (growth * self.lens_share, value * self.lens_share);
        for k in 0..count {
            to_value[k] += value * values[k];
            to_x[k] += value * slopes[k];
            to_y[k] += slope * values[k];
            to_growth[k] += across * growths[k] + down * values[k];
        }
    }
}

/// The pattern without motion, on a larger grid.
struct Grid {
    /// Entries on each side around the tag, by axis.
    around: [usize; 2],
    columns: usize,
    texels: Vec<Texel>,
}

impl Grid {
    fn new(tag: &Tag, blur: &Blur, per_cell: usize, around: [usize; 2]) -> Self {
        let by_step = 1.0 / (6.0 * (per_cell * per_cell) as f64);
        let sigma = blur
            .sigma
            .map(|v| (v * v - by_step).max(0.25 * v * v).sqrt());
        let phases = sigma.map(|sigma| -> Vec<Shares> {
            let phase = |k: usize| Shares::new(k as f64 / per_cell as f64, sigma);
            (0..per_cell).map(phase).collect()
        });
        let count = around.map(|around| tag.cells() * per_cell + 1 + 2 * around);
        let place = |axis: usize, k: usize| {
            let from_begin = k as isize - around[axis] as isize;
            let step = per_cell as isize;
            let phase = from_begin.rem_euclid(step) as usize;
            (from_begin.div_euclid(step), &phases[axis][phase])
        };
        // By row of cells: value, derivative by x, and by blur across.
        let mut rows = vec![[const { Vec::new() }; 3]; tag.cells()];
        for (row, along) in rows.iter_mut().enumerate() {
            *along = std::array::from_fn(|_| vec![0.0_f32; count[0]]);
            let whites = tag.whites(row);
            for k in 0..count[0] {
                let (cell, shares) = place(0, k);
                for (column, shares) in shares.cells(cell, tag) {
                    for (along, share) in along.iter_mut().zip(shares) {
                        along[k] += whites[column] * share as f32;
                    }
                }
            }
        }
        let mut texels = vec![[0.0; 4]; count[0] * count[1]];
        let lens_share = blur.lens_share as f32;
        let mut sums: [Vec<f32>; 4] = std::array::from_fn(|_| vec![0.0; count[0]]);
        for (k, row) in texels.chunks_exact_mut(count[0]).enumerate() {
            for sums in &mut sums {
                sums.fill(0.0);
            }
            let (cell, shares) = place(1, k);
            for (of_row, shares) in shares.cells(cell, tag) {
                simd_dispatch::run(AddRow {
                    row: &rows[of_row],
                    shares: shares.map(|v| v as f32),
                    lens_share,
                    sums: &mut sums,
                });
            }
            for (k, texel) in row.iter_mut().enumerate() {
                *texel = std::array::from_fn(|kind| sums[kind][k]);
            }
        }
        Self {
            around,
            columns: count[0],
            texels,
        }
    }

    /// The part over the tag.
    fn middle(&self, side: usize) -> Vec<Texel> {
        let rows = self.texels.chunks_exact(self.columns);
        rows.skip(self.around[1])
            .take(side)
            .flat_map(|row| &row[self.around[0]..][..side])
            .copied()
            .collect()
    }

    /// The mean along a motion, entries, over the tag. Samples are `stride` entries apart along the
    /// axis along which it is longer.
    fn along(&self, motion: [f64; 2], stride: f64, side: usize) -> Vec<Texel> {
        let long = usize::from(motion[1].abs() > motion[0].abs());
        let half = 0.5 * motion[long].abs();
        let count = ((half / stride) + 0.5).floor() as isize;
        let slope = motion[1 - long] / motion[long];
        let mut mean = vec![[0.0; 4]; side * side];
        for n in -count..=count {
            let along = n as f64 * stride;
            // Part of the motion that is next to this sample.
            let [from, to] = [along - 0.5 * stride, along + 0.5 * stride];
            let weight = (to.min(half) - from.max(-half)) / (2.0 * half);
            if weight <= 0.0 {
                continue;
            }
            let aside = along * slope;
            let begin = |axis: usize, v: f64| (self.around[axis] as f64 + v.floor()) as usize;
            let (along, of_next) = (along as isize, (aside - aside.floor()) as f32);
            let whole = (self.around[long] as isize + along) as usize;
            let [first, next] = match long {
                0 => [whole, begin(1, aside)],
                _ => [begin(0, aside), whole],
            };
            let neighbor = if long == 0 { self.columns } else { 1 };
            let weights = [weight as f32 * (1.0 - of_next), weight as f32 * of_next];
            for (row, out) in mean.chunks_exact_mut(side).enumerate() {
                let at = (next + row) * self.columns + first;
                let (near, far) = (&self.texels[at..][..side], &self.texels[at + neighbor..]);
                for ((out, near), far) in out.iter_mut().zip(near).zip(far) {
                    for kind in 0..4 {
                        out[kind] += weights[0] * near[kind] + weights[1] * far[kind];
                    }
                }
            }
        }
        mean
    }
}

#[cfg(test)]
mod tests {
    use boards::Dictionary;

    use super::*;
    use crate::pattern::sample;

    /// The mean of exact samples along the motion.
    fn exact(tag: &Tag, place: [f64; 2], blur: &Blur) -> [f64; 4] {
        const SAMPLES: usize = 64;
        let mut sum = [0.0; 4];
        for n in 0..SAMPLES {
            let t = (n as f64 + 0.5) / SAMPLES as f64 - 0.5;
            let at = [0, 1].map(|k| place[k] + t * blur.motion[k]);
            let sample = sample(tag, at, blur.sigma);
            let [x, y] = sample.gradient;
            let by_log_blur = blur.lens_share * sample.by_log_blur;
            let sampled = [sample.value, x, y, by_log_blur];
            for (sum, v) in sum.iter_mut().zip(sampled) {
                *sum += v / SAMPLES as f64;
            }
        }
        sum
    }

    /// Each motion ends at another place between two samples.
    #[test]
    fn motions_of_any_length_are_within_the_grid() {
        let tag = Tag::new(Dictionary::AprilTag36h11, 3, 0.08).expect("a tag");
        for n in 0..160 {
            let long = 0.05 * f64::from(n) - 4.0;
            for motion in [[long, 0.3 * long], [-0.9 * long, long], [0.0, long]] {
                let blur = Blur {
                    sigma: [0.12, 0.12],
                    motion,
                    lens_share: 0.8,
                };
                let template = Template::new(&tag, &blur);
                let middle = template.at([0.0, 0.0]).value;
                let expected = exact(&tag, [0.0, 0.0], &blur)[0];
                assert!(
                    (middle - expected).abs() < 0.3,
                    "{motion:?}: {middle} {expected}"
                );
            }
        }
    }

    #[test]
    fn table_agrees_with_the_exact_pattern() {
        let tag = Tag::new(Dictionary::AprilTag36h11, 3, 0.08).expect("a tag");
        for (sigma, motion, bounds) in [
            ([0.3, 0.3], [0.0, 0.0], [0.004, 0.03]),
            ([0.15, 0.2], [0.0, 0.0], [0.004, 0.06]),
            ([0.4, 0.3], [1.3, -0.6], [0.004, 0.03]),
            ([0.3, 0.3], [0.2, -2.4], [0.004, 0.03]),
        ] {
            let blur = Blur {
                sigma,
                motion,
                lens_share: 0.8,
            };
            let template = Template::new(&tag, &blur);
            let (mut squares, count) = ([0.0; 4], 2000);
            for k in 0..count {
                let draw = |n: u64| ((k * 7919 + n * 104_729) % 1009) as f64 / 1009.0;
                let place = [9.6 * draw(1) - 4.8, 9.6 * draw(2) - 4.8];
                let found = template.at(place);
                let [x, y] = found.gradient;
                let expected = exact(&tag, place, &blur);
                for (n, v) in [found.value, x, y, found.by_log_blur].iter().enumerate() {
                    squares[n] += (v - expected[n]).powi(2) / count as f64;
                }
            }
            let [value, x, y, growth] = squares.map(f64::sqrt);
            assert!(value < bounds[0], "{sigma:?} {motion:?}: {value}");
            for error in [x, y, growth] {
                assert!(error < bounds[1], "{sigma:?} {motion:?}: {error}");
            }
        }
    }
}
