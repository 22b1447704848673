//! KLT tracking of patches between images.
//!
//! Iterative alignment by translation (Lucas and Kanade 1981) in the inverse compositional form
//! (Baker and Matthews, Lucas-Kanade 20 Years On, 2004), from coarse to fine, on patches normalized
//! in mean and contrast, so that exposure may differ. A row of a patch of 8 px is one vector
//! register. [`track`] returns a position only if tracking it back leads to the start.

#![allow(
    clippy::needless_range_loop,
    reason = "loops over several rows together; with indices the compiler vectorizes them"
)]

use estimator_config::config;

use crate::pyramid::{Level, Patch, Pyramid, half_extent};

config! {
    /// KLT tracking of patches.
    pub struct KltConfig {
        /// Maximum number of iterations per level. Fewer lose fast motion; more cost time, mainly
        /// for patches that are lost anyway.
        pub max_iterations: usize = 10,
        /// Length of a step at which the alignment has converged, px. It bounds the bias of a
        /// track.
        pub convergence_px: f64 = 0.01,
        /// Maximum distance between the start and the position tracked back to it, px. Higher lets
        /// slips along edges through.
        pub max_forward_backward_px: f64 = 0.5,
        /// Minimum normalized cross-correlation (NCC) of the two patches, -1 to 1. Lower follows
        /// occlusions, higher loses features that change scale.
        pub min_ncc: f64 = 0.8,
        /// Minimum contrast of a template: norm of its gray levels minus their mean. Below it there
        /// is mostly noise.
        pub min_contrast: f64 = 8.0,
        /// Minimum determinant of the gradient moments, as a fraction of their squared trace. Lower
        /// accepts edges, on which the position is not determined.
        pub min_determinant_ratio: f64 = 1e-4,
    }
}

/// Template patch with gradients and inverse Hessian.
struct Template<const SIDE: usize> {
    values: Patch<SIDE>,
    gx: Patch<SIDE>,
    gy: Patch<SIDE>,
    /// Inverse of the second moments of the gradients (xx, xy, yy).
    inverse: [f32; 3],
    /// Norm of the values.
    norm: f32,
}

/// Subtracts the mean and returns the norm.
#[inline(always)]
fn center<const SIDE: usize>(values: &mut Patch<SIDE>) -> f32 {
    let mut sums = [0.0; SIDE];
    for row in &*values {
        for i in 0..SIDE {
            sums[i] += row[i];
        }
    }
    let mean = sums.iter().sum::<f32>() / (SIDE * SIDE) as f32;
    let mut squares = [0.0; SIDE];
    for row in values {
        for i in 0..SIDE {
            row[i] -= mean;
            squares[i] += row[i] * row[i];
        }
    }
    squares.iter().sum::<f32>().sqrt()
}

impl<const SIDE: usize> Template<SIDE> {
    #[inline(always)]
    fn new(config: &KltConfig, level: &Level, x: f32, y: f32) -> Option<Self> {
        let zero = [[0.0; SIDE]; SIDE];
        let mut new = Self {
            values: zero,
            gx: zero,
            gy: zero,
            inverse: [0.0; 3],
            norm: 0.0,
        };
        let mut other = zero;
        if !level.sample_patch(x + 1.0, y, &mut new.gx)
            || !level.sample_patch(x - 1.0, y, &mut other)
        {
            return None;
        }
        for k in 0..SIDE {
            for i in 0..SIDE {
                new.gx[k][i] = 0.5 * (new.gx[k][i] - other[k][i]);
            }
        }
        if !level.sample_patch(x, y + 1.0, &mut new.gy)
            || !level.sample_patch(x, y - 1.0, &mut other)
        {
            return None;
        }
        let mut moments = [[0.0; SIDE]; 3];
        for k in 0..SIDE {
            for i in 0..SIDE {
                new.gy[k][i] = 0.5 * (new.gy[k][i] - other[k][i]);
                let (gx, gy) = (new.gx[k][i], new.gy[k][i]);
                moments[0][i] += gx * gx;
                moments[1][i] += gx * gy;
                moments[2][i] += gy * gy;
            }
        }
        let [a, b, c] = moments.map(|m| m.iter().sum::<f32>());
        level.sample_patch(x, y, &mut new.values);
        new.norm = center(&mut new.values);
        let determinant = a * c - b * b;
        let is_edge = determinant <= config.min_determinant_ratio as f32 * (a + c) * (a + c);
        if is_edge || new.norm < config.min_contrast as f32 {
            return None;
        }
        new.inverse = [c / determinant, -b / determinant, a / determinant];
        Some(new)
    }

    /// Aligns, starting at a position in the other level. Returns the position and the NCC there.
    #[inline(always)]
    fn align(
        &self,
        config: &KltConfig,
        level: &Level,
        mut x: f32,
        mut y: f32,
    ) -> Option<([f32; 2], f32)> {
        let mut patch = [[0.0; SIDE]; SIDE];
        for iteration in 0.. {
            if !level.sample_patch(x, y, &mut patch) {
                return None;
            }
            let norm = center(&mut patch);
            if norm < 1.0 {
                return None;
            }
            let gain = self.norm / norm;
            let mut sums = [[0.0; SIDE]; 3];
            for k in 0..SIDE {
                for i in 0..SIDE {
                    let error = patch[k][i] * gain - self.values[k][i];
                    sums[0][i] += self.gx[k][i] * error;
                    sums[1][i] += self.gy[k][i] * error;
                    sums[2][i] += patch[k][i] * self.values[k][i];
                }
            }
            let [ex, ey, product] = sums.map(|s| s.iter().sum::<f32>());
            let ncc = product / (norm * self.norm);
            let dx = self.inverse[0] * ex + self.inverse[1] * ey;
            let dy = self.inverse[1] * ex + self.inverse[2] * ey;
            let length = (dx * dx + dy * dy).sqrt();
            if iteration == config.max_iterations || length < config.convergence_px as f32 {
                return Some(([x, y], ncc));
            }
            // A step longer than half a patch means that there is no match.
            let scale_back = (half_extent(SIDE) / length).min(1.0);
            x -= dx * scale_back;
            y -= dy * scale_back;
        }
        None
    }
}

/// Tracks the position `at` of `from` into `to`, starting at `guess` on the level `coarsest`, by
/// patches of `SIDE` x `SIDE` px. All positions are in pixels of the finest level.
pub fn track<const SIDE: usize>(
    config: &KltConfig,
    from: &Pyramid,
    to: &Pyramid,
    at: [f32; 2],
    guess: [f32; 2],
    coarsest: usize,
) -> Option<[f32; 2]> {
    #[cfg(target_arch = "x86_64")]
    if is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma") {
        // SAFETY: the processor supports the target features of the function, as checked above.
        return unsafe { track_avx2::<SIDE>(config, from, to, at, guess, coarsest) };
    }
    track_portable::<SIDE>(config, from, to, at, guess, coarsest)
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2,fma")]
fn track_avx2<const SIDE: usize>(
    config: &KltConfig,
    from: &Pyramid,
    to: &Pyramid,
    at: [f32; 2],
    guess: [f32; 2],
    coarsest: usize,
) -> Option<[f32; 2]> {
    track_portable::<SIDE>(config, from, to, at, guess, coarsest)
}

#[inline(always)]
fn track_portable<const SIDE: usize>(
    config: &KltConfig,
    from: &Pyramid,
    to: &Pyramid,
    at: [f32; 2],
    guess: [f32; 2],
    coarsest: usize,
) -> Option<[f32; 2]> {
    let (found, ncc) = track_forward::<SIDE>(config, from, to, at, guess, coarsest)?;
    if ncc < config.min_ncc as f32 {
        return None;
    }
    // The backward pass starts near the end point, since it only detects slips; from the original
    // guess it would double the cost.
    let back = [
        at[0] + (guess[0] - found[0]).clamp(-1.0, 1.0),
        at[1] + (guess[1] - found[1]).clamp(-1.0, 1.0),
    ];
    let (back, _) = track_forward::<SIDE>(config, to, from, found, back, 0)?;
    let error = (back[0] - at[0]).hypot(back[1] - at[1]);
    (error < config.max_forward_backward_px as f32).then_some(found)
}

#[inline(always)]
fn track_forward<const SIDE: usize>(
    config: &KltConfig,
    from: &Pyramid,
    to: &Pyramid,
    at: [f32; 2],
    guess: [f32; 2],
    coarsest: usize,
) -> Option<([f32; 2], f32)> {
    let mut offset = [guess[0] - at[0], guess[1] - at[1]];
    for level in (0..=coarsest.min(from.levels.len() - 1)).rev() {
        let scale = (1_u32 << level) as f32;
        let [x, y] = at.map(|v| v / scale);
        // On a coarse level the patch may exceed the border.
        let aligned =
            Template::<SIDE>::new(config, &from.levels[level], x, y).and_then(|template| {
                let (u, v) = (x + offset[0] / scale, y + offset[1] / scale);
                template.align(config, &to.levels[level], u, v)
            });
        match aligned {
            Some((position, ncc)) if level == 0 => return Some((position, ncc)),
            Some(([u, v], _)) => offset = [(u - x) * scale, (v - y) * scale],
            None if level == 0 => return None,
            None => {}
        }
    }
    None
}

/// Patch around a position of a level, normalized to mean 0 and norm 1, for NCC.
pub fn normalized_patch<const SIDE: usize>(
    config: &KltConfig,
    level: &Level,
    x: f32,
    y: f32,
) -> Option<Patch<SIDE>> {
    let mut patch = [[0.0; SIDE]; SIDE];
    if !level.sample_patch(x, y, &mut patch) {
        return None;
    }
    let norm = center(&mut patch);
    (norm >= config.min_contrast as f32).then(|| patch.map(|row| row.map(|v| v / norm)))
}

#[cfg(test)]
mod tests {
    use crate::pyramid::PyramidConfig;
    use crate::view::ImageView;

    use super::*;

    /// Smooth value noise between 0 and 1: random values on a grid, interpolated.
    fn noise(x: f64, y: f64, cell: f64, seed: u64) -> f64 {
        let (u, v) = (x / cell + 1e3, y / cell + 1e3);
        let (i, j) = (u.floor(), v.floor());
        let at = |i: f64, j: f64| {
            let mut h = seed ^ ((i as u64) << 32) ^ (j as u64);
            for _ in 0..3 {
                h = (h ^ (h >> 29)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            }
            (h >> 40) as f64 / f64::from(1 << 24)
        };
        let soft = |t: f64| t * t * (3.0 - 2.0 * t);
        let (fx, fy) = (soft(u - i), soft(v - j));
        let upper = at(i, j) * (1.0 - fx) + at(i + 1.0, j) * fx;
        let lower = at(i, j + 1.0) * (1.0 - fx) + at(i + 1.0, j + 1.0) * fx;
        upper * (1.0 - fy) + lower * fy
    }

    /// Noise of several scales, shifted by fractions of a pixel, with a different gain.
    fn image(dx: f64, dy: f64, gain: f64) -> Pyramid {
        let (w, h) = (200, 160);
        let mut data = Vec::new();
        for y in 0..h {
            for x in 0..w {
                let (x, y) = (f64::from(x) - dx, f64::from(y) - dy);
                let v = noise(x, y, 5.0, 1) + noise(x, y, 12.0, 2) + noise(x, y, 30.0, 3);
                data.push((gain * (40.0 + 50.0 * v)).round() as u8);
            }
        }
        Pyramid::new(
            &Default::default(),
            &ImageView::new(w as usize, h as usize, w as usize, &data).expect("an image"),
        )
    }

    #[test]
    fn shifted_image_is_tracked_with_subpixel_accuracy() {
        let from = image(0.0, 0.0, 1.0);
        for (dx, dy, gain) in [(0.3, -0.2, 1.0), (3.4, 2.7, 1.2), (-5.6, 4.1, 0.8)] {
            let to = image(dx, dy, gain);
            for at in [[60.0, 70.0], [101.3, 80.8], [140.5, 60.2]] {
                let found = track::<8>(&Default::default(), &from, &to, at, at, 3).expect("found");
                let error = [found[0] - at[0] - dx as f32, found[1] - at[1] - dy as f32];
                // Rounding to gray levels leaves errors of some hundredths.
                assert!(
                    error[0].hypot(error[1]) < 0.1,
                    "{dx} {dy} {at:?}: {error:?}"
                );
            }
        }
    }

    #[test]
    fn blank_or_outside_patches_are_not_tracked() {
        let from = image(0.0, 0.0, 1.0);
        let blank = vec![90; 200 * 160];
        let blank = ImageView::new(200, 160, 200, &blank).expect("an image");
        let blank = Pyramid::new(&PyramidConfig::default(), &blank);
        let lost = |from: &Pyramid, to: &Pyramid, at, guess| {
            track::<8>(&KltConfig::default(), from, to, at, guess, 3).is_none()
        };
        let middle = [60.0, 70.0];
        assert!(lost(&from, &blank, middle, middle));
        assert!(lost(&blank, &from, middle, middle));
        // Beyond the border, or NaN.
        assert!(lost(&from, &from, [1.0, 70.0], [1.0, 70.0]));
        assert!(lost(&from, &from, middle, [f32::NAN, 70.0]));
        assert!(lost(&from, &from, [f32::NAN, 70.0], middle));
    }
}
