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

/// A row with zeros around it.
struct PaddedRow {
    values: Vec<f32>,
    width: usize,
}

impl PaddedRow {
    /// Values that the window of eight pixels needs.
    const REACH: usize = LANES + 2 * RADIUS;

    fn new(width: usize) -> Self {
        Self {
            values: vec![0.0; width.next_multiple_of(LANES) + 2 * RADIUS],
            width,
        }
    }

    /// Room for the row.
    fn row(&mut self) -> &mut [f32] {
        &mut self.values[RADIUS..RADIUS + self.width]
    }

    /// The row under the window, up to the next multiple of the lanes.
    #[inline(always)]
    fn blur<V: Lanes>(&self, window: &[f32; RADIUS + 1], out: &mut [[f32; LANES]]) {
        for (k, out) in out.iter_mut().enumerate() {
            let Some(from) = self.values[k * LANES..].first_chunk::<{ Self::REACH }>() else {
                return;
            };
            let mut sum = at::<V>(from, RADIUS) * V::splat(window[0]);
            for tap in 1..=RADIUS {
                let both = at::<V>(from, RADIUS - tap) + at::<V>(from, RADIUS + tap);
                sum = both.mul_add(V::splat(window[tap]), sum);
            }
            sum.store(out);
        }
    }
}

/// Eight values from an offset on, at most twice the radius.
#[inline(always)]
fn at<V: Lanes>(from: &[f32; PaddedRow::REACH], offset: usize) -> V {
    match from[offset..].first_chunk::<LANES>() {
        Some(values) => V::load(values),
        None => V::splat(0.0),
    }
}

/// Rows blurred along x: those of a band and five above and below, zeros beyond the image.
struct Rows {
    values: Vec<[f32; LANES]>,
    /// Vectors of a row.
    stride: usize,
}

impl Rows {
    fn new(width: usize) -> Self {
        let stride = width.div_ceil(LANES);
        Self {
            values: vec![[0.0; LANES]; stride * (BAND + 2 * RADIUS)],
            stride,
        }
    }

    /// Rows of the image that exist around a band, with their positions here.
    fn around(top: usize, height: usize) -> impl Iterator<Item = (usize, usize)> {
        let first = top.saturating_sub(RADIUS);
        let end = height.min(top + BAND + RADIUS);
        (first..end).map(move |row| (row, row + RADIUS - top))
    }

    fn row(&mut self, position: usize) -> &mut [[f32; LANES]] {
        &mut self.values[position * self.stride..(position + 1) * self.stride]
    }

    /// The vertical window over eight columns of a row of the band.
    #[inline(always)]
    fn blur<V: Lanes>(&self, row: usize, vector: usize, window: &[f32; RADIUS + 1]) -> V {
        let middle = (row + RADIUS) * self.stride + vector;
        let mut sum = V::load(&self.values[middle]) * V::splat(window[0]);
        for tap in 1..=RADIUS {
            let above = V::load(&self.values[middle - tap * self.stride]);
            let below = V::load(&self.values[middle + tap * self.stride]);
            sum = (above + below).mul_add(V::splat(window[tap]), sum);
        }
        sum
    }
}

/// Products of two rows.
#[inline(always)]
fn product(to: &mut [f32], a: &[f32], b: &[f32]) {
    for ((to, a), b) in to.iter_mut().zip(a).zip(b) {
        *to = a * b;
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
        let rows = || Rows::new(self.width);
        let mut all = [rows(), rows(), rows(), rows(), rows()];
        let mut padded = PaddedRow::new(self.width);
        for (row, position) in Rows::around(self.top, self.height) {
            let range = row * self.width..(row + 1) * self.width;
            let (x, y) = (&self.x[range.clone()], &self.y[range]);
            for (quantity, rows) in all.iter_mut().enumerate() {
                let to = padded.row();
                match quantity {
                    0 => to.copy_from_slice(x),
                    1 => to.copy_from_slice(y),
                    2 => product(to, x, x),
                    3 => product(to, y, y),
                    _ => product(to, x, y),
                }
                padded.blur::<V>(self.window, rows.row(position));
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
                let (vector, window) = (column / LANES, self.window);
                let mx = all[0].blur::<V>(row, vector, window);
                let my = all[1].blur::<V>(row, vector, window);
                let exx = all[2].blur::<V>(row, vector, window);
                let eyy = all[3].blur::<V>(row, vector, window);
                let exy = all[4].blur::<V>(row, vector, window);
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
        let rows = || Rows::new(self.width);
        let mut all = [rows(), rows(), rows()];
        let mut padded = PaddedRow::new(self.width);
        for (row, position) in Rows::around(self.top, self.height) {
            let range = row * self.width..(row + 1) * self.width;
            for (by, rows) in self.by.iter().zip(&mut all) {
                padded.row().copy_from_slice(&by[range.clone()]);
                padded.blur::<V>(self.window, rows.row(position));
            }
        }
        for row in 0..self.out.len() / self.width {
            for column in (0..self.width).step_by(LANES) {
                let mut lanes = [[0.0; LANES]; 3];
                for (rows, lanes) in all.iter().zip(&mut lanes) {
                    rows.blur::<V>(row, column / LANES, self.window)
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
