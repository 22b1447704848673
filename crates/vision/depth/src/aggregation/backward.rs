//! Right-to-left path along a row, and selection of the winning disparity.

use super::Span;
use super::forward::{load, step_along};
use crate::cost::INVALID;
use crate::lanes::{Kernel, Lanes, Words};

/// Winning disparity of a pixel, with the sums that describe how distinct it is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Winner {
    /// Lane with the smallest sum, the first one among equals. [`NONE`] where no disparity is
    /// valid.
    pub(crate) lane: u16,
    /// Sum of the winning lane.
    pub(crate) least: u16,
    /// Smallest sum among the lanes that are neither the winner nor adjacent to it.
    pub(crate) second: u16,
    /// Sums of the previous and the next lane.
    pub(crate) beside: [u16; 2],
}

/// Winners of one row of the right image, last column first: index 0 belongs to lane 0 of the last
/// column of the left image.
#[derive(Clone, Debug, Default)]
pub(super) struct RightWinners {
    /// Smallest sums and their lanes; among equals the rightmost column wins.
    pub(super) sums: Vec<u16>,
    pub(super) lanes: Vec<u16>,
}

/// No lane, or no sum.
pub(crate) const NONE: u16 = u16::MAX;
/// Contribution of an invalid disparity to each partial sum; valid ones contribute less.
pub(super) const INVALID_SUM: u16 = INVALID as u16;

/// Right-to-left pass over one row.
pub(super) struct BackwardPass<'a> {
    pub(super) width: usize,
    pub(super) stride: usize,
    pub(super) span: Span,
    pub(super) costs: &'a [u8],
    /// Partial sums of the other paths; one or two of them.
    pub(super) sums: [Option<&'a [u8]>; 2],
    pub(super) small: u8,
    pub(super) large: &'a [u8],
    pub(super) winners: &'a mut [Winner],
    pub(super) right: &'a mut RightWinners,
}

impl Kernel for BackwardPass<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        super::with_vectors!(V, self.span.lanes / V::COUNT, self.vectors)
    }
}

/// Words before the sums of a pixel, so that the first sum has a left neighbor.
const LEADING: usize = 32;
/// Maximum number of lanes of a pixel.
const MAX_LANES: usize = 512;

impl BackwardPass<'_> {
    #[inline(always)]
    fn vectors<V: Lanes, const N: usize>(self) {
        let (width, stride, start) = (self.width, self.stride, self.span.start);
        assert!(
            self.span.lanes == N * V::COUNT && self.span.end() <= stride && stride <= MAX_LANES
        );
        assert!(self.costs.len() >= width * stride);
        let mut sums = self.sums.iter().flatten();
        assert!(sums.all(|sum| sum.len() >= width * stride));
        assert!(self.winners.len() >= width && self.large.len() >= width);
        let small = V::splat(self.small);
        let none = V::Words::splat(NONE);
        let zero = V::Words::splat(0);
        let half = V::Words::COUNT;
        let right = self.right;
        assert!(right.sums.len() >= width + stride && right.lanes.len() >= width + stride);
        // Minima so far of the right-image columns that the disparities of this pixel map to. They
        // shift by one per column. The finished one is written to memory, together with unfinished
        // ones that later writes replace.
        let mut kept = [[none; 2]; N];
        let mut kept_lanes = [[none; 2]; N];
        right.sums[..start].fill(NONE);
        right.sums[width - 1 + self.span.end()..].fill(NONE);
        let out = INVALID_SUM * (1 + self.sums.iter().flatten().count() as u16);
        let mut path = [V::splat(0); N];
        let mut least = V::splat(0);
        let mut sums = [NONE; MAX_LANES + 2 * LEADING];
        for x in (0..width).rev() {
            // SAFETY: here and below: costs and sums are columns times stride long, and the span is
            // within the stride.
            let (costs, large): ([V; N], u8) = unsafe {
                let from = self.costs.as_ptr().add(x * stride + start);
                (load(from), *self.large.get_unchecked(x))
            };
            step_along(&costs, &mut path, &mut least, small, large);
            let mut total = [[zero; 2]; N];
            let mut best = none;
            for c in 0..N {
                total[c] = path[c].widen();
                for sum in self.sums {
                    let Some(sum) = sum else {
                        continue;
                    };
                    // SAFETY: as above.
                    let more = unsafe {
                        let from = x * stride + start + c * V::COUNT;
                        V::load(sum.as_ptr().add(from)).widen()
                    };
                    total[c] = [total[c][0].add(more[0]), total[c][1].add(more[1])];
                }
                best = best.min(total[c][0]).min(total[c][1]);
                for h in 0..2 {
                    let to = LEADING + (2 * c + h) * half;
                    // SAFETY: there are at most `MAX_LANES` lanes.
                    unsafe { total[c][h].store(sums.as_mut_ptr().add(to)) };
                }
            }
            let best = best.least();
            let all = V::Words::splat(best);
            let mut lane = none;
            for c in 0..N {
                for h in 0..2 {
                    let number = V::Words::counting((start + (2 * c + h) * half) as u16);
                    lane = lane.min(total[c][h].pick_equal(all, number, none));
                }
            }
            let lane = lane.least();
            let above = V::Words::splat(lane + 1);
            let below = V::Words::splat(lane.saturating_sub(1));
            let mut second = none;
            for c in 0..N {
                for h in 0..2 {
                    let at = start + (2 * c + h) * half;
                    let number = V::Words::counting(at as u16);
                    let away = number.sub(above).or(below.sub(number));
                    let masked = total[c][h].or(away.pick_equal(zero, none, zero));
                    second = second.min(masked);
                    let old = kept[c][h];
                    kept[c][h] = old.min(total[c][h]);
                    // Among equals the earlier lane wins.
                    kept_lanes[c][h] = kept[c][h].pick_equal(old, kept_lanes[c][h], number);
                }
            }
            // Mirrored columns of the right image are in the same order as lanes.
            let column = width - 1 - x + start;
            for c in 0..N {
                for h in 0..2 {
                    let at = column + (2 * c + h) * half;
                    if x == 0 || (c, h) == (0, 0) {
                        // SAFETY: indices are below the number of columns plus a stride, as
                        // asserted above.
                        unsafe {
                            kept[c][h].store(right.sums.as_mut_ptr().add(at));
                            kept_lanes[c][h].store(right.lanes.as_mut_ptr().add(at));
                        }
                    }
                }
            }
            for c in 0..N {
                let after = if c + 1 < N {
                    [kept[c + 1][0], kept_lanes[c + 1][0]]
                } else {
                    [none; 2]
                };
                let second = [kept[c][1], kept_lanes[c][1]];
                kept[c] = [kept[c][0].down(second[0]), second[0].down(after[0])];
                kept_lanes[c] = [kept_lanes[c][0].down(second[1]), second[1].down(after[1])];
            }
            let here = LEADING + usize::from(lane) - start;
            self.winners[x] = Winner {
                lane: if best < out { lane } else { NONE },
                least: best,
                second: second.least(),
                beside: [sums[here - 1], sums[here + 1]],
            };
        }
    }
}
