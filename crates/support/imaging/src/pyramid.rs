//! Image pyramid.
//!
//! Contract: level `k` has every `2^k`-th pixel, smoothed by the binomial filter 1 4 6 4 1 before
//! each halving. Pixel `i` of level `k` is at pixel `2^k i` of the image, so that coordinates of
//! levels differ by a factor only. All levels are bytes: a patch of 8 x 8, as odometry uses, is
//! then two cache lines, and rounding moves a corner by less than noise does.

use estimator_config::config;

use crate::view::ImageView;

config! {
    /// Image pyramid.
    pub struct PyramidConfig {
        /// Maximum number of levels. Each level doubles the motion that tracking can follow.
        pub max_levels: usize = 4,
        /// Minimum side of the coarsest level, px: three patches of 8 px.
        pub min_side_px: usize = 24,
    }
}

/// One level, row-major.
#[derive(Clone, Debug, Default)]
pub struct Level {
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// Gray values.
    pub data: Vec<u8>,
}

/// Levels, the finest first.
#[derive(Clone, Debug, Default)]
pub struct Pyramid {
    /// Levels, the finest first; empty by default.
    pub levels: Vec<Level>,
}

impl Pyramid {
    /// Builds the pyramid of an image.
    pub fn new(config: &PyramidConfig, image: &ImageView<'_>) -> Self {
        let (width, height) = image.size();
        let mut data = Vec::with_capacity(width * height);
        for y in 0..height {
            data.extend_from_slice(image.row(y));
        }
        let mut levels = vec![Level {
            width,
            height,
            data,
        }];
        while levels.len() < config.max_levels {
            let half = downsample(&levels[levels.len() - 1]);
            if half.width.min(half.height) < config.min_side_px {
                break;
            }
            levels.push(half);
        }
        Self { levels }
    }
}

/// A square of gray values, row by row.
pub type Patch<const SIDE: usize> = [[f32; SIDE]; SIDE];

/// From the center of a patch to its outermost pixels, px; with an even side the center is between
/// pixels.
pub(crate) const fn half_extent(side: usize) -> f32 {
    0.5 * (side - 1) as f32
}

impl Level {
    /// Samples the patch around a position with bilinear interpolation; returns false if it exceeds
    /// the level.
    #[inline(always)]
    pub fn sample_patch<const SIDE: usize>(&self, x: f32, y: f32, patch: &mut Patch<SIDE>) -> bool {
        let (left, top) = (x - half_extent(SIDE), y - half_extent(SIDE));
        // NaN is outside.
        let inside = left >= 0.0
            && top >= 0.0
            && left + (SIDE as f32) < self.width as f32
            && top + (SIDE as f32) < self.height as f32;
        if !inside {
            return false;
        }
        let (fx, fy) = (left - left.floor(), top - top.floor());
        let at = top as usize * self.width + left as usize;
        let (w00, w10) = ((1.0 - fx) * (1.0 - fy), fx * (1.0 - fy));
        let (w01, w11) = ((1.0 - fx) * fy, fx * fy);
        for (k, row) in patch.iter_mut().enumerate() {
            let upper = &self.data[at + k * self.width..][..SIDE + 1];
            let lower = &self.data[at + (k + 1) * self.width..][..SIDE + 1];
            for (i, value) in row.iter_mut().enumerate() {
                *value = w00 * f32::from(upper[i])
                    + w10 * f32::from(upper[i + 1])
                    + w01 * f32::from(lower[i])
                    + w11 * f32::from(lower[i + 1]);
            }
        }
        true
    }
}

fn downsample(level: &Level) -> Level {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") {
        // SAFETY: the processor supports the target features of the function, as checked above.
        return unsafe { downsample_avx2(level) };
    }
    downsample_portable(level)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn downsample_avx2(level: &Level) -> Level {
    downsample_portable(level)
}

/// Every second pixel of the smoothed level; the border pixels are repeated.
#[inline(always)]
fn downsample_portable(level: &Level) -> Level {
    let (w, h) = (level.width, level.height);
    let (width, height) = (w.div_ceil(2), h.div_ceil(2));
    let mut data = vec![0; width * height];
    // Column sums, padded by two pixels on both sides.
    let mut sums = vec![0_u16; w + 4];
    for (k, out) in data.chunks_exact_mut(width).enumerate() {
        let row = |d: isize| {
            let y = (2 * k as isize + d).clamp(0, h as isize - 1) as usize;
            &level.data[y * w..(y + 1) * w]
        };
        let (a, b, c, d, e) = (row(-2), row(-1), row(0), row(1), row(2));
        for x in 0..w {
            // Not by `map`, which may be a call in here.
            let [a, b, c, d, e] = [
                u16::from(a[x]),
                u16::from(b[x]),
                u16::from(c[x]),
                u16::from(d[x]),
                u16::from(e[x]),
            ];
            sums[x + 2] = a + e + 4 * (b + d) + 6 * c;
        }
        let (first, last) = (sums[2], sums[w + 1]);
        (sums[0], sums[1], sums[w + 2], sums[w + 3]) = (first, first, last, last);
        for (x, out) in out.iter_mut().enumerate() {
            let s = &sums[2 * x..2 * x + 5];
            let sum = s[0] + s[4] + 4 * (s[1] + s[3]) + 6 * s[2];
            *out = ((sum + 128) >> 8) as u8;
        }
    }
    Level {
        width,
        height,
        data,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn level_equals_the_direct_binomial_filter() {
        let (w, h) = (101, 67);
        let data: Vec<u8> = (0..w * h).map(|i| (i * i % 251) as u8).collect();
        let level = Level {
            width: w,
            height: h,
            data: data.clone(),
        };
        let half = downsample(&level);
        assert_eq!((half.width, half.height), (51, 34));
        let weights = [1, 4, 6, 4, 1];
        for y in 0..34 {
            for x in 0..51 {
                let mut sum = 0;
                for (j, wj) in weights.iter().enumerate() {
                    for (i, wi) in weights.iter().enumerate() {
                        let u = (2 * x as isize + i as isize - 2).clamp(0, w as isize - 1);
                        let v = (2 * y as isize + j as isize - 2).clamp(0, h as isize - 1);
                        sum += wi * wj * u32::from(data[v as usize * w + u as usize]);
                    }
                }
                let expected = (sum + 128) >> 8;
                assert_eq!(u32::from(half.data[y * 51 + x]), expected, "{x} {y}");
            }
        }
    }
}
