//! Image pyramids.
//!
//! Contract: level `k` of a pyramid has every `2^k`-th pixel of the image, smoothed before; pixel
//! `i` of level `k` is at pixel `2^k i` of the image, so that coordinates of levels differ by a
//! factor only.

use imaging::ImageView;

use super::config::PyramidConfig;

/// One level of a pyramid.
#[derive(Clone, Debug)]
pub(super) struct Level {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) data: Vec<f32>,
}

/// An image pyramid, the largest level first.
#[derive(Clone, Debug)]
pub(super) struct Pyramid {
    /// Number of halvings from the image to the first level.
    pub(super) halved: u32,
    pub(super) levels: Vec<Level>,
}

impl Pyramid {
    pub(super) fn new(image: &ImageView<'_>, config: &PyramidConfig) -> Self {
        let (width, height) = image.size();
        let mut level = Level {
            width,
            height,
            data: (0..height)
                .flat_map(|y| image.row(y))
                .map(|p| f32::from(*p))
                .collect(),
        };
        let mut halved = 0;
        while level.width > config.max_width_px {
            level = level.half();
            halved += 1;
        }
        let mut levels = vec![level];
        while levels.len() < config.max_levels {
            let half = levels[levels.len() - 1].half();
            if half.width.min(half.height) < config.min_side_px {
                break;
            }
            levels.push(half);
        }
        Self { halved, levels }
    }

    /// Pixels of the image per pixel of the first level.
    pub(super) fn scale(&self) -> f64 {
        f64::from(1_u32 << self.halved)
    }
}

impl Level {
    /// Every second pixel, smoothed by the binomial filter 1 4 6 4 1.
    fn half(&self) -> Self {
        let (width, height) = (self.width.div_ceil(2), self.height.div_ceil(2));
        let weigh =
            |a: f32, b: f32, c: f32, d: f32, e: f32| (a + e) * 0.0625 + (b + d) * 0.25 + c * 0.375;
        let mut rows = vec![0.0; width * self.height];
        for (row, out) in self
            .data
            .chunks_exact(self.width)
            .zip(rows.chunks_exact_mut(width))
        {
            let last = self.width - 1;
            for (i, out) in out.iter_mut().enumerate() {
                let x = 2 * i;
                let at = |d: isize| row[(x as isize + d).clamp(0, last as isize) as usize];
                *out = if x >= 2 && x + 2 <= last {
                    weigh(row[x - 2], row[x - 1], row[x], row[x + 1], row[x + 2])
                } else {
                    weigh(at(-2), at(-1), at(0), at(1), at(2))
                };
            }
        }
        let mut data = vec![0.0; width * height];
        for (k, out) in data.chunks_exact_mut(width).enumerate() {
            let last = self.height as isize - 1;
            let row = |d: isize| {
                let y = (2 * k as isize + d).clamp(0, last) as usize;
                &rows[y * width..(y + 1) * width]
            };
            let (a, b, c, d, e) = (row(-2), row(-1), row(0), row(1), row(2));
            for (x, out) in out.iter_mut().enumerate() {
                *out = weigh(a[x], b[x], c[x], d[x], e[x]);
            }
        }
        Self {
            width,
            height,
            data,
        }
    }

    /// The square of `2 radius + 1` pixels a side around a position, interpolated; false if it
    /// extends beyond the level.
    pub(super) fn patch(&self, x: f32, y: f32, radius: usize, out: &mut [f32]) -> bool {
        let reach = radius as f32;
        // Written so that a position that is not finite is outside.
        let inside = x - reach >= 0.0
            && y - reach >= 0.0
            && x + reach + 1.0 < self.width as f32
            && y + reach + 1.0 < self.height as f32;
        if !inside {
            return false;
        }
        let (left, top) = (x.floor(), y.floor());
        let (fx, fy) = (x - left, y - top);
        let (left, top) = (left as usize - radius, top as usize - radius);
        let side = 2 * radius + 1;
        let weights = [
            (1.0 - fx) * (1.0 - fy),
            fx * (1.0 - fy),
            (1.0 - fx) * fy,
            fx * fy,
        ];
        for (k, out) in out[..side * side].chunks_exact_mut(side).enumerate() {
            let at = (top + k) * self.width + left;
            let upper = &self.data[at..at + side + 1];
            let lower = &self.data[at + self.width..at + self.width + side + 1];
            for (i, out) in out.iter_mut().enumerate() {
                *out = weights[0] * upper[i]
                    + weights[1] * upper[i + 1]
                    + weights[2] * lower[i]
                    + weights[3] * lower[i + 1];
            }
        }
        true
    }
}
