//! Levenberg–Marquardt on the reduced system (Triggs, McLauchlan, Hartley and Fitzgibbon 2000,
//! "Bundle Adjustment: A Modern Synthesis").

use nalgebra::{DMatrix, DVector, Matrix2x3, Vector6};

use super::config::Config;
use super::covariance::Covariance;
use super::normal::{Chain, Layout, Loss, Normal, build, cost, lenses};
use super::pose::moved;
use super::problem::{AdjustError, PosePrior, Prior, Problem, View};
use super::scaling::unit_diagonal;

/// Median of the norm of a two-dimensional standard normal vector.
const RAYLEIGH_MEDIAN: f64 = 1.177_410_022_515_475;

/// Solution of a problem.
#[derive(Clone, Debug)]
pub struct Solution {
    /// The problem at the solution.
    pub problem: Problem,
    /// Half the sum of squared residuals in sigmas after the loss, priors included.
    pub cost: f64,
    /// Scale of the residuals in their own sigmas (median, over its expectation).
    pub scale: f64,
    /// Predicted minus observed pixel, by view and point; `None` for points that cannot be
    /// projected.
    pub residuals: Vec<Vec<Option<[f64; 2]>>>,
    /// Covariance of the free parameters, if requested.
    pub covariance: Option<Covariance>,
    /// Number of steps.
    pub steps: usize,
}

impl Solution {
    /// RMS residual, pixels, over the views selected by `of`.
    pub fn rms_px(&self, of: impl Fn(&View) -> bool) -> f64 {
        let views = self.problem.views.iter().zip(&self.residuals);
        let chosen = views
            .filter(|(view, _)| of(view))
            .flat_map(|(_, r)| r)
            .flatten();
        let (sum, count) = chosen.fold((0.0, 0usize), |(sum, count), [x, y]| {
            (sum + x * x + y * y, count + 1)
        });
        (sum / count.max(1) as f64).sqrt()
    }
}

/// Finds the most probable values.
///
/// # Errors
/// [`AdjustError`].
pub fn solve(problem: &Problem, config: &Config) -> Result<Solution, AdjustError> {
    let layout = Layout::new(problem);
    let mut problem = problem.clone();
    let mut loss = Loss {
        scale: 1.0,
        knee: config.huber_sigma,
        unprojected_sigma: config.unprojected_sigma,
    };
    let start = residuals(&problem);
    let all = problem.points();
    let seen = start.iter().flatten().flatten().count();
    if (seen as f64) < config.min_projected_ratio * all as f64 {
        return Err(AdjustError::Start { seen, all });
    }
    let mut steps = 0;
    for round in 0..3 {
        let residuals = residuals(&problem);
        loss.scale = scale(&problem, &layout, &residuals);
        // The first two rounds are approximate.
        let tolerance = if round == 2 {
            config.tolerance
        } else {
            config.first_tolerance
        };
        steps += descend(&mut problem, &layout, &loss, config, tolerance);
    }
    let residuals = residuals(&problem);
    loss.scale = scale(&problem, &layout, &residuals);
    let covariance = match config.covariance && layout.count > 0 {
        true => Some(Covariance::estimated(&problem, &layout, &loss)?),
        false => None,
    };
    Ok(Solution {
        cost: cost(&problem, &loss),
        scale: loss.scale,
        residuals,
        covariance,
        steps,
        problem,
    })
}

/// Normal equations of one instant, reduced by its pose (Schur complement).
#[derive(Clone, Debug)]
pub(crate) struct ReducedEquations {
    /// Indices among [`Problem::parameters`], ascending.
    pub(crate) columns: Vec<usize>,
    /// Gradient.
    pub(crate) score: DVector<f64>,
    /// Information matrix.
    pub(crate) information: DMatrix<f64>,
}

/// Reduced normal equations of every instant at the current values, with residuals scaled by
/// `scale` and the Huber threshold of the configuration.
pub(crate) fn reduced_equations(
    problem: &Problem,
    scale: f64,
    config: &Config,
) -> Vec<ReducedEquations> {
    let loss = Loss {
        scale,
        knee: config.huber_sigma,
        unprojected_sigma: config.unprojected_sigma,
    };
    let instant_blocks = build(problem, &Layout::new(problem), &loss, 0.0)
        .instant_blocks
        .into_iter();
    instant_blocks
        .map(|share| ReducedEquations {
            columns: share.columns,
            score: share.score,
            information: share.information,
        })
        .collect()
}

/// Jacobians of the pixels of a view with respect to its points, px/m; `None` for points that
/// cannot be projected.
pub(crate) fn by_points(problem: &Problem, view: &View) -> Vec<Option<Matrix2x3<f64>>> {
    let chain = Chain::new(problem, &lenses(problem), view);
    view.points
        .iter()
        .map(|p| chain.by_target(p.x_in_target))
        .collect()
}

/// Iterates until the cost hardly decreases; returns the number of steps.
fn descend(
    problem: &mut Problem,
    layout: &Layout,
    loss: &Loss,
    config: &Config,
    tolerance: f64,
) -> usize {
    let most = config.max_steps;
    let mut damping = config.initial_damping;
    let mut present = cost(problem, loss);
    for step in 0..most {
        let mut normal = build(problem, layout, loss, damping);
        let next = loop {
            let tried =
                free_step(&normal, damping).map(|by| changed(problem, layout, &normal, &by));
            let tried = tried.map(|tried| (cost(&tried, loss), tried));
            match tried {
                Some((cost, tried)) if cost <= present => break Some((cost, tried)),
                _ if damping >= config.max_damping => break None,
                _ => {
                    damping *= 10.0;
                    normal = build(problem, layout, loss, damping);
                }
            }
        };
        let Some((cost, tried)) = next else {
            return step;
        };
        let fell = (present - cost) / present.max(f64::MIN_POSITIVE);
        *problem = tried;
        present = cost;
        damping = (0.1 * damping).max(config.min_damping);
        if fell < tolerance {
            return step + 1;
        }
    }
    most
}

/// Step of the free parameters; `None` if the equations are singular.
fn free_step(normal: &Normal, damping: f64) -> Option<DVector<f64>> {
    let n = normal.gradient.len();
    if n == 0 {
        return Some(DVector::zeros(0));
    }
    let mut damped = normal.matrix.clone();
    for i in 0..n {
        damped[(i, i)] += damping * normal.matrix[(i, i)].abs() + f64::MIN_POSITIVE;
    }
    let (scaled, by) = unit_diagonal(&damped)?;
    let solution = scaled
        .cholesky()?
        .solve(&normal.gradient.component_mul(&by));
    Some(-solution.component_mul(&by))
}

/// The problem after a step.
fn changed(problem: &Problem, layout: &Layout, normal: &Normal, by: &DVector<f64>) -> Problem {
    let mut next = problem.clone();
    for (lens, columns) in next.lenses.iter_mut().zip(&layout.lenses) {
        let mut values = lens.model.parameters();
        for (value, column) in values.iter_mut().zip(columns) {
            *value += column.map_or(0.0, |c| by[c]);
        }
        lens.model = lens.model.with_parameters(&values);
    }
    for (place, column) in next.poses.iter_mut().zip(&layout.poses) {
        if let Some(c) = *column {
            let step = Vector6::from_fn(|k, _| by[c + k]);
            place.parent_from_child = moved(&place.parent_from_child, &step);
        }
    }
    for (pose, share) in next.instants.iter_mut().zip(&normal.instant_blocks) {
        let mut gradient = share.gradient;
        for (row, &c) in share.columns.iter().enumerate() {
            gradient += share.mixed.row(row).transpose() * by[c];
        }
        *pose = moved(pose, &-(share.inverse * gradient));
    }
    next
}

/// Predicted minus observed pixel.
fn residuals(problem: &Problem) -> Vec<Vec<Option<[f64; 2]>>> {
    let lenses = lenses(problem);
    let of = |view: &View| {
        let chain = Chain::new(problem, &lenses, view);
        let points = view.points.iter();
        points
            .map(|p| {
                let [x, y] = chain.pixel(p.x_in_target)?;
                Some([x - p.pixel[0], y - p.pixel[1]])
            })
            .collect()
    };
    problem.views.iter().map(of).collect()
}

/// Residual scale in sigmas, from the norms of the residuals in sigmas; 1 if empty.
pub(crate) fn median_scale(mut lengths: Vec<f64>) -> f64 {
    if lengths.is_empty() {
        return 1.0;
    }
    let middle = lengths.len() / 2;
    let (_, median, _) = lengths.select_nth_unstable_by(middle, f64::total_cmp);
    *median / RAYLEIGH_MEDIAN
}

/// Residual scale, in their own sigmas.
fn scale(problem: &Problem, layout: &Layout, residuals: &[Vec<Option<[f64; 2]>>]) -> f64 {
    let mut lengths = Vec::new();
    for (view, residuals) in problem.views.iter().zip(residuals) {
        for (point, residual) in view.points.iter().zip(residuals) {
            let [x, y] = residual.unwrap_or([f64::INFINITY; 2]);
            lengths.push(x.hypot(y) / point.sigma_px);
        }
    }
    let median = median_scale(lengths);
    // Fitted parameters absorb a part of the residuals.
    let with_prior = |prior: &Prior| !matches!(prior, Prior::Free);
    let lens_count = problem.lenses.iter().flat_map(|lens| &lens.priors);
    let place_count = problem.poses.iter();
    let fitted = 6 * layout.views.iter().filter(|v| !v.is_empty()).count()
        + lens_count.filter(|prior| !with_prior(prior)).count()
        + 6 * place_count.filter(|p| p.prior == PosePrior::Free).count();
    let equations = 2 * problem.points();
    let left = equations.saturating_sub(fitted).max(1);
    let scale = median * (equations as f64 / left as f64).sqrt();
    // Exact observations, as in tests, must not divide by 0.
    scale.clamp(1e-6, 1e6)
}
