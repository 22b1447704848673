//! Planes through the disparities around a pixel, which average the errors of single pixels.
//!
//! Contract: a plane is fitted to the disparities of a square window by weighted least squares, and
//! the pixel gets the value of its plane. Weights are the inverse variances, lower for other gray
//! levels; disparities that differ by more than a step belong to another surface and do not count.
//! Absent disparities stay absent.

use rayon::prelude::*;

use crate::lanes::{Kernel, Lanes, Level};
use crate::map::DisparityMap;
use imaging::ImageView;

/// Difference of gray levels at which the weight is halved.
const GRAY_SCALE: f32 = 12.0;
/// Minimum sigma in weights, px: a few disparities with a small one must not decide alone.
const MIN_SIGMA_PX: f32 = 0.1;
/// Ridge on the slopes, relative to the sum of weights: a window with pixels in one row only has no
/// slope along columns.
const SLOPE_RIDGE: f32 = 0.3;
/// Number of pixels that are processed together.
const CHUNK: usize = 64;

/// Configuration of the fit.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Planes {
    /// Half the side of the window without its center, px.
    pub(crate) radius_px: usize,
    /// Maximum difference from the disparity of the center, px.
    pub(crate) max_step_px: f32,
}

/// Disparities, weights and gray levels with a border.
#[derive(Debug, Default)]
pub(crate) struct PlaneBuffers {
    disparity: Vec<f32>,
    weight: Vec<f32>,
    gray: Vec<f32>,
}

impl Planes {
    /// Replaces the disparities of a map by those of their planes. Sigmas are unchanged.
    pub(crate) fn fit(
        &self,
        level: Level,
        left: &ImageView<'_>,
        map: &mut DisparityMap,
        buffers: &mut PlaneBuffers,
    ) {
        let (width, height) = (map.width, map.height);
        let border = self.radius_px;
        let stride = width.next_multiple_of(CHUNK) + 2 * border;
        for buffer in [
            &mut buffers.disparity,
            &mut buffers.weight,
            &mut buffers.gray,
        ] {
            buffer.clear();
            buffer.resize(stride * (height + 2 * border), 0.0);
        }
        let inner = border * stride..(border + height) * stride;
        let disparities = buffers.disparity[inner.clone()].par_chunks_exact_mut(stride);
        let weights = buffers.weight[inner.clone()].par_chunks_exact_mut(stride);
        let grays = buffers.gray[inner].par_chunks_exact_mut(stride);
        let known = map.disparity.par_chunks_exact(width);
        let known = known.zip(map.sigma.par_chunks_exact(width)).enumerate();
        let to = disparities.zip(weights).zip(grays);
        known
            .zip(to)
            .for_each(|((y, of), ((disparities, weights), grays))| {
                for (x, (disparity, sigma)) in of.0.iter().zip(of.1).enumerate() {
                    grays[border + x] = f32::from(left.row(y)[x]);
                    if !disparity.is_nan() {
                        let sigma = sigma.max(MIN_SIGMA_PX);
                        disparities[border + x] = *disparity;
                        weights[border + x] = 1.0 / (sigma * sigma);
                    }
                }
            });
        let rows = map.disparity.par_chunks_exact_mut(width).enumerate();
        rows.for_each(|(y, to)| {
            level.run(Row {
                planes: *self,
                stride,
                y,
                buffers,
                to,
            });
        });
    }
}

/// Sums over a window: weights, their moments, and those of disparity differences.
#[derive(Clone, Copy)]
struct Sums([[f32; CHUNK]; 9]);

struct Row<'a> {
    planes: Planes,
    stride: usize,
    y: usize,
    buffers: &'a PlaneBuffers,
    to: &'a mut [f32],
}

impl Kernel for Row<'_> {
    type Output = ();

    #[inline(always)]
    fn run<V: Lanes>(self) {
        let border = self.planes.radius_px;
        for from in (0..self.to.len()).step_by(CHUNK) {
            let at = |dx: usize, dy: usize| (self.y + dy) * self.stride + from + dx;
            let center = at(border, border);
            let own = &self.buffers.disparity[center..][..CHUNK];
            let own_gray = &self.buffers.gray[center..][..CHUNK];
            let mut sums = Sums([[0.0; CHUNK]; 9]);
            for dy in 0..=2 * border {
                for dx in 0..=2 * border {
                    let near = at(dx, dy);
                    let place = [dx as f32 - border as f32, dy as f32 - border as f32];
                    sums.add(
                        place,
                        self.planes.max_step_px,
                        [own, &self.buffers.disparity[near..][..CHUNK]],
                        [own_gray, &self.buffers.gray[near..][..CHUNK]],
                        &self.buffers.weight[near..][..CHUNK],
                    );
                }
            }
            let to = &mut self.to[from..];
            for (k, to) in to.iter_mut().take(CHUNK).enumerate() {
                if !to.is_nan() {
                    *to += sums.offset(k);
                }
            }
        }
    }
}

impl Sums {
    #[inline(always)]
    fn add(
        &mut self,
        [x, y]: [f32; 2],
        max_step_px: f32,
        [own, near]: [&[f32]; 2],
        [own_gray, near_gray]: [&[f32]; 2],
        weight: &[f32],
    ) {
        const INVERSE: f32 = 1.0 / (GRAY_SCALE * GRAY_SCALE);
        let [w, wx, wy, wxx, wxy, wyy, v, vx, vy] = &mut self.0;
        for k in 0..CHUNK {
            let step = near[k] - own[k];
            let gray = near_gray[k] - own_gray[k];
            let is_near = f32::from(u8::from(step.abs() <= max_step_px));
            let weight = is_near * weight[k] / (1.0 + gray * gray * INVERSE);
            let value = weight * step;
            w[k] += weight;
            wx[k] += weight * x;
            wy[k] += weight * y;
            wxx[k] += weight * x * x;
            wxy[k] += weight * x * y;
            wyy[k] += weight * y * y;
            v[k] += value;
            vx[k] += value * x;
            vy[k] += value * y;
        }
    }

    /// Value of the plane at the center of the window of a pixel, relative to its disparity, px.
    #[inline(always)]
    fn offset(&self, k: usize) -> f32 {
        let [w, wx, wy, wxx, wxy, wyy, v, vx, vy] = self.0.each_ref().map(|sums| sums[k]);
        let [wxx, wyy] = [wxx, wyy].map(|square| square + SLOPE_RIDGE * w);
        // Cramer's rule for the constant term.
        let slopes = wxx * wyy - wxy * wxy;
        let determinant = w * slopes - wx * (wx * wyy - wxy * wy) + wy * (wx * wxy - wxx * wy);
        let constant = v * slopes - wx * (vx * wyy - wxy * vy) + wy * (vx * wxy - wxx * vy);
        constant / determinant
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reference::{self, Random};

    const PLANES: Planes = Planes {
        radius_px: 3,
        max_step_px: 1.5,
    };

    /// The same, in double precision and one pixel at a time.
    fn reference(image: &ImageView<'_>, map: &DisparityMap, x: usize, y: usize) -> f64 {
        let own = map.disparity[y * map.width + x];
        // Normal equations with the right side in the last column.
        let mut system = [[0.0_f64; 4]; 3];
        let reach = PLANES.radius_px as i64;
        for (dy, dx) in (-reach..=reach).flat_map(|dy| (-reach..=reach).map(move |dx| (dy, dx))) {
            let (near_x, near_y) = (x as i64 + dx, y as i64 + dy);
            if !(0..map.width as i64).contains(&near_x) || !(0..map.height as i64).contains(&near_y)
            {
                continue;
            }
            let (near_x, near_y) = (near_x as usize, near_y as usize);
            let near = map.disparity[near_y * map.width + near_x];
            if near.is_nan() || (near - own).abs() > PLANES.max_step_px {
                continue;
            }
            let gray = f64::from(image.row(near_y)[near_x]) - f64::from(image.row(y)[x]);
            let sigma = f64::from(map.sigma[near_y * map.width + near_x].max(MIN_SIGMA_PX));
            let weight = 1.0 / (sigma * sigma * (1.0 + (gray / f64::from(GRAY_SCALE)).powi(2)));
            let terms = [1.0, dx as f64, dy as f64, f64::from(near - own)];
            for (row, i) in system.iter_mut().zip(0..3) {
                for (value, term) in row.iter_mut().zip(terms) {
                    *value += weight * terms[i] * term;
                }
            }
        }
        system[1][1] += f64::from(SLOPE_RIDGE) * system[0][0];
        system[2][2] += f64::from(SLOPE_RIDGE) * system[0][0];
        // The last unknown is eliminated first.
        for k in [2, 1] {
            let pivot = system[k];
            for row in &mut system[..k] {
                let factor = row[k] / pivot[k];
                for (value, below) in row.iter_mut().zip(pivot) {
                    *value -= factor * below;
                }
            }
        }
        f64::from(own) + system[0][3] / system[0][0]
    }

    /// Noisy disparities of two planes beside each other, some of them absent.
    fn map(random: &mut Random, width: usize, height: usize) -> DisparityMap {
        let disparity = |i: usize| {
            let (x, y) = ((i % width) as f32, (i / width) as f32);
            let noise = random.below(1000) as f32 / 2000.0 - 0.25;
            match random.below(9) {
                0 => f32::NAN,
                _ if x < 0.5 * width as f32 => 20.0 + 0.1 * x - 0.05 * y + noise,
                _ => 40.0 + 0.02 * x + 0.1 * y + noise,
            }
        };
        let disparity: Vec<f32> = (0..width * height).map(disparity).collect();
        let sigma = disparity
            .iter()
            .map(|d| if d.is_nan() { *d } else { 0.05 + d / 100.0 });
        DisparityMap {
            width,
            height,
            sigma: sigma.collect(),
            disparity,
        }
    }

    #[test]
    fn planes_equal_those_of_the_reference() {
        let mut random = Random(71);
        for (level, (width, height)) in reference::with_levels([(1, 1), (3, 9), (150, 20)]) {
            let pixels = random.image(width, height);
            let image = ImageView::packed(width, height, &pixels).unwrap();
            let before = map(&mut random, width, height);
            let mut found = before.clone();
            PLANES.fit(level, &image, &mut found, &mut PlaneBuffers::default());
            for (i, found) in found.disparity.iter().enumerate() {
                if before.disparity[i].is_nan() {
                    assert!(found.is_nan());
                    continue;
                }
                let expected = reference(&image, &before, i % width, i / width);
                let error = f64::from(*found) - expected;
                assert!(error.abs() < 1e-4, "{level:?} {i}: {found} {expected}");
            }
        }
    }

    #[test]
    fn noise_is_averaged_and_edges_are_kept() {
        let mut random = Random(72);
        let (width, height) = (64, 48);
        let pixels = vec![100; width * height];
        let image = ImageView::packed(width, height, &pixels).unwrap();
        let before = map(&mut random, width, height);
        let mut after = before.clone();
        let level = Level::all()[0];
        PLANES.fit(level, &image, &mut after, &mut PlaneBuffers::default());
        let error = |map: &DisparityMap| {
            let errors = map.disparity.iter().enumerate().map(|(i, d)| {
                let (x, y) = ((i % width) as f32, (i / width) as f32);
                let truth = match x < 0.5 * width as f32 {
                    true => 20.0 + 0.1 * x - 0.05 * y,
                    false => 40.0 + 0.02 * x + 0.1 * y,
                };
                (d - truth).abs()
            });
            errors
                .filter(|e| !e.is_nan())
                .fold((0.0, 0.0_f32), |(sum, most), e| (sum + e, most.max(e)))
        };
        let ((before, _), (after, most)) = (error(&before), error(&after));
        assert!(
            after < 0.4 * before && most < 0.25,
            "{after} {before} {most}"
        );
    }
}
