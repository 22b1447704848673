//! Shape of the targets: departure from a plane.
//!
//! Contract: a target is taken as curved only if the images prove it. Its points are moved out of
//! its plane by `c₁ (u² - ⟨u²⟩) + c₂ (v² - ⟨v²⟩) + c₃ u v`, u and v from -1 to 1 over its corners,
//! and the bundle adjustment is repeated. The shape is used if it explains the observations much
//! better and is large enough to matter. Sheets of paper on a board have this shape; wrinkles are
//! not modelled.

use boards::Target;
use nalgebra::{Matrix3, Vector3};

use super::config::{BoardShapeConfig, Config};
use crate::adjust::{AdjustError, Problem, Solution, by_points, solve};

/// Extent of a target's corners in its own plane.
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

/// The solution with curved targets where the images prove them, and the sagitta of each target (z
/// of its middle minus z of its rim, m). `of_view` is the target of each view.
pub(super) fn refine(
    solution: Solution,
    targets: &[Target],
    of_view: &[usize],
    config: &Config,
) -> Result<(Solution, Vec<f64>), AdjustError> {
    let extents: Vec<Extent> = targets.iter().map(Extent::of).collect();
    let quick = config.solver.approximate();
    let shape = &config.board_shape;
    let mut shapes_m = vec![Vector3::zeros(); targets.len()];
    let mut refined = solution.clone();
    for _ in 0..shape.rounds {
        let shape_steps = shape_steps(&refined, &extents, of_view, shape);
        for (shape_m, step) in shapes_m.iter_mut().zip(shape_steps) {
            *shape_m += step;
        }
        let problem = with_board_shape(&refined.problem, &extents, of_view, &shapes_m);
        refined = solve(&problem, &quick)?;
    }
    // Both costs in the sigmas of the better solution.
    let decrease = solution.cost * (solution.scale / refined.scale).powi(2) - refined.cost;
    let sagitta = |shape: &Vector3<f64>| -(shape.x + shape.y);
    let largest = |shape: &Vector3<f64>| shape.x.abs() + shape.y.abs() + shape.z.abs();
    let proven = decrease > shape.min_cost_decrease
        && decrease > shape.min_cost_decrease_ratio * refined.cost;
    let significant: Vec<bool> = shapes_m
        .iter()
        .map(|b| proven && largest(b) > shape.min_sagitta_m)
        .collect();
    if !significant.contains(&true) {
        return Ok((solution, vec![0.0; targets.len()]));
    }
    for (shape, matters) in shapes_m.iter_mut().zip(significant) {
        if !matters {
            *shape = Vector3::zeros();
        }
    }
    let problem = with_board_shape(&refined.problem, &extents, of_view, &shapes_m);
    let solution = solve(&problem, &config.solver)?;
    let sagitta = shapes_m.iter().map(sagitta).collect();
    Ok((solution, sagitta))
}

fn with_board_shape(
    problem: &Problem,
    extents: &[Extent],
    of_view: &[usize],
    shapes_m: &[Vector3<f64>],
) -> Problem {
    let mut problem = problem.clone();
    for (view, &target) in problem.views.iter_mut().zip(of_view) {
        for point in &mut view.points {
            point.x_in_target[2] = shapes_m[target].dot(&extents[target].shapes(point.x_in_target));
        }
    }
    problem
}

/// Update of each target's shape with everything else fixed.
fn shape_steps(
    solution: &Solution,
    extents: &[Extent],
    of_view: &[usize],
    config: &BoardShapeConfig,
) -> Vec<Vector3<f64>> {
    let mut information = vec![Matrix3::<f64>::zeros(); extents.len()];
    let mut gradient = vec![Vector3::zeros(); extents.len()];
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
            if dx.hypot(*dy) > config.outlier_sigma * sigma {
                continue;
            }
            let shapes = extents[target].shapes(point.x_in_target);
            let (jx, jy) = (by[(0, 2)], by[(1, 2)]);
            let weight = 1.0 / (sigma * sigma);
            information[target] += shapes * shapes.transpose() * (weight * (jx * jx + jy * jy));
            gradient[target] -= shapes * (weight * (jx * dx + jy * dy));
        }
    }
    let solved = information.into_iter().zip(gradient);
    solved
        .map(|(information, gradient)| {
            information
                .cholesky()
                .map_or_else(Vector3::zeros, |c| c.solve(&gradient))
        })
        .collect()
}
