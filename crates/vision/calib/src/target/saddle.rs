//! Crossings of black and white: saddle points of the smoothed image.
//!
//! Contract: every pixel whose Hessian has a clearly negative determinant, more so than its eight
//! neighbours, is a candidate; a candidate is accepted if a small circle around it is alternately
//! dark, bright, dark and bright, with both pairs of borders nearly straight. The result is sorted
//! by row, then column; each crossing has a position accurate to a fraction of a pixel, four rays
//! along the borders, and a contrast.
//!
//! The Hessian of the image smoothed by 1 pixel comes from differences over 2 pixels; its
//! determinant does not depend on the direction of the crossing (Lucchese and Mitra 2002 use the
//! same criterion).

use super::config::{Config, SaddleConfig};
use super::refine::{self, Window};
use super::smooth::{Smooth, UNIT};

/// Samples around the circle.
const SAMPLES: usize = 32;

/// A crossing of black and white.
#[derive(Clone, Debug)]
pub(super) struct Saddle {
    /// Position in the image, pixels.
    pub(super) at: [f64; 2],
    /// Directions of the borders, radians from x towards y, ascending around the circle from one in
    /// `0..2π`: between rays 0 and 1 and between 2 and 3 it is dark, between 1 and 2 and between 3
    /// and 0 bright.
    pub(super) rays: [f64; 4],
    /// Contrast near the crossing, grey values.
    pub(super) contrast: f32,
}

/// Finds the crossings.
pub(super) fn find(smooth: &Smooth, config: &Config) -> Vec<Saddle> {
    let refinement = &config.refinement;
    let config = &config.saddles;
    let mut peaks = peaks(smooth, config);
    if peaks.len() > config.max_candidates {
        // By strength, then by position, so that equal ones do not depend on the sort.
        peaks.sort_by(|a, b| b.2.total_cmp(&a.2).then((a.1, a.0).cmp(&(b.1, b.0))));
        peaks.truncate(config.max_candidates);
        peaks.sort_by_key(|&(x, y, _)| (y, x));
    }
    let mut saddles: Vec<Saddle> = Vec::new();
    let window = Window::round(refinement.min_window_px, refinement);
    for (x, y, _) in peaks {
        if !may_cross(smooth, x, y, config) {
            continue;
        }
        let Some(at) =
            refine::refine_coarsely(smooth, [x as f64, y as f64], &window, config.max_shift_px)
        else {
            continue;
        };
        if let Some(saddle) = config
            .radius_px
            .into_iter()
            .find_map(|radius| fit_rays(smooth, at, radius, config))
        {
            saddles.push(saddle);
        }
    }
    drop_doubles(saddles, config.min_distance_px)
}

/// A quick test with whole pixels: around a crossing the image is brighter and darker than its
/// middle twice. Rejects most of texture and noise.
fn may_cross(smooth: &Smooth, x: usize, y: usize, config: &SaddleConfig) -> bool {
    /// Circles of 3 and 2 pixels.
    const OUTER: [(isize, isize); 16] = [
        (3, 0),
        (3, 1),
        (2, 2),
        (1, 3),
        (0, 3),
        (-1, 3),
        (-2, 2),
        (-3, 1),
        (-3, 0),
        (-3, -1),
        (-2, -2),
        (-1, -3),
        (0, -3),
        (1, -3),
        (2, -2),
        (3, -1),
    ];
    const INNER: [(isize, isize); 12] = [
        (2, 0),
        (2, 1),
        (1, 2),
        (0, 2),
        (-1, 2),
        (-2, 1),
        (-2, 0),
        (-2, -1),
        (-1, -2),
        (0, -2),
        (1, -2),
        (2, -1),
    ];
    let least = config.quick_contrast_ratio * config.min_contrast;
    let middle = i32::from(smooth.values[y * smooth.width + x]);
    let crosses = |circle: &[(isize, isize)]| {
        let value = |&(dx, dy): &(isize, isize)| {
            let at = y.strict_add_signed(dy) * smooth.width + x.strict_add_signed(dx);
            i32::from(smooth.values[at]) - middle
        };
        let (mut low, mut high, mut changes) = (i32::MAX, i32::MIN, 0);
        let mut last = value(&circle[circle.len() - 1]);
        for place in circle {
            let here = value(place);
            changes += i32::from((here < 0) != (last < 0));
            (low, high, last) = (low.min(here), high.max(here), here);
        }
        changes == 4 && (high - low) as f32 * UNIT >= least
    };
    crosses(&OUTER) || crosses(&INNER)
}

/// Of crossings less than `least_px` apart, keeps the one of higher contrast.
fn drop_doubles(mut saddles: Vec<Saddle>, least_px: f64) -> Vec<Saddle> {
    saddles.sort_by(|a, b| {
        a.at[1]
            .total_cmp(&b.at[1])
            .then(a.at[0].total_cmp(&b.at[0]))
    });
    let mut keep = vec![true; saddles.len()];
    for i in 0..saddles.len() {
        for j in i + 1..saddles.len() {
            let [dx, dy] = [
                saddles[j].at[0] - saddles[i].at[0],
                saddles[j].at[1] - saddles[i].at[1],
            ];
            if dy > least_px {
                break;
            }
            if dx * dx + dy * dy < least_px * least_px {
                let weaker = if saddles[j].contrast > saddles[i].contrast {
                    i
                } else {
                    j
                };
                keep[weaker] = false;
            }
        }
    }
    let mut keep = keep.iter();
    saddles.retain(|_| *keep.next().expect("one flag for each"));
    saddles
}

/// Negated determinants of the Hessian in (grey values per square pixel)², a row at a time.
fn response(smooth: &Smooth, y: usize, out: &mut [f32]) {
    let width = smooth.width;
    let row = |y: usize| &smooth.values[y * width..(y + 1) * width];
    let (up2, up, here, down, down2) = (row(y - 2), row(y - 1), row(y), row(y + 1), row(y + 2));
    let count = width - 4;
    let out = &mut out[2..2 + count];
    // Slices of equal length, so that the loop below needs no bounds checks and is vectorized.
    let (left2, mid, right2) = (&here[..count], &here[2..2 + count], &here[4..4 + count]);
    let (north, south) = (&up2[2..2 + count], &down2[2..2 + count]);
    let (nw, ne) = (&up[1..1 + count], &up[3..3 + count]);
    let (sw, se) = (&down[1..1 + count], &down[3..3 + count]);
    for i in 0..count {
        let v = |s: &[u16]| i32::from(s[i]);
        let middle = 2 * v(mid);
        let xx = (v(left2) + v(right2) - middle) as f32;
        let yy = (v(north) + v(south) - middle) as f32;
        let xy = (v(se) - v(sw) - v(ne) + v(nw)) as f32;
        out[i] = xy * xy - xx * yy;
    }
}

/// Both second differences are four times the derivative, and the values are in 1/256.
const RESPONSE_UNIT: f32 = UNIT * UNIT / 16.0;

/// Pixels with more response than their neighbours: column, row, response. Row by row.
fn peaks(smooth: &Smooth, config: &SaddleConfig) -> Vec<(usize, usize, f32)> {
    let (width, height) = (smooth.width, smooth.height);
    let mut peaks = Vec::new();
    if width < 9 || height < 9 {
        return peaks;
    }
    let least = config.min_curvature * config.min_curvature / RESPONSE_UNIT;
    // Ring buffer of three rows of responses.
    let mut rows = [
        vec![0.0f32; width],
        vec![0.0f32; width],
        vec![0.0f32; width],
    ];
    response(smooth, 2, &mut rows[1]);
    response(smooth, 3, &mut rows[2]);
    for y in 3..height - 3 {
        rows.rotate_left(1);
        response(smooth, y + 1, &mut rows[2]);
        let [above, here, below] = &rows;
        for x in 3..width - 3 {
            let value = here[x];
            if value < least {
                continue;
            }
            // Of equal values the first one counts.
            let first = value > above[x - 1]
                && value > above[x]
                && value > above[x + 1]
                && value > here[x - 1];
            if first && value >= here[x + 1] && below[x - 1..x + 2].iter().all(|v| value >= *v) {
                peaks.push((x, y, value * RESPONSE_UNIT));
            }
        }
    }
    peaks
}

/// Analyses a circle around a position. `None` if it is not a crossing.
pub(super) fn fit_rays(
    smooth: &Smooth,
    at: [f64; 2],
    radius: f32,
    config: &SaddleConfig,
) -> Option<Saddle> {
    let (x, y) = (at[0] as f32, at[1] as f32);
    let level = smooth.sample(x, y)?;
    let mut values = [0.0f32; SAMPLES];
    for (value, (cos, sin)) in values.iter_mut().zip(circle()) {
        *value = smooth.sample(x + radius * cos, y + radius * sin)? - level;
    }
    let step = std::f64::consts::TAU / SAMPLES as f64;
    let mut borders = [0.0f64; 4];
    let mut count = 0;
    let mut into_dark = 0;
    for i in 0..SAMPLES {
        let (a, b) = (values[i], values[(i + 1) % SAMPLES]);
        if (a < 0.0) != (b < 0.0) {
            if count == 4 {
                return None;
            }
            borders[count] = (i as f64 + f64::from(a / (a - b))) * step;
            if b < 0.0 && count < 2 {
                into_dark = count;
            }
            count += 1;
        }
    }
    if count != 4 {
        return None;
    }
    let mut rays = [0, 1, 2, 3].map(|k| {
        let k = into_dark + k;
        borders[k % 4] + if k >= 4 { std::f64::consts::TAU } else { 0.0 }
    });
    // A border continues on the other side: to about 35 degrees, since a ring of few pixels next to
    // other corners is a rough estimate.
    let straight = |a: f64, b: f64| (b - a - std::f64::consts::PI).abs() < config.max_bend_rad;
    let apart = (0..4).all(|k| {
        let next = if k == 3 {
            rays[0] + std::f64::consts::TAU
        } else {
            rays[k + 1]
        };
        next - rays[k] > config.min_sector_rad
    });
    if !straight(rays[0], rays[2]) || !straight(rays[1], rays[3]) || !apart {
        return None;
    }
    // The extreme of each sector.
    let mut extremes = [0.0f32; 4];
    for (i, &value) in values.iter().enumerate() {
        let mut angle = i as f64 * step;
        if angle < rays[0] {
            angle += std::f64::consts::TAU;
        }
        let sector = (1..4).take_while(|&k| angle >= rays[k]).count();
        if value.abs() > extremes[sector].abs() {
            extremes[sector] = value;
        }
    }
    let bright = extremes[1].min(extremes[3]);
    let dark = extremes[0].max(extremes[2]);
    let contrast = bright - dark;
    let side = config.min_side_ratio * contrast;
    // If one side of the level is far flatter than the other, it is the end of a line, not a
    // crossing.
    if contrast < config.min_contrast || bright < side || -dark < side {
        return None;
    }
    for ray in &mut rays {
        if *ray >= std::f64::consts::TAU {
            *ray -= std::f64::consts::TAU;
        }
    }
    Some(Saddle { at, rays, contrast })
}

/// Cosines and sines of the samples' angles, the same on every machine.
fn circle() -> impl Iterator<Item = (f32, f32)> {
    /// cos(i π / 16)
    const COSINES: [f32; 9] = [
        1.0,
        0.980_785_25,
        0.923_879_5,
        0.831_469_6,
        std::f32::consts::FRAC_1_SQRT_2,
        0.555_570_24,
        0.382_683_43,
        0.195_090_32,
        0.0,
    ];
    let cosine = |i: usize| {
        let i = i % SAMPLES;
        let i = i.min(SAMPLES - i);
        if i <= 8 { COSINES[i] } else { -COSINES[16 - i] }
    };
    (0..SAMPLES).map(move |i| (cosine(i), cosine(i + SAMPLES - 8)))
}

#[cfg(test)]
mod tests;
