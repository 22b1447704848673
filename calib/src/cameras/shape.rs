//! Whether targets are flat.
//!
//! Contract: a target is taken to be bent only when the pictures prove it: its points are moved out of its
//! plane by `c₁ (u² - ⟨u²⟩) + c₂ (v² - ⟨v²⟩) + c₃ u v`, u and v from -1 to 1 over its corners, and everything is
//! adjusted again. Where that explains the pictures much better and the bend is not too small to matter, it
//! is kept. Sheets of paper on a board do this; wrinkles are not modelled.

use nalgebra::{Matrix3, Vector3};

use super::{AdjustError, Target};
use crate::adjust::{Problem, Settings, Solution, by_points, solve};

/// Rounds of bending and adjusting.
const ROUNDS: usize = 4;
/// The cost must fall by at least this (a tenth of it is a chance of 1 in 10^4 for three numbers) and by
/// at least this share.
const LEAST_FALL: (f64, f64) = (60.0, 0.01);
/// A bend of less than this between middle and rim is left alone, m.
const LEAST_SAGITTA_M: f64 = 2e-4;

/// Where a target's corners are in its own plane.
struct Extent {
    middle: [f64; 2],
    half: [f64; 2],
    mean: [f64; 2],
}

impl Extent {
    fn of(target: &Target) -> Self {
        let corners = target.corners();
        let range = |i: usize| {
            let values = corners.iter().map(|c| c.at_m[i]);
            values.fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| {
                (a.min(v), b.max(v))
            })
        };
        let (x, y) = (range(0), range(1));
        let middle = [0.5 * (x.0 + x.1), 0.5 * (y.0 + y.1)];
        let half = [0.5 * (x.1 - x.0), 0.5 * (y.1 - y.0)].map(|h| h.max(1e-6));
        let square = |i: usize| {
            let all = corners
                .iter()
                .map(|c| ((c.at_m[i] - middle[i]) / half[i]).powi(2));
            all.sum::<f64>() / corners.len().max(1) as f64
        };
        Self {
            middle,
            half,
            mean: [square(0), square(1)],
        }
    }

    fn shapes(&self, [x, y, _]: [f64; 3]) -> Vector3<f64> {
        let (u, v) = (
            (x - self.middle[0]) / self.half[0],
            (y - self.middle[1]) / self.half[1],
        );
        Vector3::new(u * u - self.mean[0], v * v - self.mean[1], u * v)
    }
}

/// The solution with bent targets where pictures prove them, and how high the middle of each is over its
/// rim. `of_view` names the target of each view.
pub(super) fn refine(
    solution: Solution,
    targets: &[Target],
    of_view: &[usize],
) -> Result<(Solution, Vec<f64>), AdjustError> {
    let extents: Vec<Extent> = targets.iter().map(Extent::of).collect();
    let quick = Settings {
        covariance: false,
        tolerance: 1e-6,
        ..Settings::default()
    };
    let mut bends = vec![Vector3::zeros(); targets.len()];
    let mut tried = solution.clone();
    for _ in 0..ROUNDS {
        let steps = steps(&tried, &extents, of_view);
        for (bend, step) in bends.iter_mut().zip(steps) {
            *bend += step;
        }
        let problem = bent(&tried.problem, &extents, of_view, &bends);
        tried = solve(&problem, &quick)?;
    }
    // Both in the sigmas of the better one.
    let fall = solution.cost * (solution.scale / tried.scale).powi(2) - tried.cost;
    let sagitta = |bend: &Vector3<f64>| -(bend.x + bend.y);
    let largest = |bend: &Vector3<f64>| bend.x.abs() + bend.y.abs() + bend.z.abs();
    let (least, share) = LEAST_FALL;
    let proven = fall > least && fall > share * tried.cost;
    let matter: Vec<bool> = bends
        .iter()
        .map(|b| proven && largest(b) > LEAST_SAGITTA_M)
        .collect();
    if !matter.contains(&true) {
        return Ok((solution, vec![0.0; targets.len()]));
    }
    for (bend, matters) in bends.iter_mut().zip(matter) {
        if !matters {
            *bend = Vector3::zeros();
        }
    }
    let problem = bent(&tried.problem, &extents, of_view, &bends);
    let solution = solve(&problem, &Settings::default())?;
    let sagitta = bends.iter().map(sagitta).collect();
    Ok((solution, sagitta))
}

fn bent(
    problem: &Problem,
    extents: &[Extent],
    of_view: &[usize],
    bends: &[Vector3<f64>],
) -> Problem {
    let mut problem = problem.clone();
    for (view, &target) in problem.views.iter_mut().zip(of_view) {
        for point in &mut view.points {
            point.x_in_target[2] = bends[target].dot(&extents[target].shapes(point.x_in_target));
        }
    }
    problem
}

/// By how much more each target is bent, everything else held.
fn steps(solution: &Solution, extents: &[Extent], of_view: &[usize]) -> Vec<Vector3<f64>> {
    let mut information = vec![Matrix3::<f64>::zeros(); extents.len()];
    let mut pull = vec![Vector3::zeros(); extents.len()];
    let views = solution
        .problem
        .views
        .iter()
        .zip(&solution.residuals)
        .zip(of_view);
    for ((view, residuals), &target) in views {
        let by = by_points(&solution.problem, view);
        for ((point, residual), by) in view.points.iter().zip(residuals).zip(by) {
            let (Some([dx, dy]), Some(by)) = (residual, by) else {
                continue;
            };
            let sigma = point.sigma_px * solution.scale;
            if dx.hypot(*dy) > 3.0 * sigma {
                continue;
            }
            let shapes = extents[target].shapes(point.x_in_target);
            let (jx, jy) = (by[(0, 2)], by[(1, 2)]);
            let weight = 1.0 / (sigma * sigma);
            information[target] += shapes * shapes.transpose() * (weight * (jx * jx + jy * jy));
            pull[target] -= shapes * (weight * (jx * dx + jy * dy));
        }
    }
    let solved = information.into_iter().zip(pull);
    solved
        .map(|(information, pull)| {
            information
                .cholesky()
                .map_or_else(Vector3::zeros, |c| c.solve(&pull))
        })
        .collect()
}
