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
    /// Derivatives by the logarithm of the blur along each axis.
    pub(crate) by_log_blur: [f64; 2],
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
const MAX_NEAR: usize = 2 * MAX_SIDE + 1;
/// Entries of a profile per cell.
const STEPS: usize = 32;

/// Shares of cells in the pattern at a place, and their derivatives by the place and by the
/// logarithm of the blur.
type Shares = [[f64; MAX_NEAR]; 3];

/// How cells contribute to a pattern with a blur, along one axis.
#[derive(Clone, Debug)]
pub(crate) struct Profile {
    /// Cells on either side that contribute.
    side: usize,
    /// At steps from the begin to the end of a cell.
    entries: Vec<Shares>,
}

impl Profile {
    /// For a sigma of the blur, cells. Blur beyond some cells is taken as that.
    pub(crate) fn new(blur: f64) -> Self {
        let normal = &*NORMAL;
        let blur = blur.clamp(0.02, MAX_SIDE as f64 / REACH);
        let side = (REACH * blur).ceil().max(1.0) as usize;
        let entry = |k: usize| {
            let place = k as f64 / STEPS as f64;
            // At the borders between cells, from left to right.
            let border = |n: usize| {
                let x = (place - (n as f64 - side as f64)) / blur;
                let (integral, density) = normal.at(x);
                [integral, density / blur, -density * x]
            };
            let mut shares = [[0.0; MAX_NEAR]; 3];
            // The outermost cells have all that is beyond them.
            let mut left = [1.0, 0.0, 0.0];
            for n in 0..=2 * side {
                let right = if n < 2 * side {
                    border(n + 1)
                } else {
                    [0.0; 3]
                };
                for (shares, (left, right)) in shares.iter_mut().zip(left.iter().zip(right)) {
                    shares[n] = left - right;
                }
                left = right;
            }
            shares
        };
        Self {
            side,
            entries: (0..=STEPS).map(entry).collect(),
        }
    }

    /// Index of the first contributing cell, which may be outside the tag, and the shares.
    fn at(&self, from_begin: f64) -> (isize, Shares) {
        let cell = from_begin.floor();
        let place = (from_begin - cell) * STEPS as f64;
        let k = (place as usize).min(STEPS - 1);
        let t = place - k as f64;
        let (a, b) = (&self.entries[k], &self.entries[k + 1]);
        let mut shares = [[0.0; MAX_NEAR]; 3];
        for (shares, (a, b)) in shares.iter_mut().zip(a.iter().zip(b)) {
            for (share, (a, b)) in shares
                .iter_mut()
                .zip(a.iter().zip(b))
                .take(2 * self.side + 1)
            {
                *share = a + (b - a) * t;
            }
        }
        (cell as isize - self.side as isize, shares)
    }
}

/// The pattern at a place in cells, blurred by profiles along both axes.
pub(crate) fn sample(tag: &Tag, [x, y]: [f64; 2], [across, down]: [&Profile; 2]) -> PatternSample {
    let (first_column, columns) = across.at(x + tag.half_cells());
    let (first_row, rows) = down.at(y + tag.half_cells());
    let last = tag.cells() as isize - 1;
    let inside = |first: isize, n: usize| (first + n as isize).clamp(0, last) as usize;
    let mut sum = PatternSample::default();
    let [by_value, by_place, by_blur] = &rows;
    let rows = by_value.iter().zip(by_place).zip(by_blur);
    for (j, ((value, place), blur)) in rows.enumerate().take(2 * down.side + 1) {
        let whites = tag.whites(inside(first_row, j));
        let mut row = [0.0; 3];
        for (sum, shares) in row.iter_mut().zip(&columns) {
            for (i, share) in shares.iter().enumerate().take(2 * across.side + 1) {
                *sum += whites[inside(first_column, i)] * share;
            }
        }
        sum.value += value * row[0];
        sum.gradient[0] += value * row[1];
        sum.gradient[1] += place * row[0];
        sum.by_log_blur[0] += value * row[2];
        sum.by_log_blur[1] += blur * row[0];
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
        let sharp = Profile::new(0.05);
        for row in 0..10 {
            for column in 0..10 {
                let place = [column, row].map(|i| i as f64 - 4.5);
                let value = sample(&tag, place, [&sharp; 2]).value;
                let expected = f64::from(u8::from(tag.is_white(row, column)));
                assert!((value - expected).abs() < 1e-9, "{row} {column}");
            }
        }
        assert!(sample(&tag, [-8.0, 0.3], [&Profile::new(0.3); 2]).value > 0.999);
    }

    #[test]
    fn derivatives_agree_with_differences() {
        let tag = tag();
        // Shares are interpolated linearly within steps.
        let step = 1.0 / STEPS as f64;
        for k in 0..200 {
            let draw = |n: u32| f64::from((k * 7919 + n * 104_729) % 1000) / 1000.0;
            let place = [9.0 * draw(1) - 4.5, 9.0 * draw(2) - 4.5];
            let blur = [0.25 + 0.8 * draw(3), 0.25 + 0.8 * draw(4)];
            let blurred = |place: [f64; 2], blur: [f64; 2]| {
                let [x, y] = blur.map(Profile::new);
                sample(&tag, place, [&x, &y])
            };
            let exact = blurred(place, blur);
            for axis in 0..2 {
                let moved = |by: f64| {
                    let mut place = place;
                    place[axis] += by;
                    blurred(place, blur).value
                };
                let wider = |by: f64| {
                    let mut blur = blur;
                    blur[axis] *= libm::exp(by);
                    blurred(place, blur).value
                };
                let slope = (moved(step) - moved(-step)) / (2.0 * step);
                assert!(
                    (slope - exact.gradient[axis]).abs() < 0.01,
                    "{k} {axis}: {slope}"
                );
                let growth = (wider(step) - wider(-step)) / (2.0 * step);
                assert!(
                    (growth - exact.by_log_blur[axis]).abs() < 0.01,
                    "{k} {axis}: {growth} {}",
                    exact.by_log_blur[axis]
                );
            }
        }
    }
}
