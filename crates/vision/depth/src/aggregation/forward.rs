//! Costs along paths: one row of those that come from the row before and of the one that comes along the row.
//!
//! Semi-global matching after Hirschmüller, "Stereo processing by semi-global matching and mutual information", TPAMI 2008: a path
//! adds to the cost of a disparity the least of: its own before, a neighbour's before and the small step, any before and the
//! large step; less the least before, which keeps numbers small. Sums saturate at 255: what costs that much does not win.

use super::Span;
use crate::lanes::{Kernel, Lanes};

/// Free bytes before and behind a front, for vectors that reach beyond.
const SLACK: usize = 64;

/// Where three paths that come down are: costs and the least of them for each column, one more at either side. The outer ones are 0:
/// a path begins as if nothing had cost anything.
#[derive(Clone, Debug, Default)]
pub(super) struct Front {
    costs: [Vec<u8>; 3],
    least: [Vec<u8>; 3],
    /// Lanes that have been computed; none are free of cost before the first row.
    known: Option<Span>,
}

impl Front {
    /// Before the first row.
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

    /// Makes lanes that are about to be read cost as much as what is out, where they have not been computed.
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

/// What a step between disparities costs.
#[derive(Clone, Copy, Debug)]
pub(super) struct Steps<'a> {
    /// To a neighbour.
    pub(super) small: u8,
    /// To any other, for each column: from straight above, from the left above, from the right above, and along.
    pub(super) large: [&'a [u8]; 4],
}

/// One row.
pub(super) struct ForwardPass<'a> {
    pub(super) width: usize,
    pub(super) stride: usize,
    pub(super) span: Span,
    pub(super) costs: &'a [u8],
    pub(super) before: &'a mut Front,
    pub(super) after: &'a mut Front,
    /// Whether paths come down aslant as well.
    pub(super) diagonal: bool,
    /// Whether one comes along, in rising columns.
    pub(super) along: bool,
    pub(super) steps: Steps<'a>,
    /// The sum of all.
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
            // Straight, from the left and from the right above. Closures would be compiled without the instructions.
            let columns = [x + 1, x, x + 2];
            for k in 0..paths {
                let from = SLACK + columns[k] * stride + start;
                let to = SLACK + (x + 1) * stride + start;
                // SAFETY: columns are below `width + 2`, and fronts, steps, costs and sums are as long as asserted above;
                // vectors reach at most one byte beyond the lanes of a column, for which there is slack.
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

/// Vectors one behind the other.
///
/// # Safety
/// They can be read.
#[inline(always)]
pub(super) unsafe fn load<V: Lanes, const N: usize>(from: *const u8) -> [V; N] {
    let mut vectors = [V::splat(0); N];
    for (c, vector) in vectors.iter_mut().enumerate() {
        // SAFETY: the caller's promise.
        *vector = unsafe { V::load(from.add(c * V::COUNT)) };
    }
    vectors
}

/// One step of a path whose costs before are in memory; adds what comes out to `total` and gives the least of it.
///
/// # Safety
/// `N` vectors and one byte at either side can be read at `before`, and `N` vectors written at `after`.
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
        // What is beyond the lanes of this column belongs to another.
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

/// One step of a path whose costs stay in registers; `least` is in all lanes.
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
