//! KLT tracking of a patch from one image to another.
//!
//! Iterative image alignment by translation (Lucas and Kanade 1981, in the inverse compositional
//! form of Baker and Matthews 2004), coarse to fine, on patches normalized to mean 0 and equal
//! contrast, so that the exposure may differ. A result must pass the forward–backward check.

use super::config::KltConfig;
use super::pyramid::{Level, Pyramid};

/// Radius of a patch.
const RADIUS: usize = 5;
const SIDE: usize = 2 * RADIUS + 1;
const AREA: usize = SIDE * SIDE;
/// Side with one more pixel all around, for gradients.
const PADDED_SIDE: usize = SIDE + 2;

/// A patch with the quantities needed for alignment.
struct Template {
    values: [f32; AREA],
    gx: [f32; AREA],
    gy: [f32; AREA],
    /// Inverse of the second moments.
    inverse: [f32; 3],
    /// Norm of the patch.
    norm: f32,
}

impl Template {
    fn new(level: &Level, x: f32, y: f32, config: &KltConfig) -> Option<Self> {
        let mut wide = [0.0; PADDED_SIDE * PADDED_SIDE];
        if !level.patch(x, y, RADIUS + 1, &mut wide) {
            return None;
        }
        let mut new = Self {
            values: [0.0; AREA],
            gx: [0.0; AREA],
            gy: [0.0; AREA],
            inverse: [0.0; 3],
            norm: 0.0,
        };
        let (mut a, mut b, mut c) = (0.0, 0.0, 0.0);
        for row in 0..SIDE {
            for column in 0..SIDE {
                let (i, w) = (row * SIDE + column, (row + 1) * PADDED_SIDE + column + 1);
                new.values[i] = wide[w];
                let gx = 0.5 * (wide[w + 1] - wide[w - 1]);
                let gy = 0.5 * (wide[w + PADDED_SIDE] - wide[w - PADDED_SIDE]);
                (new.gx[i], new.gy[i]) = (gx, gy);
                a += gx * gx;
                b += gx * gy;
                c += gy * gy;
            }
        }
        new.norm = centre(&mut new.values);
        let determinant = a * c - b * b;
        if determinant <= config.min_determinant_ratio * (a + c) * (a + c) || new.norm < 1.0 {
            return None;
        }
        new.inverse = [c / determinant, -b / determinant, a / determinant];
        Some(new)
    }

    /// Aligns the template from a start position in the other level. Returns position and
    /// correlation.
    fn align(
        &self,
        level: &Level,
        mut x: f32,
        mut y: f32,
        config: &KltConfig,
    ) -> Option<([f32; 2], f32)> {
        let least = config.convergence_px;
        let mut patch = [0.0; AREA];
        for step in 0.. {
            if !level.patch(x, y, RADIUS, &mut patch) {
                return None;
            }
            let norm = centre(&mut patch);
            if norm < 1e-3 {
                return None;
            }
            let gain = self.norm / norm;
            let (mut ex, mut ey, mut product) = (0.0, 0.0, 0.0);
            for (i, (&here, &there)) in patch.iter().zip(&self.values).enumerate() {
                let error = here * gain - there;
                ex += self.gx[i] * error;
                ey += self.gy[i] * error;
                product += here * there;
            }
            let alike = product / (norm * self.norm);
            let dx = self.inverse[0] * ex + self.inverse[1] * ey;
            let dy = self.inverse[1] * ex + self.inverse[2] * ey;
            if step == config.max_iterations || dx * dx + dy * dy < least * least {
                return Some(([x, y], alike));
            }
            // A step longer than the patch means that nothing fits.
            let length = (dx * dx + dy * dy).sqrt();
            let most = (0.5 * RADIUS as f32 / length).min(1.0);
            x -= dx * most;
            y -= dy * most;
        }
        None
    }
}

/// Removes the mean; returns the norm.
fn centre(values: &mut [f32; AREA]) -> f32 {
    let mean = values.iter().sum::<f32>() / AREA as f32;
    let mut square = 0.0;
    for value in values {
        *value -= mean;
        square += *value * *value;
    }
    square.sqrt()
}

/// Tracks a position of `from` into `to`, pixels of the first level, from `guess` on the level
/// `coarsest`.
pub(super) fn track(
    from: &Pyramid,
    to: &Pyramid,
    at: [f32; 2],
    guess: [f32; 2],
    coarsest: usize,
    config: &KltConfig,
) -> Option<[f32; 2]> {
    let (found, alike) = track_forward(from, to, at, guess, coarsest, config)?;
    if alike < config.min_ncc {
        return None;
    }
    // The backward search starts nearby, since it only has to detect a slip; from the far guess it
    // would cost as much again.
    let back = [
        at[0] + (guess[0] - found[0]).clamp(-1.0, 1.0),
        at[1] + (guess[1] - found[1]).clamp(-1.0, 1.0),
    ];
    let (back, _) = track_forward(to, from, found, back, 0, config)?;
    let off = (back[0] - at[0]).hypot(back[1] - at[1]);
    (off < config.max_forward_backward_px).then_some(found)
}

fn track_forward(
    from: &Pyramid,
    to: &Pyramid,
    at: [f32; 2],
    guess: [f32; 2],
    coarsest: usize,
    config: &KltConfig,
) -> Option<([f32; 2], f32)> {
    let mut offset = [guess[0] - at[0], guess[1] - at[1]];
    let mut found = None;
    for level in (0..=coarsest.min(from.levels.len() - 1)).rev() {
        let scale = (1_u32 << level) as f32;
        let [x, y] = at.map(|v| v / scale);
        // A coarse level may not reach as close to the border.
        let aligned = Template::new(&from.levels[level], x, y, config).and_then(|template| {
            let (u, v) = (x + offset[0] / scale, y + offset[1] / scale);
            template.align(&to.levels[level], u, v, config)
        });
        match aligned {
            Some(([u, v], alike)) => {
                offset = [(u - x) * scale, (v - y) * scale];
                found = (level == 0).then_some(([u, v], alike));
            }
            None if level == 0 => return None,
            None => {}
        }
    }
    found
}
