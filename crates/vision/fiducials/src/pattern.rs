//! The printed pattern under blur, and its derivatives.
//!
//! Contract: the pattern is 1 where the tag is white and 0 where it is black, in coordinates of
//! cells about the middle of the tag, x to the right, y down. Blur is a Gaussian along each axis.
//! Beyond the margin the pattern goes on white.

use std::sync::LazyLock;

use crate::tag::{MAX_CELLS, Tag};

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

/// Weights of the cells along one axis at a place, and the derivatives of these weights.
struct Axis {
    first: usize,
    count: usize,
    weight: [f64; MAX_CELLS],
    by_place: [f64; MAX_CELLS],
    by_log_blur: [f64; MAX_CELLS],
}

impl Axis {
    fn new(normal: &Normal, tag: &Tag, place: f64, blur: f64) -> Self {
        let cells = tag.cells();
        let from_begin = place + tag.half_cells();
        let within = |v: f64| v.floor().clamp(0.0, (cells - 1) as f64) as usize;
        let first = within(from_begin - REACH * blur);
        let last = within(from_begin + REACH * blur);
        let mut axis = Self {
            first,
            count: last + 1 - first,
            weight: [0.0; MAX_CELLS],
            by_place: [0.0; MAX_CELLS],
            by_log_blur: [0.0; MAX_CELLS],
        };
        // The outermost cells go on without end.
        let mut left = (1.0, 0.0, 0.0);
        for k in 0..axis.count {
            let right = match first + k + 1 {
                end if k + 1 < axis.count => {
                    let x = (from_begin - end as f64) / blur;
                    let (integral, density) = normal.at(x);
                    (integral, density / blur, density * x)
                }
                _ => (0.0, 0.0, 0.0),
            };
            axis.weight[k] = left.0 - right.0;
            axis.by_place[k] = left.1 - right.1;
            axis.by_log_blur[k] = right.2 - left.2;
            left = right;
        }
        axis
    }
}

/// The pattern at a place, blurred by these sigmas along both axes, all in cells.
pub(crate) fn sample(tag: &Tag, [x, y]: [f64; 2], [blur_x, blur_y]: [f64; 2]) -> PatternSample {
    let normal = &*NORMAL;
    let across = Axis::new(normal, tag, x, blur_x);
    let down = Axis::new(normal, tag, y, blur_y);
    let mut sum = PatternSample::default();
    for j in 0..down.count {
        let (mut weight, mut by_place, mut by_log_blur) = (0.0, 0.0, 0.0);
        for i in 0..across.count {
            if tag.is_white(down.first + j, across.first + i) {
                weight += across.weight[i];
                by_place += across.by_place[i];
                by_log_blur += across.by_log_blur[i];
            }
        }
        sum.value += down.weight[j] * weight;
        sum.gradient[0] += down.weight[j] * by_place;
        sum.gradient[1] += down.by_place[j] * weight;
        sum.by_log_blur[0] += down.weight[j] * by_log_blur;
        sum.by_log_blur[1] += down.by_log_blur[j] * weight;
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
            let blur = [0.2 + draw(3), 0.2 + draw(4)];
            let exact = sample(&tag, place, blur);
            for axis in 0..2 {
                let moved = |by: f64| {
                    let mut place = place;
                    place[axis] += by;
                    sample(&tag, place, blur).value
                };
                let wider = |by: f64| {
                    let mut blur = blur;
                    blur[axis] *= libm::exp(by);
                    sample(&tag, place, blur).value
                };
                let slope = (moved(step) - moved(-step)) / (2.0 * step);
                assert!((slope - exact.gradient[axis]).abs() < 2e-3, "{k} {axis}");
                let growth = (wider(step) - wider(-step)) / (2.0 * step);
                assert!(
                    (growth - exact.by_log_blur[axis]).abs() < 2e-3,
                    "{k} {axis}: {growth} {}",
                    exact.by_log_blur[axis]
                );
            }
        }
    }
}
