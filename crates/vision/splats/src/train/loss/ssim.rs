//! Structural similarity (Wang, Bovik, Sheikh and Simoncelli, Image Quality Assessment: From Error
//! Visibility to Structural Similarity, 2004) and its gradient.
//!
//! A Gaussian window of 11x11 pixels with a standard deviation of 1.5, zero beyond the image, `C₁ =
//! 0.01²`, `C₂ = 0.03²`, colors from 0 to 1. With means `μ` and second moments `E` under the
//! window, `S = A₁ A₂ / (B₁ B₂)`, `A₁ = 2 μx μy + C₁`, `A₂ = 2 (E xy - μx μy) + C₂`, `B₁ = μx² +
//! μy² + C₁`, `B₂ = E x² - μx² + E y² - μy² + C₂`; the gradient is a window over the derivatives
//! with respect to `μx`, `E x²` and `E xy`.

use rayon::prelude::*;

use crate::lanes::{Kernel, LANES, Lanes, Level};

const RADIUS: usize = 5;
const TAPS: usize = 2 * RADIUS + 1;

/// Rows of a task. A constant, so that sums do not depend on the number of threads.
const BAND: usize = 32;

const C1: f32 = 1e-4;
const C2: f32 = 9e-4;

/// The window along one axis, from its middle outward: `exp(-k² / (2 1.5²))`, normalized.
fn window() -> [f32; RADIUS + 1] {
    let value = |k: usize| libm::exp(-((k * k) as f64) / 4.5);
    let sum = (0..TAPS).map(|k| value(k.abs_diff(RADIUS))).sum::<f64>();
    std::array::from_fn(|k| (value(k) / sum) as f32)
}

/// Adds the gradient of `-weight Σ S` over the usable pixels; returns `Σ S`. Pixels that may not be
/// used get no gradient.
pub(super) fn add(
    rendered: &[Vec<f32>; 3],
    targets: &[Vec<f32>; 3],
    (width, height): (usize, usize),
    mask: Option<&[bool]>,
    weight: f32,
    level: Level,
    gradient: &mut [Vec<f32>; 3],
) -> f64 {
    let window = window();
    let mut sum = 0.0;
    for c in 0..3 {
        let (x, y) = (&rendered[c], &targets[c]);
        let plane = || vec![0.0; width * height];
        let mut by = [plane(), plane(), plane()];
        let band = width * BAND;
        let [mean, square, product] = &mut by;
        let sums: Vec<f64> = mean
            .par_chunks_mut(band)
            .zip(square.par_chunks_mut(band))
            .zip(product.par_chunks_mut(band))
            .enumerate()
            .map(|(band, ((mean, square), product))| {
                level.run(Forward {
                    x,
                    y,
                    width,
                    height,
                    top: band * BAND,
                    mask,
                    weight,
                    window: &window,
                    out: [mean, square, product],
                })
            })
            .collect();
        sum += sums.iter().sum::<f64>();
        let gradient = gradient[c].par_chunks_mut(band).enumerate();
        gradient.for_each(|(band, out)| {
            level.run(Backward {
                x,
                y,
                by: &by,
                width,
                height,
                top: band * BAND,
                mask,
                window: &window,
                out,
            });
        });
    }
    sum
}

/// Row of a plane times another, with zeros around it.
struct Padded {
    values: Vec<f32>,
    width: usize,
}

impl Padded {
    fn new(width: usize) -> Self {
        Self {
            values: vec![0.0; width.next_multiple_of(LANES) + TAPS + LANES],
            width,
        }
    }

    /// Room for the row.
    fn row(&mut self) -> &mut [f32] {
        &mut self.values[RADIUS..RADIUS + self.width]
    }

    /// The row under the window, up to the next multiple of the lanes.
    #[inline(always)]
    fn blur<V: Lanes>(&self, window: &[f32; RADIUS + 1], out: &mut [f32]) {
        let (chunks, _) = out.as_chunks_mut::<LANES>();
        for (k, out) in chunks.iter_mut().enumerate() {
            let from = &self.values[k * LANES..];
            let mut sum = load::<V>(from, RADIUS) * V::splat(window[0]);
            for tap in 1..=RADIUS {
                let both = load::<V>(from, RADIUS - tap) + load::<V>(from, RADIUS + tap);
                sum = both.mul_add(V::splat(window[tap]), sum);
            }
            sum.store(out);
        }
    }
}

/// Eight values from an offset on.
#[inline(always)]
fn load<V: Lanes>(from: &[f32], offset: usize) -> V {
    match from[offset..].first_chunk::<LANES>() {
        Some(values) => V::load(values),
        None => V::splat(0.0),
    }
}

/// Rows blurred along x, of a band and its surroundings.
struct Rows {
    values: Vec<f32>,
    /// Values of a row: the width, up to a multiple of the lanes.
    stride: usize,
    /// First row of the image.
    first: usize,
    /// Row behind the last one.
    end: usize,
}

impl Rows {
    fn new(width: usize, height: usize, top: usize) -> Self {
        let stride = width.next_multiple_of(LANES);
        let first = top.saturating_sub(RADIUS);
        let end = height.min(top + BAND + RADIUS);
        Self {
            values: vec![0.0; stride * (end - first)],
            stride,
            first,
            end,
        }
    }

    fn row(&mut self, row: usize) -> &mut [f32] {
        let at = (row - self.first) * self.stride;
        &mut self.values[at..at + self.stride]
    }

    /// The vertical window over eight columns of a row of the image.
    #[inline(always)]
    fn blur<V: Lanes>(&self, row: usize, column: usize, window: &[f32; RADIUS + 1]) -> V {
        let at = |row: usize| (row - self.first) * self.stride + column;
        let mut sum = load::<V>(&self.values, at(row)) * V::splat(window[0]);
        for tap in 1..=RADIUS {
            let weight = V::splat(window[tap]);
            if row >= self.first + tap {
                sum = load::<V>(&self.values, at(row - tap)).mul_add(weight, sum);
            }
            if row + tap < self.end {
                sum = load::<V>(&self.values, at(row + tap)).mul_add(weight, sum);
            }
        }
        sum
    }
}

/// Similarity of a band, and its derivatives times minus the weight.
struct Forward<'a> {
    x: &'a [f32],
    y: &'a [f32],
    width: usize,
    height: usize,
    /// First row.
    top: usize,
    mask: Option<&'a [bool]>,
    weight: f32,
    window: &'a [f32; RADIUS + 1],
    /// Derivatives with respect to the mean, the square and the product.
    out: [&'a mut [f32]; 3],
}

impl Kernel for Forward<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<V: Lanes>(self) -> f64 {
        let rows = || Rows::new(self.width, self.height, self.top);
        let mut all = [rows(), rows(), rows(), rows(), rows()];
        let mut padded = Padded::new(self.width);
        for row in all[0].first..all[0].end {
            let range = row * self.width..(row + 1) * self.width;
            let (x, y) = (&self.x[range.clone()], &self.y[range]);
            for (quantity, rows) in all.iter_mut().enumerate() {
                let (a, b) = match quantity {
                    0 | 2 => (x, x),
                    1 | 3 => (y, y),
                    _ => (x, y),
                };
                let to = padded.row();
                if quantity < 2 {
                    to.copy_from_slice(a);
                } else {
                    for k in 0..to.len() {
                        to[k] = a[k] * b[k];
                    }
                }
                padded.blur::<V>(self.window, rows.row(row));
            }
        }
        self.similarity::<V>(&all)
    }
}

impl Forward<'_> {
    #[inline(always)]
    fn similarity<V: Lanes>(self, all: &[Rows; 5]) -> f64 {
        let s = V::splat;
        let mut total = 0.0;
        let rows = self.out[0].len() / self.width;
        for row in 0..rows {
            let mut of_row = 0.0;
            for column in (0..self.width).step_by(LANES) {
                let (line, window) = (self.top + row, self.window);
                let mx = all[0].blur::<V>(line, column, window);
                let my = all[1].blur::<V>(line, column, window);
                let exx = all[2].blur::<V>(line, column, window);
                let eyy = all[3].blur::<V>(line, column, window);
                let exy = all[4].blur::<V>(line, column, window);
                let (c1, c2, two) = (s(C1), s(C2), s(2.0));
                let a1 = two * mx * my + c1;
                let a2 = two * (exy - mx * my) + c2;
                let b1 = mx * mx + my * my + c1;
                let b2 = exx - mx * mx + eyy - my * my + c2;
                let (i1, i2) = (s(1.0) / b1, s(1.0) / b2);
                let similarity = a1 * a2 * i1 * i2;
                let by_mean = two * my * (a2 - a1) * i1 * i2 - two * mx * similarity * (i1 - i2);
                let by_square = -similarity * i2;
                let by_product = two * a1 * i1 * i2;
                let mut lanes = [[0.0; LANES]; 4];
                similarity.store(&mut lanes[0]);
                by_mean.store(&mut lanes[1]);
                by_square.store(&mut lanes[2]);
                by_product.store(&mut lanes[3]);
                for lane in 0..LANES.min(self.width - column) {
                    let at = row * self.width + column + lane;
                    let pixel = self.top * self.width + at;
                    if self.mask.is_none_or(|mask| mask[pixel]) {
                        of_row += lanes[0][lane];
                        self.out[0][at] = -self.weight * lanes[1][lane];
                        self.out[1][at] = -self.weight * lanes[2][lane];
                        self.out[2][at] = -self.weight * lanes[3][lane];
                    }
                }
            }
            total += f64::from(of_row);
        }
        total
    }
}

/// Adds the gradient of a band.
struct Backward<'a> {
    x: &'a [f32],
    y: &'a [f32],
    by: &'a [Vec<f32>; 3],
    width: usize,
    height: usize,
    top: usize,
    mask: Option<&'a [bool]>,
    window: &'a [f32; RADIUS + 1],
    out: &'a mut [f32],
}

impl Kernel for Backward<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let rows = || Rows::new(self.width, self.height, self.top);
        let mut all = [rows(), rows(), rows()];
        let mut padded = Padded::new(self.width);
        for row in all[0].first..all[0].end {
            let range = row * self.width..(row + 1) * self.width;
            for (by, rows) in self.by.iter().zip(&mut all) {
                padded.row().copy_from_slice(&by[range.clone()]);
                padded.blur::<V>(self.window, rows.row(row));
            }
        }
        for row in 0..self.out.len() / self.width {
            for column in (0..self.width).step_by(LANES) {
                let mut lanes = [[0.0; LANES]; 3];
                for (rows, lanes) in all.iter().zip(&mut lanes) {
                    rows.blur::<V>(self.top + row, column, self.window)
                        .store(lanes);
                }
                for lane in 0..LANES.min(self.width - column) {
                    let at = row * self.width + column + lane;
                    let pixel = self.top * self.width + at;
                    if self.mask.is_none_or(|mask| mask[pixel]) {
                        let (x, y) = (self.x[pixel], self.y[pixel]);
                        self.out[at] +=
                            lanes[0][lane] + 2.0 * x * lanes[1][lane] + y * lanes[2][lane];
                    }
                }
            }
        }
    }
}
