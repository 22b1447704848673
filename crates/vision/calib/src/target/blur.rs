//! Image noise and sharpness of the borders of a board.

use super::config::{BlurConfig, Config};
use imaging::ImageView;

use super::saddle;
use super::smooth::Smooth;

/// Image noise, grey values: the median of second differences along both axes, which cancel slopes
/// and straight borders (Immerkær 1996; median instead of mean, to reduce the influence of
/// texture). At least the quantization noise of whole grey values.
pub(super) fn noise(image: &ImageView<'_>) -> f64 {
    let mut counts = vec![0u32; 256 * 16];
    let mut total = 0u32;
    for y in (1..image.height().saturating_sub(1)).step_by(3) {
        let [a, b, c] = [y - 1, y, y + 1].map(|y| image.row(y));
        for x in (1..image.width().saturating_sub(1)).step_by(2) {
            let v = |row: &[u8], dx: usize| i32::from(row[x + dx - 1]);
            let along = |row: &[u8]| v(row, 0) - 2 * v(row, 1) + v(row, 2);
            // Saturated pixels have no noise.
            if b[x] == 0 || b[x] == 255 {
                continue;
            }
            counts[(along(a) - 2 * along(b) + along(c)).unsigned_abs() as usize] += 1;
            total += 1;
        }
    }
    let mut seen = 0;
    let median = counts
        .iter()
        .position(|n| {
            seen += n;
            2 * seen >= total
        })
        .unwrap_or(0);
    // The mask's weights have a root sum square of 6; half of normal values are within 0.6745
    // sigma.
    (median as f64 / (6.0 * 0.6745)).max(0.3)
}

/// Blur of a view, from the width of the borders: half the distance from 16 % to 84 % of the step,
/// which is one standard deviation of a Gaussian blur; includes the pixel's own size.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Blur {
    /// In the most blurred direction, pixels.
    pub major_px: f64,
    /// Across it, pixels.
    pub minor_px: f64,
    /// The most blurred direction, a unit vector in the image.
    pub direction: [f64; 2],
}

impl Blur {
    /// Length of a uniform motion during the exposure that explains the difference between the
    /// directions, pixels: the blur that remains after removing the minor one.
    pub fn motion_px(&self) -> f64 {
        // 68 % of a uniform motion of this length are between 16 % and 84 %.
        let extra = self.major_px * self.major_px - self.minor_px * self.minor_px;
        2.0 / 0.68 * extra.max(0.0).sqrt()
    }
}

/// A border on a board.
#[derive(Clone, Copy, Debug)]
pub(super) struct Border {
    /// The crossings at its ends.
    pub(super) ends: [[f64; 2]; 2],
    /// Distance to both sides that is plain black and plain white, pixels.
    pub(super) clear: f64,
}

/// Blur from all borders and crossings; the latter by position and clear distance.
///
/// A blur with covariance S gives a border of normal n the variance `nᵀ S n`. The borders of a
/// board have little more than two directions, so that motion along a diagonal is not observable;
/// the crossings resolve it. For `I = m - (C / 2) sgn(a·x) sgn(b·x)` (dark where both have one
/// sign) under normal blur, the value at x = 0 is `m - (C / 2) (2 / π) asin ρ` with `ρ = aᵀ S b /
/// √(aᵀ S a · bᵀ S b)`. A tone curve adds the same unknown to all crossings: crossings of both
/// polarities separate it.
pub(super) fn measure(
    image: &ImageView<'_>,
    smooth: &Smooth,
    borders: &[Border],
    crossings: &[([f64; 2], f64)],
    config: &Config,
) -> Option<Blur> {
    // Unknowns: xx, xy, yy of S, and the tone curve's contribution.
    let mut equations = Equations::default();
    let mut sum = 0.0;
    let mut count = 0;
    for border in borders {
        let [a, b] = border.ends;
        let along = [b[0] - a[0], b[1] - a[1]];
        let length = (along[0] * along[0] + along[1] * along[1]).sqrt();
        let reach = border
            .clear
            .min(config.blur.max_reach_ratio * length)
            .min(config.blur.max_reach_px);
        if reach < config.blur.min_reach_px {
            continue;
        }
        let normal = [-along[1] / length, along[0] / length];
        for t in config.blur.positions {
            let middle = [0, 1].map(|k| a[k] + t * along[k]);
            let Some(width) = width(image, middle, normal, reach, &config.blur) else {
                continue;
            };
            let [x, y] = normal;
            equations.add([x * x, 2.0 * x * y, y * y, 0.0], width * width);
            sum += width * width;
            count += 1;
        }
    }
    if count < config.blur.min_widths {
        return None;
    }
    let variance = sum / f64::from(count);
    for (at, clear) in crossings {
        if let Some((a, b, level)) = crossing_level(image, smooth, *at, *clear, config) {
            // The two variances under the root are near their mean: only the size of their product
            // is needed.
            let scale = 0.5 * std::f64::consts::PI * variance;
            let row = [a[0] * b[0], a[0] * b[1] + a[1] * b[0], a[1] * b[1], -scale];
            equations.add(row, -scale * level);
        }
    }
    // Weak regularization to round blur and no tone curve, for boards with too few crossings.
    let little = config.blur.regularization * f64::from(count);
    equations.add([little, 0.0, -little, 0.0], 0.0);
    equations.add([0.0, little, 0.0, 0.0], 0.0);
    equations.add([0.0, 0.0, 0.0, little], 0.0);
    let [xx, xy, yy, _] = equations.solve()?;
    let mean = 0.5 * (xx + yy);
    let half = (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
    let (major, minor) = ((mean + half).max(0.0), (mean - half).max(0.0));
    // An eigenvector of the larger eigenvalue.
    let (u, v) = if xx >= yy {
        (major - yy, xy)
    } else {
        (xy, major - xx)
    };
    let length = (u * u + v * v).sqrt();
    let direction = if length > 1e-12 {
        [u / length, v / length]
    } else {
        [1.0, 0.0]
    };
    Some(Blur {
        major_px: major.sqrt(),
        minor_px: minor.sqrt(),
        direction,
    })
}

/// Normals of the two borders at a crossing, oriented so that it is dark where both are positive or
/// both negative, and the level at the crossing: -1 as dark as the dark sectors, +1 as bright as
/// the bright ones.
fn crossing_level(
    image: &ImageView<'_>,
    smooth: &Smooth,
    at: [f64; 2],
    clear: f64,
    config: &Config,
) -> Option<([f64; 2], [f64; 2], f64)> {
    if clear < config.blur.min_reach_px {
        return None;
    }
    let crossing = saddle::fit_rays(smooth, at, config.blur.crossing_radius_px, &config.saddles)?;
    let [d0, d1, d2, d3] = crossing.rays.map(|r| {
        let (sin, cos) = libm::sincos(r);
        [cos, sin]
    });
    // The middle of the four sectors.
    let sector = |a: [f64; 2], b: [f64; 2]| {
        let middle = [a[0] + b[0], a[1] + b[1]];
        let length = (middle[0] * middle[0] + middle[1] * middle[1]).sqrt();
        let out = clear.min(config.blur.max_sector_px) / length.max(0.1);
        image.sample([at[0] + out * middle[0], at[1] + out * middle[1]])
    };
    let dark = 0.5 * (sector(d0, d1)? + sector(d2, d3)?);
    let bright = 0.5 * (sector(d1, d2)? + sector(d3, d0)?);
    if bright - dark < config.blur.min_contrast {
        return None;
    }
    let level = (2.0 * image.sample(at)? - bright - dark) / (bright - dark);
    let normal = |d: [f64; 2], towards: [f64; 2]| {
        let n = [-d[1], d[0]];
        let sign = if n[0] * towards[0] + n[1] * towards[1] < 0.0 {
            -1.0
        } else {
            1.0
        };
        n.map(|v| sign * v)
    };
    Some((normal(d0, d1), normal(d1, d0), level))
}

/// Normal equations of a least squares problem with four unknowns.
#[derive(Default)]
struct Equations {
    matrix: [[f64; 4]; 4],
    right: [f64; 4],
}

impl Equations {
    fn add(&mut self, row: [f64; 4], value: f64) {
        for i in 0..4 {
            for j in 0..4 {
                self.matrix[i][j] += row[i] * row[j];
            }
            self.right[i] += row[i] * value;
        }
    }

    /// Gaussian elimination with column pivoting.
    fn solve(mut self) -> Option<[f64; 4]> {
        for k in 0..4 {
            let pivot = (k..4).max_by(|a, b| {
                self.matrix[*a][k]
                    .abs()
                    .total_cmp(&self.matrix[*b][k].abs())
            })?;
            self.matrix.swap(k, pivot);
            self.right.swap(k, pivot);
            let top = self.matrix[k];
            if top[k].abs() < 1e-12 {
                return None;
            }
            for i in k + 1..4 {
                let share = self.matrix[i][k] / top[k];
                for (value, above) in self.matrix[i].iter_mut().zip(top) {
                    *value -= share * above;
                }
                self.right[i] -= share * self.right[k];
            }
        }
        let mut x = [0.0; 4];
        for k in (0..4).rev() {
            let rest: f64 = (k + 1..4).map(|j| self.matrix[k][j] * x[j]).sum();
            x[k] = (self.right[k] - rest) / self.matrix[k][k];
        }
        Some(x)
    }
}

/// Half the distance from 16 % to 84 % of a step across a border.
fn width(
    image: &ImageView<'_>,
    middle: [f64; 2],
    normal: [f64; 2],
    reach: f64,
    config: &BlurConfig,
) -> Option<f64> {
    let steps = (4.0 * reach) as usize;
    let sample = |i: usize| {
        let o = 0.5 * (i as f64 - 0.5 * steps as f64);
        image.sample([0, 1].map(|k| middle[k] + o * normal[k]))
    };
    let values: Vec<f64> = (0..=steps).map(sample).collect::<Option<_>>()?;
    // The levels on both sides: the outer parts of the profile.
    let outer = (values.len() / config.level_divisor).max(2);
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (low, high) = (
        mean(&values[..outer]),
        mean(&values[values.len() - outer..]),
    );
    if (high - low).abs() < config.min_contrast {
        return None;
    }
    // Outwards from the middle of the step, so that noise far away does not count.
    let level = |v: f64| (v - low) / (high - low);
    let middle = (0..steps).find(|i| level(values[*i]) < 0.5 && level(values[i + 1]) >= 0.5)?;
    let crossing = |mut i: usize, up: bool, share: f64| -> Option<f64> {
        loop {
            let (a, b) = (level(values[i]), level(values[i + 1]));
            if a < share && b >= share {
                return Some(i as f64 + (share - a) / (b - a));
            }
            i = if up { i + 1 } else { i.checked_sub(1)? };
            if i + 1 >= values.len() {
                return None;
            }
        }
    };
    let width = crossing(middle, true, 0.84)? - crossing(middle, false, 0.16)?;
    Some(0.25 * width)
}
