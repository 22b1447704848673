//! Steps of analytic stairs: errors of those that edges have.

use terrain::edges::Edge;

use super::{CLEAN, Camera, GOING_M, Noise, RISE_M, Shot, climb, stairs};

/// Errors of a flight of stairs.
#[derive(Debug, Default)]
pub struct Score {
    pub expected: usize,
    pub found: usize,
    /// Of the heights of steps and places of edges, m, ascending.
    pub heights: Vec<f64>,
    pub places: Vec<f64>,
    /// Steps where there are none.
    pub invented: usize,
    /// Heights and places within two sigmas.
    pub within: usize,
}

/// Compares steps of edges across the path with the stairs of `count` risers.
pub fn score(edges: &[Edge], count: usize) -> Score {
    let mut score = Score {
        expected: count,
        ..Score::default()
    };
    let mut found = vec![false; count];
    for edge in edges {
        let [x, y, z] = edge.middle();
        let Some(step) = &edge.step else {
            continue;
        };
        // Sides of the stairs are steps as well.
        if y.abs() > 0.9 {
            continue;
        }
        let number = (x / GOING_M).round();
        let error = x - number * GOING_M;
        let true_z = (number + 1.0) * RISE_M;
        if error.abs() > 0.05 || (z - true_z).abs() > 0.05 || number < 0.0 || number >= count as f64
        {
            score.invented += 1;
            continue;
        }
        found[number as usize] = true;
        let height = step.height_m - RISE_M;
        score.within += usize::from(height.abs() <= 2.0 * step.sigma_m);
        score.within += usize::from(error.abs() <= 2.0 * edge.sigma_m);
        score.heights.push(height.abs());
        score.places.push(error.abs());
    }
    score.found = found.iter().filter(|found| **found).count();
    score.heights.sort_unstable_by(f64::total_cmp);
    score.places.sort_unstable_by(f64::total_cmp);
    score
}

pub fn p95(sorted: &[f64]) -> f64 {
    sorted[((0.95 * sorted.len() as f64) as usize).min(sorted.len() - 1)]
}

pub fn noise(disparity_px: f64, seed: u64) -> Noise {
    Noise {
        disparity_px,
        pose_m: 0.002,
        pose_rad: 0.001,
        seed,
        ..CLEAN
    }
}

pub fn walk(camera: Camera, steps: usize, up: bool, noise: Noise) -> Vec<Shot> {
    let camera = Camera {
        line_s: 10.8e-3 / camera.size[1] as f64,
        ..camera
    };
    let top = steps as f64 * GOING_M + 0.3;
    match up {
        true => climb(&stairs(steps), camera, [-0.8, top - 0.5], 1.05, noise),
        false => climb(&stairs(steps), camera, [top, -0.4], 1.25, noise),
    }
}

/// Scores of several walks as one.
pub fn total(scores: impl Iterator<Item = Score>) -> Score {
    let mut all = scores.fold(Score::default(), |mut all, score| {
        all.expected += score.expected;
        all.found += score.found;
        all.invented += score.invented;
        all.within += score.within;
        all.heights.extend(score.heights);
        all.places.extend(score.places);
        all
    });
    all.heights.sort_unstable_by(f64::total_cmp);
    all.places.sort_unstable_by(f64::total_cmp);
    all
}
