//! One view of the board: the camera pose and its information.
//!
//! With known lenses, a view constrains the rest of the problem only by the pose of the left
//! optical frame and the size of the board. [`View::linearise`] reduces its corners, about a
//! hundred, to a quadric in seven parameters; the cost of the joint problem then does not depend on
//! the number of corners. The view is linearized again after the joint solution, so that nothing is
//! lost.

use camera_models::Eye;
use nalgebra::{Matrix3, SMatrix, SVector, SymmetricEigen, Vector2, Vector3};

use super::config::ViewConfig;
use super::recording::{Cameras, Corner};
use super::so3;

/// Parameters of a view: small rotation 3, translation in the target's frame 3, size of the board.
pub(super) const VIEW: usize = 7;

/// Median of the norm of a two-dimensional standard normal vector.
const RAYLEIGH_MEDIAN: f64 = 1.177_41;

/// A pose: takes coordinates in the left optical frame to the target's.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pose {
    pub rotation: Matrix3<f64>,
    pub position: Vector3<f64>,
}

/// Quadratic approximation of a view's cost near a pose: `e(x) = e(0) + 2 g'x + x'Hx`.
#[derive(Clone, Debug)]
pub(super) struct Quadric {
    /// Linearization point.
    pub pose: Pose,
    pub board_scale: f64,
    pub information: SMatrix<f64, VIEW, VIEW>,
    pub gradient: SVector<f64, VIEW>,
    /// Number of inlier corners.
    pub corners: usize,
}

/// Residuals of the corners at a pose.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Fit {
    pub corners: usize,
    /// Number of outlier corners.
    pub outliers: usize,
    /// Sum over the inliers of the squared error over its nominal variance.
    pub squares: f64,
    /// Median norm of an error over its sigma, relative to that of a normal distribution.
    pub scale: f64,
}

/// A view of the board.
pub(super) struct View<'a> {
    pub config: ViewConfig,
    pub time_s: f64,
    pub time_ns: i64,
    pub corners: &'a [Corner],
    /// Number of inliers of its own pose.
    pub inlier_corners: usize,
    /// Camera motion, for a rolling shutter.
    pub motion: CameraMotion,
}

/// Motion of the left camera.
#[derive(Clone, Copy, Debug)]
pub(super) struct CameraMotion {
    /// Angular rate in its own axes, rad/s.
    pub rate: Vector3<f64>,
    /// Velocity in the target's frame, m/s.
    pub velocity: Vector3<f64>,
}

impl CameraMotion {
    pub(super) const NONE: Self = Self {
        rate: Vector3::new(0.0, 0.0, 0.0),
        velocity: Vector3::new(0.0, 0.0, 0.0),
    };
}

struct Linear {
    residual: Vector2<f64>,
    by_view: SMatrix<f64, 2, VIEW>,
}

impl View<'_> {
    /// Pose at mid-exposure of a corner's row.
    fn at_row(&self, cameras: &Cameras, pose: &Pose, c: &Corner) -> Pose {
        if cameras.line_s == 0.0 {
            return *pose;
        }
        let rows = f64::from(cameras.left.model().height);
        let row_delay_s = cameras.line_s * (c.pixel[1] - 0.5 * (rows - 1.0));
        Pose {
            rotation: pose.rotation * so3::exp(&(self.motion.rate * row_delay_s)),
            position: pose.position + self.motion.velocity * row_delay_s,
        }
    }

    /// Residual of one corner over its sigma; `None` if the lens cannot project the point.
    fn error(&self, cameras: &Cameras, pose: &Pose, size: f64, c: &Corner) -> Option<Vector2<f64>> {
        let pose = self.at_row(cameras, pose, c);
        let x_in_left =
            pose.rotation.transpose() * (Vector3::from(c.x_in_target) * size - pose.position);
        let (lens, x) = match c.eye {
            Eye::Left => (&cameras.left, x_in_left),
            Eye::Right => {
                let right = cameras.right.as_ref()?;
                (&right.lens, right.rotation * x_in_left + right.translation)
            }
        };
        let pixel = lens.project(x.into())?;
        Some((Vector2::from(pixel) - Vector2::from(c.pixel)) / c.sigma_px)
    }

    fn linear(&self, cameras: &Cameras, pose: &Pose, size: f64, c: &Corner) -> Option<Linear> {
        let pose = self.at_row(cameras, pose, c);
        let x_in_target = Vector3::from(c.x_in_target);
        let back = pose.rotation.transpose();
        let x_in_left = back * (x_in_target * size - pose.position);
        let mut by_view = SMatrix::<f64, 3, VIEW>::zeros();
        by_view
            .fixed_columns_mut::<3>(0)
            .copy_from(&x_in_left.cross_matrix());
        by_view.fixed_columns_mut::<3>(3).copy_from(&-back);
        by_view.set_column(6, &(back * x_in_target));
        let projected = match c.eye {
            Eye::Left => cameras.left.project_with_jacobians(x_in_left.into())?,
            Eye::Right => {
                let right = cameras.right.as_ref()?;
                let x = right.rotation * x_in_left + right.translation;
                by_view = right.rotation * by_view;
                right.lens.project_with_jacobians(x.into())?
            }
        };
        Some(Linear {
            residual: (Vector2::from(projected.pixel) - Vector2::from(c.pixel)) / c.sigma_px,
            by_view: projected.by_point * by_view / c.sigma_px,
        })
    }

    /// Residual statistics of the corners; `scale` is their expected noise factor.
    pub(super) fn fit(&self, cameras: &Cameras, pose: &Pose, size: f64, scale: f64) -> Fit {
        let mut lengths: Vec<f64> = self
            .corners
            .iter()
            .filter_map(|c| Some(self.error(cameras, pose, size, c)?.norm()))
            .collect();
        let seen = lengths.len();
        let kept = lengths
            .iter()
            .filter(|&&e| e < self.config.outlier_sigma * scale);
        let (count, squares) = kept.fold((0_usize, 0.0), |(n, sum), e| (n + 1, sum + e * e));
        lengths.sort_by(f64::total_cmp);
        let median = lengths.get(seen / 2).copied().unwrap_or(f64::INFINITY);
        // Six parameters were fitted to two residuals per corner.
        let free = (2 * count) as f64 / (2 * count).saturating_sub(6).max(1) as f64;
        Fit {
            corners: count,
            outliers: self.corners.len() - count,
            squares,
            scale: median / RAYLEIGH_MEDIAN * free.sqrt(),
        }
    }

    /// The quadric at a pose, with sigmas of `scale` times the nominal ones.
    pub(super) fn linearise(
        &self,
        cameras: &Cameras,
        pose: &Pose,
        board_scale: f64,
        scale: f64,
    ) -> Quadric {
        let mut information = SMatrix::zeros();
        let mut gradient = SVector::zeros();
        let mut corners = 0;
        for corner in self.corners {
            let Some(linear) = self.linear(cameras, pose, board_scale, corner) else {
                continue;
            };
            let length = linear.residual.norm() / scale;
            if length >= self.config.outlier_sigma {
                continue;
            }
            let weight = (self.config.huber_sigma / length).min(1.0) / (scale * scale);
            let transposed = linear.by_view.transpose() * weight;
            information += transposed * linear.by_view;
            gradient += transposed * linear.residual;
            corners += 1;
        }
        Quadric {
            pose: *pose,
            board_scale,
            information,
            gradient,
            corners,
        }
    }

    /// Pose from this view alone, for a board of nominal size; `None` if corners are too few or do
    /// not fit.
    pub(super) fn pose(&self, cameras: &Cameras) -> Option<(Pose, Fit)> {
        if self.corners.len() < self.config.min_corners {
            return None;
        }
        let start = self.homography(cameras)?;
        let mut best = self.refine(cameras, start)?;
        let two_eyes = self.corners.iter().any(|c| c.eye == Eye::Left)
            && self.corners.iter().any(|c| c.eye == Eye::Right);
        if !two_eyes || best.1.scale > self.config.ambiguity_scale {
            let other = self
                .flipped(&best.0)
                .and_then(|p| self.refine(cameras, p))
                .filter(|other| other.1.scale < best.1.scale);
            best = other.unwrap_or(best);
        }
        let most_outliers = self.config.max_outlier_ratio * best.1.corners as f64;
        (best.1.corners >= self.config.min_corners && best.1.outliers as f64 <= most_outliers)
            .then_some(best)
    }

    /// Refines a nearby pose.
    pub(super) fn refine(&self, cameras: &Cameras, mut pose: Pose) -> Option<(Pose, Fit)> {
        let mut fit = self.fit(cameras, &pose, 1.0, f64::INFINITY);
        for _ in 0..self.config.max_iterations {
            let scale = fit.scale.max(1e-3);
            let quadric = self.linearise(cameras, &pose, 1.0, scale);
            let information: SMatrix<f64, 6, 6> =
                quadric.information.fixed_view::<6, 6>(0, 0).into();
            let gradient: SVector<f64, 6> = quadric.gradient.fixed_rows::<6>(0).into();
            let step = -information.cholesky()?.solve(&gradient);
            pose = pose.moved(&step);
            let sigmas = step.dot(&(information * step)).sqrt();
            fit = self.fit(cameras, &pose, 1.0, scale);
            if sigmas < self.config.convergence_sigma {
                break;
            }
        }
        fit.scale.is_finite().then_some((pose, fit))
    }

    /// Pose from the homography of the corners of one eye (Zhang 2000, section 3.1), on the plane
    /// of the board.
    fn homography(&self, cameras: &Cameras) -> Option<Pose> {
        let of = |eye: Eye| self.corners.iter().filter(move |c| c.eye == eye);
        let eye = match of(Eye::Left).count() >= of(Eye::Right).count() {
            true => Eye::Left,
            false => Eye::Right,
        };
        let lens = match eye {
            Eye::Left => &cameras.left,
            Eye::Right => &cameras.right.as_ref()?.lens,
        };
        let pairs: Vec<(Vector2<f64>, Vector2<f64>)> = of(eye)
            .filter_map(|c| {
                let [x, y, z] = lens.unproject(c.pixel)?;
                let on_board = Vector2::new(c.x_in_target[0], c.x_in_target[1]);
                (z > self.config.min_axial_component)
                    .then(|| (on_board, Vector2::new(x / z, y / z)))
            })
            .collect();
        if pairs.len() < 4 {
            return None;
        }
        let count = pairs.len() as f64;
        let middle = pairs.iter().map(|p| p.0).sum::<Vector2<f64>>() / count;
        let spread = (pairs.iter().map(|p| (p.0 - middle).norm_squared()))
            .sum::<f64>()
            .sqrt()
            / count.sqrt();
        let mut normal = SMatrix::<f64, 9, 9>::zeros();
        for (on_board, seen) in &pairs {
            let b = (on_board - middle) / spread;
            for row in [
                [
                    b.x,
                    b.y,
                    1.0,
                    0.0,
                    0.0,
                    0.0,
                    -seen.x * b.x,
                    -seen.x * b.y,
                    -seen.x,
                ],
                [
                    0.0,
                    0.0,
                    0.0,
                    b.x,
                    b.y,
                    1.0,
                    -seen.y * b.x,
                    -seen.y * b.y,
                    -seen.y,
                ],
            ] {
                let row = SVector::<f64, 9>::from(row);
                normal += row * row.transpose();
            }
        }
        let eigen = SymmetricEigen::new(normal);
        let h = eigen.eigenvectors.column(eigen.eigenvalues.imin());
        let h = Matrix3::from_row_slice(h.as_slice()) * h[8].signum();
        let (first, second): (Vector3<f64>, Vector3<f64>) =
            (h.column(0).into(), h.column(1).into());
        let stretch = 2.0 / (first.norm() + second.norm());
        if !stretch.is_finite() {
            return None;
        }
        let (first, second) = (first * stretch, second * stretch);
        let rough = Matrix3::from_columns(&[first, second, first.cross(&second)]);
        let svd = rough.svd(true, true);
        let camera_from_target = svd.u? * svd.v_t?;
        let middle_in_camera = Vector3::from(h.column(2)) * (stretch * spread);
        // The homography was normalized: origin at the board's middle, unit its spread.
        let middle = Vector3::new(middle.x, middle.y, 0.0);
        let shift = middle_in_camera - camera_from_target * middle;
        let (rotation, shift) = match (eye, &cameras.right) {
            (Eye::Right, Some(right)) => {
                let back = right.rotation.transpose();
                (
                    back * camera_from_target,
                    back * (shift - right.translation),
                )
            }
            _ => (camera_from_target, shift),
        };
        let rotation = rotation.transpose();
        Some(Pose {
            rotation,
            position: -(rotation * shift),
        })
    }

    /// The second pose of the planar ambiguity: tilted the other way about the line to the camera.
    fn flipped(&self, pose: &Pose) -> Option<Pose> {
        let count = self.corners.len() as f64;
        let sum: Vector3<f64> = self
            .corners
            .iter()
            .map(|c| Vector3::from(c.x_in_target))
            .sum();
        let middle = sum / count;
        let left_from_target = pose.rotation.transpose();
        let middle_in_left = left_from_target * (middle - pose.position);
        let axis = middle_in_left.try_normalize(1e-9)?;
        let half_turn = axis * axis.transpose() * 2.0 - Matrix3::identity();
        let about_normal = Matrix3::from_diagonal(&Vector3::new(-1.0, -1.0, 1.0));
        let rotation = (half_turn * left_from_target * about_normal).transpose();
        Some(Pose {
            rotation,
            position: middle - rotation * middle_in_left,
        })
    }
}

impl Pose {
    fn moved(&self, step: &SVector<f64, 6>) -> Self {
        let turn = Vector3::new(step[0], step[1], step[2]);
        let shift = Vector3::new(step[3], step[4], step[5]);
        Self {
            rotation: so3::tidy(&(self.rotation * so3::exp(&turn))),
            position: self.position + shift,
        }
    }
}
