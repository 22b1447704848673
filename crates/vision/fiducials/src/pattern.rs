//! The printed pattern under blur, and its derivatives.
//!
//! Contract: the pattern is 1 where the tag is white and 0 where it is black, in coordinates of
//! cells about the middle of the tag, x to the right, y down. Blur is a Gaussian along each axis.
//! Beyond the margin the pattern goes on white.

use std::sync::LazyLock;

use crate::tag::Tag;

/// Cells beyond which a Gaussian is over, in its sigmas.
const REACH: f64 = 3.5;

/// Value of a blurred pattern, and its derivatives.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct PatternSample {
    /// From 0, black, to 1, white.
    pub(crate) value: f64,
    /// Gradient, per cell.
    pub(crate) gradient: [f64; 2],
    /// Derivative by the logarithm of the blur.
    pub(crate) by_log_blur: f64,
}

/// The standard normal distribution in a table.
struct Normal {
    /// Integral of the density from the left, and the density, at steps from `-REACH` on.
    entries: Vec<[f64; 2]>,
}

/// Entries per sigma.
const ENTRIES: f64 = 32.0;

impl Normal {
    fn new() -> Self {
        const INVERSE_ROOT: f64 = 0.398_942_280_401_432_7;
        let entry = |k: u32| {
            let x = f64::from(k) / ENTRIES - REACH;
            let integral = 0.5 * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2);
            [integral, INVERSE_ROOT * libm::exp(-0.5 * x * x)]
        };
        let count = (2.0 * REACH * ENTRIES) as u32 + 2;
        Self {
            entries: (0..count).map(entry).collect(),
        }
    }

    /// Integral and density, by cubic interpolation: the derivatives are known.
    fn at(&self, x: f64) -> (f64, f64) {
        if x >= REACH {
            return (1.0, 0.0);
        }
        if x <= -REACH {
            return (0.0, 0.0);
        }
        let place = (x + REACH) * ENTRIES;
        let k = place as usize;
        let t = place - k as f64;
        let step = 1.0 / ENTRIES;
        let [[i0, d0], [i1, d1]] = [self.entries[k], self.entries[k + 1]];
        let x0 = k as f64 * step - REACH;
        let hermite = |a: f64, b: f64, slope_a: f64, slope_b: f64| {
            let (c, d) = (slope_a * step - (b - a), (b - a) - slope_b * step);
            a + (b - a) * t + t * (1.0 - t) * (c * (1.0 - t) + d * t)
        };
        let integral = hermite(i0, i1, d0, d1);
        let density = hermite(d0, d1, -x0 * d0, -(x0 + step) * d1);
        (integral, density)
    }
}

static NORMAL: LazyLock<Normal> = LazyLock::new(Normal::new);

/// Cells on either side of the one at a place that a blur reaches.
const MAX_SIDE: usize = 4;
/// Cells that contribute at a place.
const MAX_NEAR: usize = 2 * MAX_SIDE + 1;

/// Share, or derivative of one, that is none.
const NO_SHARE: f64 = 1e-6;

/// Shares of cells in the pattern at a place along one axis, and their derivatives by the place, in
/// cells, and by the logarithm of the blur.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Shares {
    /// Cells on either side that contribute.
    side: usize,
    by_cell: [[f64; MAX_NEAR]; 3],
}

impl Shares {
    /// At a place from the begin, 0, to the end, 1, of a cell, for a sigma of the blur, cells. Blur
    /// beyond some cells is taken as that.
    pub(crate) fn new(place: f64, blur: f64) -> Self {
        let normal = &*NORMAL;
        let blur = blur.clamp(0.02, MAX_SIDE as f64 / REACH);
        let side = (REACH * blur).ceil().max(1.0) as usize;
        // At the borders between cells, from left to right.
        let border = |n: usize| {
            let x = (place - (n as f64 - side as f64)) / blur;
            let (integral, density) = normal.at(x);
            [integral, density / blur, -density * x]
        };
        let mut by_cell = [[0.0; MAX_NEAR]; 3];
        // The outermost cells have all that is beyond them.
        let mut left = [1.0, 0.0, 0.0];
        for n in 0..=2 * side {
            let right = if n < 2 * side {
                border(n + 1)
            } else {
                [0.0; 3]
            };
            for (shares, (left, right)) in by_cell.iter_mut().zip(left.iter().zip(right)) {
                shares[n] = left - right;
            }
            left = right;
        }
        Self { side, by_cell }
    }

    /// The cells that contribute at a place in a cell, those outside of the tag as its outermost
    /// ones, with their shares and the derivatives of these.
    pub(crate) fn cells(&self, cell: isize, tag: &Tag) -> impl Iterator<Item = (usize, [f64; 3])> {
        let last = tag.cells() as isize - 1;
        let cells = (0..=2 * self.side).map(move |n| {
            let index = cell - self.side as isize + n as isize;
            let shares = [0, 1, 2].map(|kind| self.by_cell[kind][n]);
            (index.clamp(0, last) as usize, shares)
        });
        cells.filter(|(_, shares)| shares.iter().any(|share| share.abs() > NO_SHARE))
    }
}

/// The pattern at a place in cells, blurred along both axes: the exact one, which
/// [`Template`](crate::template::Template) tabulates.
#[cfg(test)]
pub(crate) fn sample(tag: &Tag, place: [f64; 2], blur: [f64; 2]) -> PatternSample {
    let [x, y] = place.map(|v| v + tag.half_cells());
    let [across, down] = [(x, blur[0]), (y, blur[1])]
        .map(|(v, blur)| (v.floor() as isize, Shares::new(v - v.floor(), blur)));
    let mut sum = PatternSample::default();
    for (row, [value, place, blur]) in down.1.cells(down.0, tag) {
        let mut along = [0.0; 3];
        for (column, shares) in across.1.cells(across.0, tag) {
            for (sum, share) in along.iter_mut().zip(shares) {
                *sum += f64::from(u8::from(tag.is_white(row, column))) * share;
            }
        }
        sum.value += value * along[0];
        sum.gradient[0] += value * along[1];
        sum.gradient[1] += place * along[0];
        sum.by_log_blur += value * along[2] + blur * along[0];
    }
    sum
}

#[cfg(test)]
mod tests {
    use boards::Dictionary;

    use super::*;

    fn tag() -> Tag {
        Tag::new(Dictionary::AprilTag36h11, 3, 0.08).expect("a tag")
    }

    #[test]
    fn table_agrees_with_the_distribution() {
        for k in -3400..3400 {
            let x = f64::from(k) * 1e-3;
            let (integral, density) = NORMAL.at(x);
            let exact = 0.5 * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2);
            assert!((integral - exact).abs() < 1e-8, "{x}");
            let exact = libm::exp(-0.5 * x * x) / (2.0 * std::f64::consts::PI).sqrt();
            assert!((density - exact).abs() < 1e-7, "{x}");
        }
    }

    #[test]
    fn sharp_pattern_is_black_and_white() {
        let tag = tag();
        for row in 0..10 {
            for column in 0..10 {
                let place = [column, row].map(|i| i as f64 - 4.5);
                let value = sample(&tag, place, [0.05; 2]).value;
                let expected = f64::from(u8::from(tag.is_white(row, column)));
                assert!((value - expected).abs() < 1e-9, "{row} {column}");
            }
        }
        assert!(sample(&tag, [-8.0, 0.3], [0.3; 2]).value > 0.999);
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let tag = tag();
        let step = 1e-5;
        for k in 0..200 {
            let draw = |n: u32| f64::from((k * 7919 + n * 104_729) % 1000) / 1000.0;
            let place = [9.0 * draw(1) - 4.5, 9.0 * draw(2) - 4.5];
            let blur = [0.25 + 0.8 * draw(3), 0.25 + 0.8 * draw(4)];
            let exact = sample(&tag, place, blur);
            let slope = |moved: &dyn Fn(f64) -> f64| (moved(step) - moved(-step)) / (2.0 * step);
            for axis in 0..2 {
                let found = slope(&|by| {
                    let mut place = place;
                    place[axis] += by;
                    sample(&tag, place, blur).value
                });
                assert!((found - exact.gradient[axis]).abs() < 1e-3, "{k} {axis}");
            }
            let found = slope(&|by| sample(&tag, place, blur.map(|v| v * libm::exp(by))).value);
            assert!((found - exact.by_log_blur).abs() < 1e-3, "{k}: {found}");
        }
    }
}
