//! Pose of a single eye from known points, everything else fixed.
//!
//! Same cost and method as the full adjustment, without its bookkeeping: this runs for every image
//! of a recording.

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Lens};
use nalgebra::{Matrix6, SMatrix, Vector3, Vector6};

use super::config::LocateConfig;
use super::normal::Loss;
use super::pose::{Pose, moved};
use super::problem::{AdjustError, Point};

/// Minimum scale: exact observations must not divide by 0.
const MIN_SCALE: f64 = 1e-6;

/// Pose of an eye from its observation of these points, and the RMS residual, px.
///
/// # Errors
/// [`AdjustError::Start`].
pub fn locate(
    model: &CameraModel,
    points: &[Point],
    start_eye_from_target: &RigidTransform,
    config: &LocateConfig,
) -> Result<(RigidTransform, f64), AdjustError> {
    let lens = Lens::new(model);
    let mut pose = *start_eye_from_target;
    let seen = residuals(&lens, points, &pose).iter().flatten().count();
    if (seen as f64) < config.min_projected_ratio * points.len() as f64 || seen == 0 {
        let all = points.len();
        return Err(AdjustError::Start { seen, all });
    }
    for _ in 0..2 {
        let loss = Loss {
            scale: scale(points, &residuals(&lens, points, &pose)),
            knee: config.huber_sigma,
            unprojected_sigma: config.unprojected_sigma,
        };
        pose = descend(&lens, points, pose, &loss, config);
    }
    let left = residuals(&lens, points, &pose);
    let (sum, count) = left
        .iter()
        .flatten()
        .fold((0.0, 0usize), |(sum, n), [x, y]| {
            (sum + x * x + y * y, n + 1)
        });
    Ok((pose, (sum / count.max(1) as f64).sqrt()))
}

fn residuals(lens: &Lens, points: &[Point], pose: &RigidTransform) -> Vec<Option<[f64; 2]>> {
    let pose = Pose::new(pose);
    let of = |p: &Point| {
        let [x, y] = lens.project(pose.apply(&Vector3::from(p.x_in_target)).into())?;
        Some([x - p.pixel[0], y - p.pixel[1]])
    };
    points.iter().map(of).collect()
}

/// Median residual scale of the points, in their own sigmas.
fn scale(points: &[Point], residuals: &[Option<[f64; 2]>]) -> f64 {
    let lengths = residuals.iter().zip(points);
    let lengths = lengths.map(|(r, p)| r.map_or(f64::INFINITY, |[x, y]| x.hypot(y)) / p.sigma_px);
    super::solve::median_scale(lengths.collect()).max(MIN_SCALE)
}

fn cost(
    lens: &Lens,
    points: &[Point],
    pose: &RigidTransform,
    loss: &Loss,
    config: &LocateConfig,
) -> f64 {
    let residuals = residuals(lens, points, pose);
    let of = |(r, p): (Option<[f64; 2]>, &Point)| match r {
        None => {
            loss.of(config.unprojected_sigma * config.unprojected_sigma * loss.scale * loss.scale)
                .0
        }
        Some([x, y]) => loss.of((x * x + y * y) / (p.sigma_px * p.sigma_px)).0,
    };
    residuals.into_iter().zip(points).map(of).sum()
}

fn descend(
    lens: &Lens,
    points: &[Point],
    mut pose: RigidTransform,
    loss: &Loss,
    config: &LocateConfig,
) -> RigidTransform {
    let mut present = cost(lens, points, &pose, loss, config);
    let mut damping = config.initial_damping;
    for _ in 0..config.max_steps {
        let (matrix, gradient) = normal(lens, points, &pose, loss);
        let next = loop {
            let mut damped = matrix;
            for k in 0..6 {
                damped[(k, k)] += damping * matrix[(k, k)] + f64::MIN_POSITIVE;
            }
            let tried = damped
                .cholesky()
                .map(|c| moved(&pose, &-c.solve(&gradient)));
            let tried = tried.map(|tried| (cost(lens, points, &tried, loss, config), tried));
            match tried {
                Some((cost, tried)) if cost <= present => break Some((cost, tried)),
                _ if damping > config.max_damping => break None,
                _ => damping *= 10.0,
            }
        };
        let Some((cost, tried)) = next else { break };
        let fell = (present - cost) / present.max(f64::MIN_POSITIVE);
        (pose, present) = (tried, cost);
        damping = (0.1 * damping).max(config.min_damping);
        if fell < config.tolerance {
            break;
        }
    }
    pose
}

fn normal(
    lens: &Lens,
    points: &[Point],
    pose: &RigidTransform,
    loss: &Loss,
) -> (Matrix6<f64>, Vector6<f64>) {
    let pose = Pose::new(pose);
    let (mut matrix, mut gradient) = (Matrix6::zeros(), Vector6::zeros());
    for point in points {
        let rotated = pose.rotation * Vector3::from(point.x_in_target);
        let at = rotated + pose.translation;
        let Some(projected) = lens.project_with_jacobians(at.into()) else {
            continue;
        };
        let (dx, dy) = (
            projected.pixel[0] - point.pixel[0],
            projected.pixel[1] - point.pixel[1],
        );
        let information = 1.0 / (point.sigma_px * point.sigma_px);
        let weight = loss.of((dx * dx + dy * dy) * information).1;
        let weight = weight * information / (loss.scale * loss.scale);
        let mut by = SMatrix::<f64, 2, 6>::zeros();
        by.fixed_view_mut::<2, 3>(0, 0)
            .copy_from(&projected.by_point);
        let by_turn = -projected.by_point * rotated.cross_matrix();
        by.fixed_view_mut::<2, 3>(0, 3).copy_from(&by_turn);
        matrix += by.transpose() * by * weight;
        gradient += by.transpose() * nalgebra::Vector2::new(dx, dy) * weight;
    }
    (matrix, gradient)
}
