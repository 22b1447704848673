//! Subpixel refinement of a crossing of two borders.
//!
//! Contract: an image of two crossing straight borders is symmetric under half a turn about the
//! crossing. The refined position is the centre of best symmetry: it minimizes `Σ w (I(q) - I(2c -
//! q))²` over the pixels q of a round window, by Gauss–Newton steps.
//!
//! Symmetric blur, defocus, uniform camera motion, any tone curve and any tilt of the board
//! preserve that symmetry, so that none of them biases the position. Sources of bias are: a border
//! that the lens curves within the window, another corner inside it, the edge of a shadow.
//!
//! The usual equation of gradients that point past the corner (Förstner and Gülch 1987) under a
//! window that moves with it was tried first: if the blur is as wide as the window, its fixed point
//! is not stable (for an image `I = x y` a step doubles the distance), and real corners were lost.

use super::config::RefinementConfig;
use super::smooth::{Smooth, UNIT};
use fiducials::square::distance;

/// Maximum radius of any window, pixels: the size of its arrays.
const MAX_WINDOW_PX: f64 = 12.0;

/// Weights of the pixels around a crossing: `(1 - |M r|²)²` for the displacement r from the
/// crossing, which is smooth at its end.
#[derive(Clone, Copy, Debug)]
pub(super) struct Window {
    m: [[f32; 2]; 2],
    far: usize,
    config: RefinementConfig,
}

impl Window {
    /// A round window of radius `reach`.
    pub(super) fn round(reach: f64, config: &RefinementConfig) -> Self {
        let reach = reach.clamp(config.min_window_px, MAX_WINDOW_PX);
        let m = (1.0 / reach) as f32;
        Self {
            m: [[m, 0.0], [0.0, m]],
            far: reach.ceil() as usize,
            config: *config,
        }
    }

    /// The ellipse through `sides` and their opposites. A board in an oblique view has room along
    /// one axis where it has none along the other.
    pub(super) fn along(sides: [[f64; 2]; 2], widest: f64, config: &RefinementConfig) -> Self {
        let [a, b] = sides.map(|side| {
            let length = (side[0] * side[0] + side[1] * side[1]).sqrt();
            let reach = length.clamp(
                config.min_along_px,
                widest.clamp(config.min_window_px, MAX_WINDOW_PX),
            );
            side.map(|v| v * reach / length.max(f64::MIN_POSITIVE))
        });
        let determinant = a[0] * b[1] - a[1] * b[0];
        let product = ((a[0] * a[0] + a[1] * a[1]) * (b[0] * b[0] + b[1] * b[1])).sqrt();
        // Sides nearly on one line leave no ellipse.
        if determinant.abs() < config.min_side_sine * product {
            return Self::round(config.min_window_px, config);
        }
        let m = [[b[1], -b[0]], [-a[1], a[0]]].map(|row| row.map(|v| (v / determinant) as f32));
        let far = |k: usize| (a[k] * a[k] + b[k] * b[k]).sqrt();
        Self {
            m,
            far: far(0).max(far(1)).min(MAX_WINDOW_PX).ceil() as usize,
            config: *config,
        }
    }
}

/// Position of the crossing near `start`, under a window. `None` if it is further than `furthest`
/// from the start, too close to the image edge, or does not converge.
pub(super) fn refine_corner(
    smooth: &Smooth,
    start: [f64; 2],
    window: &Window,
    furthest: f64,
) -> Option<[f64; 2]> {
    let mut at = start;
    let config = &window.config;
    for i in 0..config.max_iterations {
        let to = step(smooth, at, window)?.to;
        let moved = distance(to, at);
        // A step that oscillates is too long.
        let share = if i < config.full_steps {
            1.0
        } else {
            config.late_step_ratio
        };
        at = [0, 1].map(|k| at[k] + share * (to[k] - at[k]));
        if distance(at, start) > furthest {
            return None;
        }
        if moved < config.convergence_px {
            return Some(at);
        }
    }
    None
}

/// As [`refine_corner`], to a few hundredths of a pixel.
pub(super) fn refine_coarsely(
    smooth: &Smooth,
    start: [f64; 2],
    window: &Window,
    furthest: f64,
) -> Option<[f64; 2]> {
    let mut at = start;
    for _ in 0..window.config.max_coarse_iterations {
        let to = step(smooth, at, window)?.to;
        let moved = distance(to, at);
        at = to;
        if distance(at, start) > furthest {
            return None;
        }
        if moved < window.config.coarse_convergence_px {
            break;
        }
    }
    Some(at)
}

/// Standard deviation of the position along its worst direction, pixels, for independent noise of
/// `noise` grey values: the inverse of the step matrix on both sides of the noise matrix.
pub(super) fn sigma(smooth: &Smooth, at: [f64; 2], window: &Window, noise: f64) -> Option<f64> {
    let Step {
        matrix: [a, b, c],
        noise: [p, q, r],
        ..
    } = step(smooth, at, window)?;
    let determinant = a * c - b * b;
    // inverse [c -b; -b a] / determinant, times [p q; q r], times the inverse
    let xx = c * c * p - 2.0 * b * c * q + b * b * r;
    let yy = b * b * p - 2.0 * a * b * q + a * a * r;
    let xy = -b * c * p + (a * c + b * b) * q - a * b * r;
    let largest = 0.5 * (xx + yy) + (0.25 * (xx - yy) * (xx - yy) + xy * xy).sqrt();
    Some(window.config.smoothed_noise_ratio * noise * largest.max(0.0).sqrt() / determinant)
}

/// Result of one step.
struct Step {
    /// New position.
    to: [f64; 2],
    /// xx, xy, yy of `Σ w g gᵀ`.
    matrix: [f64; 3],
    /// xx, xy, yy of `Σ w² g gᵀ`.
    noise: [f64; 3],
}

const SIDE: usize = 2 * MAX_WINDOW_PX as usize + 1;

/// One step, with the window at the current position.
fn step(smooth: &Smooth, at: [f64; 2], window: &Window) -> Option<Step> {
    let far = window.far;
    let side = 2 * far + 1;
    let centre = at.map(|v| v.round() as isize);
    // The mirror image of pixel centre + d is 2 at - centre - d: one fraction of a pixel for all.
    let mirror = [0, 1].map(|k| 2.0 * at[k] - centre[k] as f64);
    let base = mirror.map(|v| v.floor() as isize);
    let margin = far as isize + 2;
    for (c, size) in [
        (centre[0], smooth.width),
        (centre[1], smooth.height),
        (base[0], smooth.width),
        (base[1], smooth.height),
    ] {
        if c < margin || c + margin + 1 > size as isize {
            return None;
        }
    }
    let weights = [0, 1].map(|k| cubic((mirror[k] - base[k] as f64) as f32));
    // Interpolated along x, rows from the lowest needed; then along y below.
    let mut along_x = [[0.0f32; SIDE]; SIDE + 3];
    let width = smooth.width;
    let (left, top) = (
        (base[0] - far as isize - 1) as usize,
        (base[1] - far as isize - 1) as usize,
    );
    for (j, out) in along_x[..side + 3].iter_mut().enumerate() {
        let row = &smooth.values[(top + j) * width + left..][..side + 3];
        for (i, out) in out[..side].iter_mut().enumerate() {
            *out = (0..4).map(|k| weights[0][k] * f32::from(row[i + k])).sum();
        }
    }
    let [ox, oy] = [0, 1].map(|k| (at[k] - centre[k] as f64) as f32);
    let (mut xx, mut xy, mut yy, mut bx, mut by) = (0.0f32, 0.0f32, 0.0f32, 0.0f32, 0.0f32);
    let (mut nxx, mut nxy, mut nyy) = (0.0f32, 0.0f32, 0.0f32);
    for j in 0..side {
        let row = (centre[1] as usize + j - far) * width + centre[0] as usize - far;
        let ry = j as f32 - far as f32 - oy;
        for i in 0..side {
            let rx = i as f32 - far as f32 - ox;
            let [u, v] = window.m.map(|[a, b]| a * rx + b * ry);
            let w = 1.0 - (u * u + v * v);
            if w <= 0.0 {
                continue;
            }
            let w = w * w;
            let v = |i: usize| f32::from(smooth.values[i]);
            let gx = 0.5 * (v(row + i + 1) - v(row + i - 1));
            let gy = 0.5 * (v(row + i + width) - v(row + i - width));
            // Mirrored: the far end first.
            let (mi, mj) = (side - 1 - i, side - 1 - j);
            let other: f32 = (0..4).map(|k| weights[1][k] * along_x[mj + k][mi]).sum();
            let differs = v(row + i) - other;
            xx += w * gx * gx;
            xy += w * gx * gy;
            yy += w * gy * gy;
            bx += w * gx * differs;
            by += w * gy * differs;
            nxx += w * w * gx * gx;
            nxy += w * w * gx * gy;
            nyy += w * w * gy * gy;
        }
    }
    let unit = f64::from(UNIT * UNIT);
    let scaled = |v: [f32; 3]| v.map(|v| f64::from(v) * unit);
    let (matrix, noise, [bx, by, _]) = (
        scaled([xx, xy, yy]),
        scaled([nxx, nxy, nyy]),
        scaled([bx, by, 0.0]),
    );
    let [xx, xy, yy] = matrix;
    let determinant = xx * yy - xy * xy;
    // A single direction, or no gradient at all.
    let config = &window.config;
    if determinant <= config.min_determinant_ratio * (xx + yy) * (xx + yy)
        || xx + yy < config.min_trace
    {
        return None;
    }
    // I(q) - I(2c - q) changes by 2 g per step, since the gradient at the mirrored position is -g.
    let x = at[0] - 0.5 * (yy * bx - xy * by) / determinant;
    let y = at[1] - 0.5 * (xx * by - xy * bx) / determinant;
    Some(Step {
        to: [x, y],
        matrix,
        noise,
    })
}

/// Weights of four values at -1, 0, 1, 2 for the place `t` of 0..1 (Keys 1981, a = -1/2).
fn cubic(t: f32) -> [f32; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (-t3 + 2.0 * t2 - t),
        0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
        0.5 * (-3.0 * t3 + 4.0 * t2 + t),
        0.5 * (t3 - t2),
    ]
}
