//! Path costs of one row: the paths from the previous row, and the left-to-right path along the
//! row.
//!
//! Semi-global matching after Hirschmüller, "Stereo processing by semi-global matching and mutual
//! information", TPAMI 2008: the path cost of a disparity is its matching cost plus the minimum of:
//! the previous cost of the same disparity; that of an adjacent disparity plus the small penalty;
//! that of any disparity plus the large penalty. The previous minimum is subtracted, so that costs
//! stay bounded. Sums saturate at 255; a saturated disparity never wins.

use super::Span;
use crate::lanes::{Kernel, Lanes};

/// Padding before and after the costs of a front, bytes, for unaligned vector loads.
const SLACK: usize = 64;

/// State of the three vertical and diagonal paths: costs and their minimum per column, with one
/// extra column at either side. The extra columns are 0: a path starts with zero cost.
#[derive(Clone, Debug, Default)]
pub(super) struct Front {
    costs: [Vec<u8>; 3],
    least: [Vec<u8>; 3],
    /// Computed lanes; absent before the first row, where every lane has cost 0.
    known: Option<Span>,
}

impl Front {
    /// Resets the state to that before the first row.
    pub(super) fn begin(&mut self, width: usize, stride: usize) {
        for costs in &mut self.costs {
            costs.clear();
            costs.resize((width + 2) * stride + 2 * SLACK, 0);
        }
        for least in &mut self.least {
            least.clear();
            least.resize(width + 2, 0);
        }
        self.known = None;
    }

    /// Sets lanes that are about to be read but were not computed to the cost of an invalid
    /// disparity.
    fn widen(&mut self, paths: usize, width: usize, stride: usize, span: Span) {
        let Some(known) = self.known else {
            return;
        };
        let below = span.start..known.start.min(span.end()).max(span.start);
        let above = known.end().max(span.start).min(span.end())..span.end();
        if below.is_empty() && above.is_empty() {
            return;
        }
        for costs in &mut self.costs[..paths] {
            let columns = costs[SLACK + stride..].chunks_exact_mut(stride);
            for column in columns.take(width) {
                column[below.clone()].fill(u8::MAX);
                column[above.clone()].fill(u8::MAX);
            }
        }
    }
}

/// Penalties for disparity changes.
#[derive(Clone, Copy, Debug)]
pub(super) struct Steps<'a> {
    /// For a change of 1.
    pub(super) small: u8,
    /// For larger changes, per column: for the paths from above, above left, above right, and along
    /// the row.
    pub(super) large: [&'a [u8]; 4],
}

/// Left-to-right pass over one row.
pub(super) struct ForwardPass<'a> {
    pub(super) width: usize,
    pub(super) stride: usize,
    pub(super) span: Span,
    pub(super) costs: &'a [u8],
    pub(super) before: &'a mut Front,
    pub(super) after: &'a mut Front,
    /// Whether the diagonal paths are included.
    pub(super) diagonal: bool,
    /// Whether the left-to-right path along the row is included.
    pub(super) along: bool,
    pub(super) steps: Steps<'a>,
    /// Sum of all included paths.
    pub(super) sum: &'a mut [u8],
}

impl Kernel for ForwardPass<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        super::with_vectors!(V, self.span.lanes / V::COUNT, self.vectors)
    }
}

impl ForwardPass<'_> {
    #[inline(always)]
    fn vectors<V: Lanes, const N: usize>(self) {
        let (width, stride, start) = (self.width, self.stride, self.span.start);
        let paths = if self.diagonal { 3 } else { 1 };
        assert!(self.span.lanes == N * V::COUNT && self.span.end() <= stride);
        assert!(self.costs.len() >= width * stride && self.sum.len() >= width * stride);
        let (before, after) = (self.before, self.after);
        before.widen(paths, width, stride, self.span);
        after.known = Some(self.span);
        for k in 0..paths {
            let all = (width + 2) * stride + 2 * SLACK;
            assert!(before.costs[k].len() == all && after.costs[k].len() == all);
            assert!(before.least[k].len() == width + 2 && after.least[k].len() == width + 2);
        }
        assert!(self.steps.large.iter().all(|row| row.len() >= width));
        let small = V::splat(self.steps.small);
        let mut path = [V::splat(0); N];
        let mut least = V::splat(0);
        for x in 0..width {
            // SAFETY: costs are columns times stride long, and the span is within the stride.
            let costs: [V; N] = unsafe { load(self.costs.as_ptr().add(x * stride + start)) };
            let mut total = [V::splat(0); N];
            // Paths from above, above left and above right. Closures would be compiled without the
            // vector instructions.
            let columns = [x + 1, x, x + 2];
            for k in 0..paths {
                let from = SLACK + columns[k] * stride + start;
                let to = SLACK + (x + 1) * stride + start;
                // SAFETY: columns are below `width + 2`, and fronts, steps, costs and sums are as
                // long as asserted above; vectors reach at most one byte beyond the lanes of a
                // column, for which there is slack.
                unsafe {
                    let new = step(
                        before.costs[k].as_ptr().add(from),
                        *before.least[k].get_unchecked(columns[k]),
                        small,
                        *self.steps.large[k].get_unchecked(x),
                        &costs,
                        after.costs[k].as_mut_ptr().add(to),
                        &mut total,
                    );
                    *after.least[k].get_unchecked_mut(x + 1) = new;
                }
            }
            if self.along {
                // SAFETY: as above.
                let large = unsafe { *self.steps.large[3].get_unchecked(x) };
                step_along(&costs, &mut path, &mut least, small, large);
                for c in 0..N {
                    total[c] = total[c].add(path[c]);
                }
            }
            for (c, total) in total.into_iter().enumerate() {
                let to = x * stride + start + c * V::COUNT;
                // SAFETY: as above.
                unsafe { total.store(self.sum.as_mut_ptr().add(to)) };
            }
        }
    }
}

/// Loads `N` consecutive vectors.
///
/// # Safety
/// `N` vectors can be read at `from`.
#[inline(always)]
pub(super) unsafe fn load<V: Lanes, const N: usize>(from: *const u8) -> [V; N] {
    let mut vectors = [V::splat(0); N];
    for (c, vector) in vectors.iter_mut().enumerate() {
        // SAFETY: the caller's promise.
        *vector = unsafe { V::load(from.add(c * V::COUNT)) };
    }
    vectors
}

/// One step of a path whose previous costs are in memory. Adds the new costs to `total` and returns
/// their minimum.
///
/// # Safety
/// `N` vectors and one byte at either side can be read at `before`, and `N` vectors written at
/// `after`.
#[inline(always)]
unsafe fn step<V: Lanes, const N: usize>(
    before: *const u8,
    least: u8,
    small: V,
    large: u8,
    costs: &[V; N],
    after: *mut u8,
    total: &mut [V; N],
) -> u8 {
    let least = V::splat(least);
    let far = least.add(V::splat(large));
    let mut new = V::splat(u8::MAX);
    for c in 0..N {
        // SAFETY: the caller's promise.
        let [same, mut lower, mut upper] = unsafe {
            let at = before.add(c * V::COUNT);
            [V::load(at), V::load(at.sub(1)), V::load(at.add(1))]
        };
        // Bytes beyond the lanes of this column belong to another column.
        if c == 0 {
            lower = lower.or(V::first());
        }
        if c == N - 1 {
            upper = upper.or(V::last());
        }
        let best = same.min(far).min(lower.min(upper).add(small));
        let cost = best.sub(least).add(costs[c]);
        // SAFETY: the caller's promise.
        unsafe { cost.store(after.add(c * V::COUNT)) };
        new = new.min(cost);
        total[c] = total[c].add(cost);
    }
    new.least().any()
}

/// One step of a path whose costs remain in registers; `least` is broadcast to all lanes.
#[inline(always)]
pub(super) fn step_along<V: Lanes, const N: usize>(
    costs: &[V; N],
    path: &mut [V; N],
    least: &mut V,
    small: V,
    large: u8,
) {
    let far = least.add(V::splat(large));
    let full = V::splat(u8::MAX);
    let before = *path;
    let mut new = full;
    for c in 0..N {
        let lower = before[c].up(if c == 0 { full } else { before[c - 1] });
        let upper = before[c].down(if c == N - 1 { full } else { before[c + 1] });
        let best = before[c].min(far).min(lower.min(upper).add(small));
        path[c] = best.sub(*least).add(costs[c]);
        new = new.min(path[c]);
    }
    *least = new.least();
}
