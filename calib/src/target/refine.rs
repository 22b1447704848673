//! Where exactly two borders cross.
//!
//! Contract: the place where all border pixels' gradients point past: it minimises
//! `Σ w |g · (q - c)|²` over pixels q with gradient g under a round window w that moves with c
//! (Förstner and Gülch 1987; OpenCV's cornerSubPix solves the same equation under a square window).
//!
//! Around a crossing of two straight borders a picture is the same after half a turn. That survives any
//! symmetric blur, any tone curve and any tilt of the board; contributions of opposite pixels then cancel
//! exactly at the crossing, so the place has no bias from them. What breaks it: a curved border (a lens with
//! much distortion under a wide window), another corner inside the window, a shadow's edge.

use super::image::{Smooth, UNIT};
use super::square::distance;

/// The narrowest window that still holds enough pixels around a crossing, pixels from its middle to its end.
pub(super) const NARROWEST: f64 = 2.6;
/// Steps after which the place must have settled.
const MOST_STEPS: usize = 12;
/// A smaller step ends the search, pixels.
const SETTLED: f64 = 2e-4;

/// Where the crossing near `start` is, under a window that ends `reach` pixels away. None where it
/// is further than `furthest` from the start, too near the edge, or there is no crossing of two directions.
pub(super) fn settle(smooth: &Smooth, start: [f64; 2], reach: f64, furthest: f64) -> Option<[f64; 2]> {
    let mut at = start;
    for _ in 0..MOST_STEPS {
        let next = step(smooth, at, reach)?.to;
        let moved = distance(next, at);
        at = next;
        if distance(at, start) > furthest {
            return None;
        }
        if moved < SETTLED {
            break;
        }
    }
    Some(at)
}

/// Standard deviation of the place along its worst direction, pixels, when every grey value has an
/// independent error of `noise` grey values.
///
/// With r from the crossing to the pixel, an error n of the gradient g adds `w (n (g · r) + g (n · r))` to the
/// right-hand side; the inverse of the matrix on both sides takes that to the place. Errors of neighbouring
/// gradients are not independent; [`NOISE_IN_GRADIENT`] stands for that too.
pub(super) fn sigma(smooth: &Smooth, at: [f64; 2], reach: f64, noise: f64) -> Option<f64> {
    let Step { matrix: [a, b, c], noise: [p, q, r], .. } = step(smooth, at, reach)?;
    let determinant = a * c - b * b;
    // inverse [c -b; -b a] / determinant, times [p q; q r], times the inverse
    let xx = c * c * p - 2.0 * b * c * q + b * b * r;
    let yy = b * b * p - 2.0 * a * b * q + a * a * r;
    let xy = -b * c * p + (a * c + b * b) * q - a * b * r;
    let largest = 0.5 * (xx + yy) + (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
    Some(NOISE_IN_GRADIENT * noise * largest.max(0.0).sqrt() / determinant)
}

/// What one grey value of noise per pixel does to a gradient behind the binomial filter, with the
/// correlation of neighbours: measured, see the test `stated_sigma_is_what_happens`.
const NOISE_IN_GRADIENT: f64 = 0.5;

/// What the pixels in a window say.
struct Step {
    /// Where the crossing is.
    to: [f64; 2],
    /// xx, xy, yy of `Σ w g gᵀ`.
    matrix: [f64; 3],
    /// xx, xy, yy of the right-hand side's covariance per unit variance of a gradient.
    noise: [f64; 3],
}

/// One step, with the window here.
fn step(smooth: &Smooth, at: [f64; 2], reach: f64) -> Option<Step> {
    let far = reach.ceil() as isize;
    let (cx, cy) = (at[0].round() as isize, at[1].round() as isize);
    let inside = |c: isize, size: usize| c - far >= 1 && c + far + 1 < size as isize;
    if !inside(cx, smooth.width) || !inside(cy, smooth.height) {
        return None;
    }
    let width = smooth.width;
    // The window falls off as (1 - r²/R²)², which is smooth at its end, unlike a cut Gaussian.
    let end = 1.0 / (reach * reach) as f32;
    let [ox, oy] = [(at[0] - cx as f64) as f32, (at[1] - cy as f64) as f32];
    let (mut xx, mut xy, mut yy, mut bx, mut by) = (0.0f32, 0.0f32, 0.0f32, 0.0f32, 0.0f32);
    let (mut nxx, mut nxy, mut nyy) = (0.0f32, 0.0f32, 0.0f32);
    for dy in -far..=far {
        let row = (cy + dy) as usize * width;
        let ry = dy as f32 - oy;
        for dx in -far..=far {
            let rx = dx as f32 - ox;
            let w = 1.0 - (rx * rx + ry * ry) * end;
            if w <= 0.0 {
                continue;
            }
            let w = w * w;
            let i = row + (cx + dx) as usize;
            let v = |i: usize| f32::from(smooth.values[i]);
            let gx = v(i + 1) - v(i - 1);
            let gy = v(i + width) - v(i - width);
            let past = gx * rx + gy * ry;
            xx += w * gx * gx;
            xy += w * gx * gy;
            yy += w * gy * gy;
            bx += w * gx * past;
            by += w * gy * past;
            let (own, r2) = (w * w * past * past, w * w * (rx * rx + ry * ry));
            nxx += own + r2 * gx * gx;
            nxy += r2 * gx * gy;
            nyy += own + r2 * gy * gy;
        }
    }
    let unit = f64::from(0.25 * UNIT * UNIT);
    let scaled = |v: [f32; 3]| v.map(|v| f64::from(v) * unit);
    let (matrix, noise, [bx, by, _]) = (scaled([xx, xy, yy]), scaled([nxx, nxy, nyy]), scaled([bx, by, 0.0]));
    let [xx, xy, yy] = matrix;
    let determinant = xx * yy - xy * xy;
    // One direction only, or nothing at all.
    if determinant <= 0.003 * (xx + yy) * (xx + yy) || xx + yy < 1.0 {
        return None;
    }
    let x = at[0] + (yy * bx - xy * by) / determinant;
    let y = at[1] + (xx * by - xy * bx) / determinant;
    Some(Step { to: [x, y], matrix, noise })
}
