//! How noisy a picture is and how sharp the borders of a board are.

use super::detect::Blur;
use super::image::GreyView;

/// Noise of a picture, grey values: the median size of a second difference along both axes, which
/// leaves slopes and straight borders out (Immerkær 1996; the median instead of the mean, so that
/// texture counts less). At least what rounding to whole grey values makes.
pub(super) fn noise(image: &GreyView<'_>) -> f64 {
    let mut counts = vec![0u32; 256 * 16];
    let mut total = 0u32;
    for y in (1..image.height().saturating_sub(1)).step_by(3) {
        let [a, b, c] = [y - 1, y, y + 1].map(|y| image.row(y));
        for x in (1..image.width().saturating_sub(1)).step_by(2) {
            let v = |row: &[u8], dx: usize| i32::from(row[x + dx - 1]);
            let along = |row: &[u8]| v(row, 0) - 2 * v(row, 1) + v(row, 2);
            // Saturated pixels have no noise to show.
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
    // The mask's weights have a root sum square of 6; half of normal values lie within 0.6745 sigma.
    (median as f64 / (6.0 * 0.6745)).max(0.3)
}

/// Borders shorter than this tell nothing of their blur, pixels.
const SHORTEST: f64 = 9.0;

/// Blur over all borders, given by their ends.
pub(super) fn measure(image: &GreyView<'_>, borders: &[[[f64; 2]; 2]]) -> Option<Blur> {
    // Least squares of width² = nᵀ S n over normals n: S has three numbers.
    let mut matrix = [[0.0f64; 3]; 3];
    let mut right = [0.0f64; 3];
    let mut count = 0;
    for [a, b] in borders {
        let along = [b[0] - a[0], b[1] - a[1]];
        let length = (along[0] * along[0] + along[1] * along[1]).sqrt();
        if length < SHORTEST {
            continue;
        }
        let normal = [-along[1] / length, along[0] / length];
        let reach = (0.35 * length).min(12.0);
        for t in [0.4, 0.5, 0.6] {
            let middle = [0, 1].map(|k| a[k] + t * along[k]);
            let Some(width) = width(image, middle, normal, reach) else {
                continue;
            };
            let [x, y] = normal;
            let row = [x * x, 2.0 * x * y, y * y];
            for i in 0..3 {
                for j in 0..3 {
                    matrix[i][j] += row[i] * row[j];
                }
                right[i] += row[i] * width * width;
            }
            count += 1;
        }
    }
    if count < 12 {
        return None;
    }
    let [xx, xy, yy] = solve(matrix, right)?;
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

/// Half the way from 16 % to 84 % of a step across a border.
fn width(image: &GreyView<'_>, middle: [f64; 2], normal: [f64; 2], reach: f64) -> Option<f64> {
    let steps = (4.0 * reach) as usize;
    let sample = |i: usize| {
        let o = 0.5 * i as f64 - reach;
        image.sample([0, 1].map(|k| middle[k] + o * normal[k]))
    };
    let values: Vec<f64> = (0..=steps).map(sample).collect::<Option<_>>()?;
    // The levels on both sides: the outer quarter of the profile.
    let outer = (values.len() / 4).max(2);
    let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
    let (low, high) = (
        mean(&values[..outer]),
        mean(&values[values.len() - outer..]),
    );
    if (high - low).abs() < 10.0 {
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

/// Three equations by Cramer's rule.
fn solve(m: [[f64; 3]; 3], b: [f64; 3]) -> Option<[f64; 3]> {
    let determinant = |m: [[f64; 3]; 3]| {
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1])
            - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    };
    let whole = determinant(m);
    let scale = m[0][0] + m[1][1] + m[2][2];
    if whole.abs() < 1e-6 * scale * scale * scale {
        return None;
    }
    Some([0, 1, 2].map(|k| {
        let mut replaced = m;
        for i in 0..3 {
            replaced[i][k] = b[i];
        }
        determinant(replaced) / whole
    }))
}
