//! Cost aggregation: from two images to the winning disparity of each pixel.
//!
//! Contract: path costs are summed per pixel and disparity, and the minimum is taken in the left
//! and in the right image. The result is the same on any number of threads and at any [`Level`].
//!
//! Two sweeps run in parallel, one from the top and one from the bottom. Each processes the rows of
//! its own half first and stores, for every pixel there, the sum of the paths from its side. Then
//! each continues into the other half, where the sums of the other sweep are stored, adds its own
//! paths and those along the row, and selects the minimum. Every path therefore spans the whole
//! image, matching costs are computed twice and never stored, and each byte of the sum volume is
//! written once and read once. With [`Paths::Three`] the sweeps end at the middle row and no sums
//! are stored.

use crate::census::{Census, Codes, Layout, PaddedImage};
use crate::cost::{CostRow, INVALID};
use crate::lanes::{Kernel, Lanes, Level};
use imaging::ImageView;
use serde::{Deserialize, Serialize};

mod backward;
mod forward;

use backward::{BackwardPass, INVALID_SUM, RightWinners};
pub(crate) use backward::{NONE, Winner};
use forward::{ForwardPass, Front, Steps};

/// Which paths lead to a pixel.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Paths {
    /// Both directions along the row, and vertically from the nearer of the upper and the lower
    /// border.
    Three,
    /// Both directions along the row and the column.
    Four,
    /// Rows, columns and diagonals.
    Eight,
}

/// Smoothness penalties from one pixel of a path to the next (P1 and P2 of semi-global matching).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Penalties {
    /// P1: for a disparity change of 1.
    pub small: u8,
    /// P2: for a larger change, where the two pixels have the same gray level.
    pub large: u8,
    /// Reduction of the large penalty per gray level of difference between the two pixels.
    pub slope: u8,
    /// Lower limit of the large penalty.
    pub min_large: u8,
}

/// Matching cost and path penalties.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Weights {
    pub(crate) census: Census,
    pub(crate) max_gray_cost: u8,
    pub(crate) paths: Paths,
    pub(crate) penalties: Penalties,
}

/// Searched disparities: `count` of them from `first`; row `y` searches `rows[y][0]..rows[y][1]`,
/// counted from `first`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Range<'a> {
    pub(crate) first: i32,
    pub(crate) count: usize,
    pub(crate) rows: &'a [[u16; 2]],
}

/// Computed disparity lanes, in whole vectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Span {
    start: usize,
    lanes: usize,
}

impl Span {
    fn end(self) -> usize {
        self.start + self.lanes
    }

    /// Covers the lanes `low..high` and one more at either side. The result must not depend on the
    /// vector length.
    fn around([low, high]: [u16; 2], stride: usize, vector: usize) -> Self {
        let start = usize::from(low).saturating_sub(1) / 16 * 16;
        let end = (usize::from(high) + 1).min(stride);
        let lanes = (end - start).next_multiple_of(vector);
        Self {
            start: start.min(stride - lanes),
            lanes,
        }
    }
}

/// Calls a method with the number of vectors as a constant generic.
macro_rules! with_vectors {
    ($V:ident, $count:expr, $self:ident.$method:ident) => {
        match $count {
            1 => $self.$method::<$V, 1>(),
            2 => $self.$method::<$V, 2>(),
            3 => $self.$method::<$V, 3>(),
            4 => $self.$method::<$V, 4>(),
            5 => $self.$method::<$V, 5>(),
            6 => $self.$method::<$V, 6>(),
            7 => $self.$method::<$V, 7>(),
            8 => $self.$method::<$V, 8>(),
            count => unreachable!(
                "{count} vectors are more than {} disparities",
                super::MAX_DISPARITIES
            ),
        }
    };
}
use with_vectors;

/// Maximum number of disparities.
pub(crate) const MAX_DISPARITIES: usize = 256;

/// Buffers that are reused from one image pair to the next.
#[derive(Debug, Default)]
pub(crate) struct Aggregation {
    codes: [Codes; 2],
    stored: Vec<u8>,
    sweeps: [Sweep; 2],
    /// Winner of each pixel of the left image.
    pub(crate) winners: Vec<Winner>,
    /// Winning lane of each pixel of the right image; [`NONE`] where no disparity is valid.
    pub(crate) right: Vec<u16>,
}

#[derive(Debug, Default)]
struct Sweep {
    before: Front,
    after: Front,
    costs: Vec<u8>,
    sum: Vec<u8>,
    large: [Vec<u8>; 4],
    out: Vec<u8>,
    right: RightWinners,
    upwards: bool,
}

/// Input that both sweeps share.
struct Job<'a> {
    level: Level,
    weights: Weights,
    range: Range<'a>,
    codes: &'a [Codes; 2],
    gray: &'a PaddedImage,
    width: usize,
    stride: usize,
    origin: usize,
}

/// Maximum negative disparity, px: padding at the right border of the right image. The sky may have
/// disparities slightly below 0.
pub(crate) const MAX_NEGATIVE_PX: usize = 32;

impl Aggregation {
    /// Computes the winners. Both images have the same size, and `range` has one entry per row.
    pub(crate) fn run(
        &mut self,
        level: Level,
        weights: Weights,
        [left, right]: [&ImageView<'_>; 2],
        range: Range<'_>,
    ) {
        let (width, height) = (left.width(), left.height());
        let stride = range.count.next_multiple_of(level.lanes());
        debug_assert!(range.first >= -(MAX_NEGATIVE_PX as i32) && range.count <= MAX_DISPARITIES);
        let [of_left, of_right] = &mut self.codes;
        let mirrored = Layout {
            before: MAX_NEGATIVE_PX,
            behind: stride + range.first.max(0) as usize,
            mirrored: true,
        };
        rayon::join(
            || of_left.compute(level, weights.census, left, Layout::default()),
            || of_right.compute(level, weights.census, right, mirrored),
        );
        self.winners.resize(width * height, Winner::default());
        self.right.resize(width * height, NONE);
        let stores_sums = weights.paths != Paths::Three;
        self.stored.resize(
            if stores_sums {
                width * height * stride
            } else {
                0
            },
            0,
        );
        for (sweep, upwards) in self.sweeps.iter_mut().zip([false, true]) {
            sweep.begin(width, stride, level.lanes());
            sweep.upwards = upwards;
        }
        let job = Job {
            level,
            weights,
            range,
            codes: &self.codes,
            gray: &PaddedImage::new(left, 1, level.lanes()),
            width,
            stride,
            origin: (MAX_NEGATIVE_PX as i32 + width as i32 - 1 + range.first) as usize,
        };
        let middle = height / 2;
        let [from_top, from_bottom] = &mut self.sweeps;
        let (upper_winners, lower_winners) = self.winners.split_at_mut(middle * width);
        let (upper_right, lower_right) = self.right.split_at_mut(middle * width);
        let upper = (upper_winners, upper_right);
        let lower = (lower_winners, lower_right);
        if !stores_sums {
            rayon::join(
                || job.finish(from_top, (0..middle).collect(), None, upper),
                || job.finish(from_bottom, (middle..height).rev().collect(), None, lower),
            );
            return;
        }
        let (stored_above, stored_below) = self.stored.split_at_mut(middle * width * stride);
        rayon::join(
            || job.store(from_top, (0..middle).collect(), stored_above),
            || job.store(from_bottom, (middle..height).rev().collect(), stored_below),
        );
        let (stored_above, stored_below) = (&*stored_above, &*stored_below);
        rayon::join(
            || {
                job.finish(
                    from_top,
                    (middle..height).collect(),
                    Some(stored_below),
                    lower,
                )
            },
            || {
                let rows = (0..middle).rev().collect();
                job.finish(from_bottom, rows, Some(stored_above), upper);
            },
        );
    }
}

impl Sweep {
    fn begin(&mut self, width: usize, stride: usize, lanes: usize) {
        self.before.begin(width, stride);
        self.after.begin(width, stride);
        for buffer in [&mut self.costs, &mut self.sum] {
            buffer.resize(width * stride, 0);
        }
        for row in &mut self.large {
            row.resize(width.next_multiple_of(lanes), 0);
        }
        self.out.resize(stride, 0);
        for row in [&mut self.right.sums, &mut self.right.lanes] {
            row.resize(width + stride + MAX_NEGATIVE_PX, NONE);
        }
    }
}

impl Job<'_> {
    /// Processes consecutive rows and stores the sums of the paths of this sweep. `stored` holds
    /// these rows in image order.
    fn store(&self, sweep: &mut Sweep, rows: Vec<usize>, stored: &mut [u8]) {
        let first = rows.iter().copied().min().unwrap_or(0);
        for y in rows {
            let span = self.cost(sweep, y);
            let to = (y - first) * self.width * self.stride;
            let sum = &mut stored[to..to + self.width * self.stride];
            self.advance(sweep, y, span, false, Some(sum));
        }
    }

    /// Processes consecutive rows and computes the winners.
    fn finish(
        &self,
        sweep: &mut Sweep,
        rows: Vec<usize>,
        stored: Option<&[u8]>,
        (winners, right): (&mut [Winner], &mut [u16]),
    ) {
        let (width, stride) = (self.width, self.stride);
        let first = rows.iter().copied().min().unwrap_or(0);
        for y in rows {
            let span = self.cost(sweep, y);
            self.advance(sweep, y, span, true, None);
            // Along the row from the right.
            self.large(&mut sweep.large[3], y, (1, 0));
            let k = y - first;
            let of_row = k * width..(k + 1) * width;
            self.level.run(BackwardPass {
                width,
                stride,
                span,
                costs: &sweep.costs,
                sums: [
                    Some(&sweep.sum),
                    stored.map(|stored| &stored[k * width * stride..(k + 1) * width * stride]),
                ],
                small: self.weights.penalties.small,
                large: &sweep.large[3],
                winners: &mut winners[of_row.clone()],
                right: &mut sweep.right,
            });
            let out = INVALID_SUM * if stored.is_some() { 3 } else { 2 };
            for (x, to) in right[of_row].iter_mut().enumerate() {
                let column = (width - 1 - x) as i64 - i64::from(self.range.first);
                let column = usize::try_from(column).unwrap_or(usize::MAX);
                *to = match sweep.right.sums.get(column) {
                    Some(sum) if *sum < out => sweep.right.lanes[column],
                    _ => NONE,
                };
            }
        }
    }

    fn cost(&self, sweep: &mut Sweep, y: usize) -> Span {
        let [low, high] = self.range.rows[y];
        for (lane, out) in sweep.out.iter_mut().enumerate() {
            let is_in = (usize::from(low)..usize::from(high)).contains(&lane);
            *out = if is_in { 0 } else { INVALID };
        }
        let span = Span::around([low, high], self.stride, self.level.lanes());
        self.level.run(CostRow {
            left: &self.codes[0],
            right: &self.codes[1],
            planes: self.weights.census.planes(),
            max_gray_cost: self.weights.max_gray_cost,
            y,
            origin: self.origin,
            first: self.range.first,
            width: self.width,
            stride: self.stride,
            start: span.start,
            lanes: span.lanes,
            out: &sweep.out,
            costs: &mut sweep.costs,
        });
        span
    }

    /// Advances the paths of a sweep by one row. Their sum is written to `stored`, or to the buffer
    /// of the sweep.
    fn advance(
        &self,
        sweep: &mut Sweep,
        y: usize,
        span: Span,
        along: bool,
        stored: Option<&mut [u8]>,
    ) {
        let diagonal = self.weights.paths == Paths::Eight;
        let from = if sweep.upwards { 1 } else { -1 };
        let steps = [(0, from), (-1, from), (1, from), (-1, 0)];
        let needed = [true, diagonal, diagonal, along];
        for ((row, step), needed) in sweep.large.iter_mut().zip(steps).zip(needed) {
            if needed {
                self.large(row, y, step);
            }
        }
        let [straight, left, right, beside] = &sweep.large;
        self.level.run(ForwardPass {
            width: self.width,
            stride: self.stride,
            span,
            costs: &sweep.costs,
            before: &mut sweep.before,
            after: &mut sweep.after,
            diagonal,
            along,
            steps: Steps {
                small: self.weights.penalties.small,
                large: [straight, left, right, beside],
            },
            sum: stored.unwrap_or(&mut sweep.sum),
        });
        std::mem::swap(&mut sweep.before, &mut sweep.after);
    }

    /// Large penalties of a row, for the path direction given by the previous pixel.
    fn large(&self, row: &mut [u8], y: usize, from: (i32, i32)) {
        self.level.run(Large {
            here: self.gray.row(y, (0, 0)),
            there: self.gray.row(y, from),
            penalties: self.weights.penalties,
            row,
        });
    }
}

/// Large penalties from the gray-level difference of two image rows. The length of the output row
/// is a multiple of the vector length.
struct Large<'a> {
    here: &'a [u8],
    there: &'a [u8],
    penalties: Penalties,
    row: &'a mut [u8],
}

impl Kernel for Large<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let count = self.row.len();
        assert!(
            count.is_multiple_of(V::COUNT) && self.here.len() >= count && self.there.len() >= count
        );
        let most = V::splat(self.penalties.large);
        let least = V::splat(self.penalties.min_large);
        for at in (0..count).step_by(V::COUNT) {
            // SAFETY: all three slices are long enough, as asserted above.
            let [a, b] = unsafe {
                let load = [self.here.as_ptr().add(at), self.there.as_ptr().add(at)];
                [V::load(load[0]), V::load(load[1])]
            };
            let apart = a.sub(b).or(b.sub(a));
            let mut large = most;
            for _ in 0..self.penalties.slope {
                large = large.sub(apart);
            }
            // Clamp to the lower limit.
            let large = least.add(large.sub(least));
            // SAFETY: as above.
            unsafe { large.store(self.row.as_mut_ptr().add(at)) };
        }
    }
}

#[cfg(test)]
mod tests;
