//! Slope, step, roughness and traversability of cells.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::level::Level;
use crate::config::MapConfig;

/// Measures of a cell.
struct Measures {
    slope: f64,
    step: f64,
    roughness: f64,
}

/// Fills the layers of all cells with heights.
pub(super) fn measure(level: &mut Level, config: &MapConfig) {
    let of: Vec<Option<Measures>> = (0..level.flags.len())
        .into_par_iter()
        .map(|index| {
            level
                .has_height(index)
                .then(|| measures(level, index, config))
        })
        .collect();
    for (index, of) in of.iter().enumerate() {
        let Some(of) = of else {
            continue;
        };
        level.slope[index] = of.slope as f32;
        level.step[index] = of.step as f32;
        level.roughness[index] = of.roughness as f32;
        let shares = [
            1.0 - of.slope / config.max_slope_rad,
            1.0 - of.step / config.max_traversable_step_m,
            1.0 - of.roughness / config.max_roughness_m,
        ];
        let least = shares.into_iter().fold(1.0, f64::min);
        level.traversability[index] = least.max(0.0) as f32;
    }
}

fn measures(level: &Level, index: usize, config: &MapConfig) -> Measures {
    let [nx, ny, nz] = level.normal[index].map(f64::from);
    let z = f64::from(level.elevation[index]);
    let up = nz.max(0.05);
    let beyond_slope = |other: usize, [dx, dy]: [f64; 2]| {
        let expected = z - (nx * dx + ny * dy) / up;
        let heights = [level.lower[other], level.upper[other]];
        heights
            .map(|h| (f64::from(h) - expected).abs())
            .into_iter()
            .fold(0.0, f64::max)
    };
    let inside = f64::from(level.upper[index] - level.lower[index]);
    // The height range of the cell itself, without what its slope explains.
    let inside = (inside - level.cell_m * (nx.hypot(ny) / up) * 1.5).max(0.0);
    let step = level
        .near(index, config.step_radius_m)
        .map(|(other, offset)| beyond_slope(other, offset))
        .fold(inside, f64::max);
    Measures {
        slope: libm::acos(nz.clamp(-1.0, 1.0)),
        step,
        roughness: roughness(level, index, config.roughness_radius_m),
    }
}

/// Root mean square distance of heights from their plane of least squares, m.
fn roughness(level: &Level, index: usize, radius_m: f64) -> f64 {
    let z = f64::from(level.elevation[index]);
    let points = level
        .near(index, radius_m)
        .map(|(other, [dx, dy])| [dx, dy, f64::from(level.elevation[other]) - z])
        .chain([[0.0; 3]]);
    let (mut matrix, mut right) = (Matrix3::zeros(), Vector3::zeros());
    let (mut square, mut count) = (0.0, 0.0);
    for [dx, dy, dz] in points {
        let at = Vector3::new(1.0, dx, dy);
        matrix += at * at.transpose();
        right += at * dz;
        square += dz * dz;
        count += 1.0;
    }
    // Three points have a plane of their own.
    if count < 4.0 {
        return 0.0;
    }
    let explained = matrix
        .try_inverse()
        .map_or(0.0, |inverse| right.dot(&(inverse * right)));
    (f64::max(square - explained, 0.0) / count).sqrt()
}
