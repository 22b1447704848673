//! The normal equations of lenses and constant poses, with the poses of the instants eliminated.

use std::num::NonZero;

use camera_models::{CameraModel, Lens};
use nalgebra::{DMatrix, DVector, Matrix2x3, Matrix6, MatrixXx6, SMatrix, Vector3, Vector6};

use super::pose::{Pose, step_between};
use super::problem::{PosePrior, Prior, Problem, View};

/// Number of work chunks, independent of the number of threads, so that sums are reproducible.
const CHUNKS: usize = 16;

/// Offset of each block in the vector of free parameters; `None` for fixed ones.
#[derive(Clone, Debug)]
pub(super) struct Layout {
    pub(super) lenses: Vec<Vec<Option<usize>>>,
    pub(super) poses: Vec<Option<usize>>,
    pub(super) count: usize,
    /// Views of each instant, by index.
    pub(super) views: Vec<Vec<usize>>,
}

/// Robust loss.
#[derive(Clone, Copy, Debug)]
pub(super) struct Loss {
    /// Common scale of the residuals, in their own sigmas.
    pub(super) scale: f64,
    /// Huber threshold, in sigmas.
    pub(super) knee: f64,
    /// Residual of a point that cannot be projected, in sigmas, so that steps that lose points are
    /// rejected.
    pub(super) unprojected_sigma: f64,
}

/// Contribution of one instant.
pub(super) struct InstantBlock {
    /// Inverse of the damped block of the pose.
    pub(super) inverse: Matrix6<f64>,
    /// Gradient of the pose.
    pub(super) gradient: Vector6<f64>,
    /// Block between the free parameters and the pose, only rows in `columns`.
    pub(super) mixed: MatrixXx6<f64>,
    /// Free parameters that its views depend on.
    pub(super) columns: Vec<usize>,
    /// Gradient of those with the pose eliminated: the instant's score.
    pub(super) score: DVector<f64>,
    /// Information matrix of those with the pose eliminated.
    pub(super) information: DMatrix<f64>,
}

/// Normal equations with the poses of all instants eliminated.
pub(super) struct Normal {
    pub(super) matrix: DMatrix<f64>,
    pub(super) gradient: DVector<f64>,
    pub(super) instant_blocks: Vec<InstantBlock>,
    pub(super) cost: f64,
}

impl Layout {
    pub(super) fn new(problem: &Problem) -> Self {
        let mut count = 0;
        let mut next = |n: usize| {
            count += n;
            count - n
        };
        let lenses = problem.lenses.iter().map(|lens| {
            let each = lens.priors.iter();
            each.map(|prior| (*prior != Prior::Fixed).then(|| next(1)))
                .collect()
        });
        let lenses = lenses.collect();
        let poses = problem.poses.iter();
        let poses = poses
            .map(|place| (place.prior != PosePrior::Fixed).then(|| next(6)))
            .collect();
        let mut views = vec![Vec::new(); problem.instants.len()];
        for (i, view) in problem.views.iter().enumerate() {
            views[view.instant].push(i);
        }
        Self {
            lenses,
            poses,
            count,
            views,
        }
    }

    /// The free parameters that a view depends on, in the order of its columns.
    fn columns(&self, view: &View) -> Vec<usize> {
        let lens = self.lenses[view.lens].iter().flatten().copied();
        let placed = view.path.iter().chain(&view.target);
        let placed = placed.filter_map(|&p| self.poses[p]);
        lens.chain(placed.flat_map(|begin| begin..begin + 6))
            .collect()
    }
}

impl Loss {
    /// Half the loss of a point that cannot be projected.
    pub(super) fn unprojected(&self) -> f64 {
        let sigma = self.unprojected_sigma;
        self.of(sigma * sigma * self.scale * self.scale).0
    }

    /// Half the loss and the weight for a squared residual in sigmas.
    pub(super) fn of(&self, square: f64) -> (f64, f64) {
        let s = square / (self.scale * self.scale);
        if s <= self.knee * self.knee {
            (0.5 * s, 1.0)
        } else {
            let r = s.sqrt();
            (self.knee * (r - 0.5 * self.knee), self.knee / r)
        }
    }
}

/// The chain of poses of a view at the current values.
pub(super) struct Chain {
    lens: Lens,
    world_from_target: Option<Pose>,
    rig_from_world: Pose,
    /// `parent_from_child` each, from the rig to the eye.
    path: Vec<Pose>,
}

impl Chain {
    pub(super) fn new(problem: &Problem, lenses: &[Lens], view: &View) -> Self {
        let place = |i: &usize| Pose::new(&problem.poses[*i].parent_from_child);
        Self {
            lens: lenses[view.lens],
            world_from_target: view.target.as_ref().map(place),
            rig_from_world: Pose::new(&problem.instants[view.instant]),
            path: view.path.iter().map(place).collect(),
        }
    }

    /// The point in the eye's frame, m.
    pub(super) fn in_eye(&self, x_in_target: [f64; 3]) -> Vector3<f64> {
        let x = Vector3::from(x_in_target);
        let x = self.world_from_target.map_or(x, |pose| pose.apply(&x));
        let mut x = self.rig_from_world.apply(&x);
        for pose in &self.path {
            x = pose.rotation.tr_mul(&(x - pose.translation));
        }
        x
    }

    /// Jacobian of the pixel with respect to the point in the target, px/m.
    pub(super) fn by_target(&self, x_in_target: [f64; 3]) -> Option<Matrix2x3<f64>> {
        let x_in_eye = self.in_eye(x_in_target);
        let mut by_point = self.lens.project_with_jacobians(x_in_eye.into())?.by_point;
        for pose in self.path.iter().rev() {
            by_point *= pose.rotation.transpose();
        }
        by_point *= self.rig_from_world.rotation;
        if let Some(pose) = &self.world_from_target {
            by_point *= pose.rotation;
        }
        Some(by_point)
    }

    pub(super) fn pixel(&self, x_in_target: [f64; 3]) -> Option<[f64; 2]> {
        self.lens.project(self.in_eye(x_in_target).into())
    }
}

/// Jacobians of one pixel, in the order: free parameters of the lens, poses of the path, pose of
/// the target, pose of the instant.
struct Row {
    residual: [f64; 2],
    lens: SMatrix<f64, 2, { CameraModel::MAX_PARAMETERS }>,
    path: Vec<SMatrix<f64, 2, 6>>,
    target: SMatrix<f64, 2, 6>,
    instant: SMatrix<f64, 2, 6>,
}

fn beside(a: &SMatrix<f64, 2, 3>, b: &SMatrix<f64, 2, 3>) -> SMatrix<f64, 2, 6> {
    let mut both = SMatrix::<f64, 2, 6>::zeros();
    both.fixed_view_mut::<2, 3>(0, 0).copy_from(a);
    both.fixed_view_mut::<2, 3>(0, 3).copy_from(b);
    both
}

impl Chain {
    fn row(&self, x_in_target: [f64; 3], pixel: [f64; 2]) -> Option<Row> {
        let x_in_target = Vector3::from(x_in_target);
        let rotated = self
            .world_from_target
            .map(|pose| pose.rotation * x_in_target);
        let x_in_world = match (&self.world_from_target, &rotated) {
            (Some(pose), Some(rotated)) => rotated + pose.translation,
            _ => x_in_target,
        };
        let rotated_to_rig = self.rig_from_world.rotation * x_in_world;
        let x_in_rig = rotated_to_rig + self.rig_from_world.translation;
        // Forward along the path; `arms` are the points from the child's origin, in the parent's
        // axes.
        let mut x = x_in_rig;
        let mut arms = Vec::with_capacity(self.path.len());
        for pose in &self.path {
            let arm = x - pose.translation;
            arms.push(arm);
            x = pose.rotation.tr_mul(&arm);
        }
        let projected = self.lens.project_with_jacobians(x.into())?;
        // Backward: Jacobian with respect to the point in ever earlier frames.
        let mut by_point = projected.by_point;
        let mut path = vec![SMatrix::zeros(); self.path.len()];
        for (i, (pose, arm)) in self.path.iter().zip(&arms).enumerate().rev() {
            let by_parent: SMatrix<f64, 2, 3> = by_point * pose.rotation.transpose();
            path[i] = beside(&-by_parent, &(by_parent * arm.cross_matrix()));
            by_point = by_parent;
        }
        let instant = beside(&by_point, &(-by_point * rotated_to_rig.cross_matrix()));
        let target = match &rotated {
            None => SMatrix::zeros(),
            Some(rotated) => {
                let by_world: SMatrix<f64, 2, 3> = by_point * self.rig_from_world.rotation;
                beside(&by_world, &(-by_world * rotated.cross_matrix()))
            }
        };
        Some(Row {
            residual: [projected.pixel[0] - pixel[0], projected.pixel[1] - pixel[1]],
            lens: projected.by_parameters,
            path,
            target,
            instant,
        })
    }
}

/// The weighted rows of a view, side by side: free parameters, pose, residual.
fn rows(
    problem: &Problem,
    layout: &Layout,
    lenses: &[Lens],
    view: &View,
    loss: &Loss,
) -> (DMatrix<f64>, f64) {
    let chain = Chain::new(problem, lenses, view);
    let lens_columns = &layout.lenses[view.lens];
    let free_places: Vec<bool> = view
        .path
        .iter()
        .map(|&p| layout.poses[p].is_some())
        .collect();
    let free_target = view.target.is_some_and(|t| layout.poses[t].is_some());
    let width = layout.columns(view).len();
    // Column by column in memory, so transposed: one column per equation.
    let mut all = DMatrix::zeros(width + 7, 2 * view.points.len());
    let mut cost = 0.0;
    for (n, point) in view.points.iter().enumerate() {
        let Some(row) = chain.row(point.x_in_target, point.pixel) else {
            cost += loss.unprojected();
            continue;
        };
        let [dx, dy] = row.residual;
        let (half, weight) = loss.of((dx * dx + dy * dy) / (point.sigma_px * point.sigma_px));
        cost += half;
        let root = weight.sqrt() / (point.sigma_px * loss.scale);
        for axis in 0..2 {
            let mut column = all.column_mut(2 * n + axis);
            let mut at = 0;
            let mut put = |values: &mut dyn Iterator<Item = f64>| {
                for value in values {
                    column[at] = value * root;
                    at += 1;
                }
            };
            let free = lens_columns.iter().enumerate().filter(|(_, c)| c.is_some());
            put(&mut free.map(|(k, _)| row.lens[(axis, k)]));
            for (free, by) in free_places.iter().zip(&row.path) {
                if *free {
                    put(&mut (0..6).map(|k| by[(axis, k)]));
                }
            }
            if free_target {
                put(&mut (0..6).map(|k| row.target[(axis, k)]));
            }
            put(&mut (0..6).map(|k| row.instant[(axis, k)]));
            put(&mut std::iter::once(row.residual[axis]));
        }
    }
    (all, cost)
}

/// Accumulated contributions of a chunk of instants.
struct Chunk {
    matrix: DMatrix<f64>,
    gradient: DVector<f64>,
    instant_blocks: Vec<InstantBlock>,
    cost: f64,
}

fn accumulate(
    problem: &Problem,
    layout: &Layout,
    lenses: &[Lens],
    loss: &Loss,
    damping: f64,
    instants: std::ops::Range<usize>,
) -> Chunk {
    let n = layout.count;
    let mut sum = Chunk {
        matrix: DMatrix::zeros(n, n),
        gradient: DVector::zeros(n),
        instant_blocks: Vec::with_capacity(instants.len()),
        cost: 0.0,
    };
    for instant in instants {
        let (share, cost) = share(problem, layout, lenses, loss, damping, instant);
        for (i, &ci) in share.columns.iter().enumerate() {
            sum.gradient[ci] += share.score[i];
            for (j, &cj) in share.columns.iter().enumerate() {
                sum.matrix[(ci, cj)] += share.information[(i, j)];
            }
        }
        sum.cost += cost;
        sum.instant_blocks.push(share);
    }
    sum
}

/// Contribution and cost of one instant.
fn share(
    problem: &Problem,
    layout: &Layout,
    lenses: &[Lens],
    loss: &Loss,
    damping: f64,
    instant: usize,
) -> (InstantBlock, f64) {
    let mut columns: Vec<usize> = Vec::new();
    let mut own = Matrix6::zeros();
    let mut gradient = Vector6::zeros();
    let mut parts = Vec::new();
    let mut cost_sum = 0.0;
    for &v in &layout.views[instant] {
        let view = &problem.views[v];
        let (rows, cost) = rows(problem, layout, lenses, view, loss);
        cost_sum += cost;
        let touched = layout.columns(view);
        let w = touched.len();
        let products = &rows * rows.transpose();
        own += products.fixed_view::<6, 6>(w, w);
        gradient += products.fixed_view::<6, 1>(w, w + 6);
        columns.extend(&touched);
        parts.push((touched, products));
    }
    columns.sort_unstable();
    columns.dedup();
    let n = columns.len();
    let mut mixed = MatrixXx6::zeros(n);
    let mut score = DVector::zeros(n);
    let mut information = DMatrix::zeros(n, n);
    for (touched, products) in &parts {
        let w = touched.len();
        let row_of = |c: &usize| {
            columns
                .binary_search(c)
                .expect("the union has every column")
        };
        let at: Vec<usize> = touched.iter().map(row_of).collect();
        for (i, &row) in at.iter().enumerate() {
            score[row] += products[(i, w + 6)];
            for (j, &column) in at.iter().enumerate() {
                information[(row, column)] += products[(i, j)];
            }
            for k in 0..6 {
                mixed[(row, k)] += products[(i, w + k)];
            }
        }
    }
    let mut damped = own;
    for k in 0..6 {
        damped[(k, k)] += damping * own[(k, k)] + f64::MIN_POSITIVE;
    }
    // An instant without a determined pose contributes nothing.
    let inverse = damped
        .cholesky()
        .map_or_else(Matrix6::zeros, |c| c.inverse());
    let through: MatrixXx6<f64> = &mixed * inverse;
    score -= &through * gradient;
    information -= &through * mixed.transpose();
    let share = InstantBlock {
        inverse,
        gradient,
        mixed,
        columns,
        score,
        information,
    };
    (share, cost_sum)
}

/// The normal equations at the current values. `damping` (Levenberg–Marquardt) is proportional to
/// the diagonal; here it applies to the poses, the caller adds it to the free parameters.
pub(super) fn build(problem: &Problem, layout: &Layout, loss: &Loss, damping: f64) -> Normal {
    let lenses = lenses(problem);
    let pieces = in_chunks(problem.instants.len(), |instants| {
        accumulate(problem, layout, &lenses, loss, damping, instants)
    });
    let n = layout.count;
    let mut normal = Normal {
        matrix: DMatrix::zeros(n, n),
        gradient: DVector::zeros(n),
        instant_blocks: Vec::with_capacity(problem.instants.len()),
        cost: 0.0,
    };
    for accumulate in pieces {
        normal.matrix += accumulate.matrix;
        normal.gradient += accumulate.gradient;
        normal.cost += accumulate.cost;
        normal.instant_blocks.extend(accumulate.instant_blocks);
    }
    add_priors(problem, layout, &mut normal);
    normal
}

/// The cost alone.
pub(super) fn cost(problem: &Problem, loss: &Loss) -> f64 {
    let lenses = lenses(problem);
    let of = |view: &View| -> f64 {
        let chain = Chain::new(problem, &lenses, view);
        let points = view.points.iter();
        points
            .map(|point| match chain.pixel(point.x_in_target) {
                None => loss.unprojected(),
                Some([x, y]) => {
                    let (dx, dy) = (x - point.pixel[0], y - point.pixel[1]);
                    loss.of((dx * dx + dy * dy) / (point.sigma_px * point.sigma_px))
                        .0
                }
            })
            .sum()
    };
    let pieces = in_chunks(problem.views.len(), |views| {
        problem.views[views].iter().map(of).sum::<f64>()
    });
    pieces.into_iter().sum::<f64>() + prior_cost(problem)
}

pub(super) fn lenses(problem: &Problem) -> Vec<Lens> {
    problem
        .lenses
        .iter()
        .map(|lens| Lens::new(&lens.model))
        .collect()
}

/// Runs over `0..count` in a fixed number of chunks, on one thread per core; results are in order.
pub(crate) fn in_chunks<T: Send>(
    count: usize,
    work: impl Fn(std::ops::Range<usize>) -> T + Sync,
) -> Vec<T> {
    let pieces = CHUNKS.min(count);
    let range = |i: usize| i * count / pieces..(i + 1) * count / pieces;
    let threads = std::thread::available_parallelism()
        .map_or(1, NonZero::get)
        .min(pieces);
    if threads <= 1 || count < 4 {
        return (0..pieces).map(|i| work(range(i))).collect();
    }
    let mut results: Vec<(usize, T)> = std::thread::scope(|scope| {
        let work = &work;
        let range = &range;
        let started: Vec<_> = (0..threads)
            .map(|t| {
                scope.spawn(move || {
                    let mine = (t..pieces).step_by(threads);
                    mine.map(|i| (i, work(range(i)))).collect::<Vec<_>>()
                })
            })
            .collect();
        started
            .into_iter()
            .flat_map(|thread| thread.join().expect("a thread without panics"))
            .collect()
    });
    results.sort_by_key(|(i, _)| *i);
    results.into_iter().map(|(_, result)| result).collect()
}

fn add_priors(problem: &Problem, layout: &Layout, normal: &mut Normal) {
    for (lens, columns) in problem.lenses.iter().zip(&layout.lenses) {
        let values = lens.model.parameters();
        for ((prior, column), value) in lens.priors.iter().zip(columns).zip(values) {
            if let (Prior::Near { mean, sigma }, Some(c)) = (prior, column) {
                let weight = 1.0 / (sigma * sigma);
                normal.matrix[(*c, *c)] += weight;
                normal.gradient[*c] += weight * (value - mean);
            }
        }
    }
    for (place, column) in problem.poses.iter().zip(&layout.poses) {
        if let (PosePrior::Near { mean, covariance }, Some(c)) = (&place.prior, column) {
            let information = information(covariance);
            let off = step_between(mean, &place.parent_from_child);
            let gradient = information * off;
            for i in 0..6 {
                normal.gradient[c + i] += gradient[i];
                for j in 0..6 {
                    normal.matrix[(c + i, c + j)] += information[(i, j)];
                }
            }
        }
    }
    normal.cost += prior_cost(problem);
}

/// A covariance that cannot be inverted contributes nothing.
fn information(covariance: &Matrix6<f64>) -> Matrix6<f64> {
    covariance
        .cholesky()
        .map_or_else(Matrix6::zeros, |c| c.inverse())
}

fn prior_cost(problem: &Problem) -> f64 {
    let lenses = problem.lenses.iter().flat_map(|lens| {
        let values = lens.model.parameters();
        let priors = lens.priors.clone();
        priors
            .into_iter()
            .zip(values)
            .map(|(prior, value)| match prior {
                Prior::Near { mean, sigma } => 0.5 * ((value - mean) / sigma).powi(2),
                Prior::Fixed | Prior::Free => 0.0,
            })
    });
    let poses = problem.poses.iter().map(|place| match &place.prior {
        PosePrior::Near { mean, covariance } => {
            let off = step_between(mean, &place.parent_from_child);
            0.5 * (off.transpose() * information(covariance) * off)[0]
        }
        PosePrior::Fixed | PosePrior::Free => 0.0,
    });
    lenses.chain(poses).sum()
}
