//! Pose of an eye from known points of a planar target (PnP).
//!
//! Contract: [`planar`] needs at least four points, not on one line, that the lens can project. A
//! planar target that is far away or small has two poses; the one with the smaller residual is
//! returned, with the ratio of the residuals, because near 1 the choice is ambiguous.

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Lens};
use estimator_config::config;
use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use crate::adjust::{LocateConfig, Point, locate};

config! {
    /// Configuration of [`planar`]. Values were chosen on the simulated recordings of `cargo xtask
    /// bench calib`; how the error depends on them was not charted.
    pub struct Config {
        /// Minimum component along the optical axis of the direction to a point that takes part in
        /// the homography, 0 to 1: 81 degrees. Beyond it the coordinates on the plane diverge.
        pub min_axial_component: f64 = 0.15,
        /// Rotation below which two poses count as the same, rad. Lower reports one pose, found
        /// from two starts, as ambiguous.
        pub min_ambiguity_rad: f64 = 0.02,
        /// Refinement of a pose.
        pub locate: LocateConfig = LocateConfig::default(),
    }
}

/// A pose from one image.
#[derive(Clone, Copy, Debug)]
pub struct PlanarPose {
    /// Takes points of the target to the eye, m.
    pub eye_from_target: RigidTransform,
    /// RMS residual, pixels.
    pub rms_px: f64,
    /// RMS of the mirrored pose over that of this one: near 1 the choice is ambiguous.
    pub ambiguity: f64,
}

/// The pose from points with z = 0 in the target. `None` if there are too few or they do not fit.
///
/// ```
/// use cad_transforms::RigidTransform;
/// use calib::adjust::Point;
/// use calib::pnp::{self, Config};
/// use camera_models::{CameraModel, Distortion, Lens};
///
/// let model = CameraModel::new((640, 480), [500.0, 500.0, 319.5, 239.5], Distortion::None);
/// let truth = RigidTransform::from_rotation_vector([0.4, -0.3, 0.1], [0.05, -0.02, 0.8])?;
/// let lens = Lens::new(&model);
/// let point = |i: u32| {
///     let x_in_target = [0.05 * f64::from(i % 6), 0.05 * f64::from(i / 6), 0.0];
///     let pixel = lens.project(truth.apply(x_in_target))?;
///     Some(Point { x_in_target, pixel, sigma_px: 0.1 })
/// };
/// let points: Vec<Point> = (0..24).filter_map(point).collect();
/// let pose = pnp::planar(&model, &points, &Config::default()).ok_or("no pose")?;
/// assert!((truth.inverse() * pose.eye_from_target).distance_m() < 1e-6);
/// assert!(pose.rms_px < 1e-6);
/// // Three points are too few.
/// assert!(pnp::planar(&model, &points[..3], &Config::default()).is_none());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub fn planar(model: &CameraModel, points: &[Point], config: &Config) -> Option<PlanarPose> {
    let start = from_homography(&Lens::new(model), points, config)?;
    let found = locate(model, points, &start, &config.locate).ok()?;
    let (best, other) = match fiducials::mirrored(&found.0, middle(points)) {
        None => (found, None),
        Some(other) => match locate(model, points, &other, &config.locate).ok() {
            Some(other) if other.1 < found.1 => (other, Some(found)),
            other => (found, other),
        },
    };
    // Both starts may converge to one pose.
    let other = other.filter(|o| (o.0.inverse() * best.0).angle_rad() > config.min_ambiguity_rad);
    let floor = best.1.max(1e-9);
    let in_front = points.iter().all(|p| best.0.apply(p.x_in_target)[2] > 0.0);
    (in_front || wide(model)).then_some(PlanarPose {
        eye_from_target: best.0,
        rms_px: best.1,
        ambiguity: other.map_or(f64::INFINITY, |o| o.1 / floor),
    })
}

/// Whether the lens projects directions behind itself.
fn wide(model: &CameraModel) -> bool {
    Lens::new(model).widest_rad() > std::f64::consts::FRAC_PI_2
}

/// Direct linear transformation (Hartley and Zisserman, 4.1) of directions, decomposed into a pose.
fn from_homography(lens: &Lens, points: &[Point], config: &Config) -> Option<RigidTransform> {
    let seen: Vec<([f64; 2], [f64; 2])> = points
        .iter()
        .filter_map(|p| {
            let [x, y, z] = lens.unproject(p.pixel)?;
            let [a, b, _] = p.x_in_target;
            (z > config.min_axial_component).then(|| ([a, b], [x / z, y / z]))
        })
        .collect();
    if seen.len() < 4 {
        return None;
    }
    let n = seen.len() as f64;
    let middle: [f64; 2] = std::array::from_fn(|i| seen.iter().map(|s| s.0[i]).sum::<f64>() / n);
    let spread = seen
        .iter()
        .map(|(at, _)| (at[0] - middle[0]).hypot(at[1] - middle[1]));
    let size = spread.sum::<f64>() / n;
    if size <= 0.0 {
        return None;
    }
    let mut sum = SMatrix::<f64, 9, 9>::zeros();
    for ([a, b], [x, y]) in &seen {
        let (a, b) = ((a - middle[0]) / size, (b - middle[1]) / size);
        for row in [
            SVector::<f64, 9>::from([a, b, 1.0, 0.0, 0.0, 0.0, -x * a, -x * b, -x]),
            SVector::<f64, 9>::from([0.0, 0.0, 0.0, a, b, 1.0, -y * a, -y * b, -y]),
        ] {
            sum += row * row.transpose();
        }
    }
    let eigen = sum.symmetric_eigen();
    let h = eigen
        .eigenvectors
        .column(eigen.eigenvalues.imin())
        .into_owned();
    let h = Matrix3::from_row_slice(h.as_slice());
    let (mut c1, mut c2, mut c3) = (
        h.column(0).into_owned(),
        h.column(1).into_owned(),
        h.column(2).into_owned(),
    );
    // The middle of the target is in front of the eye.
    let scale = 0.5 * (c1.norm() + c2.norm()) * c3.z.signum();
    if scale == 0.0 || !scale.is_finite() {
        return None;
    }
    c1 /= scale;
    c2 /= scale;
    c3 *= size / scale;
    let near = Matrix3::from_columns(&[c1, c2, c1.cross(&c2)]);
    let svd = near.svd(true, true);
    let mut rotation = svd.u? * svd.v_t?;
    if rotation.determinant() < 0.0 {
        rotation.column_mut(2).neg_mut();
    }
    let at = c3 - rotation * Vector3::new(middle[0], middle[1], 0.0);
    let rows = rotation.transpose();
    RigidTransform::from_rotation_rows(std::array::from_fn(|i| rows.as_slice()[i]), at.into()).ok()
}

/// Middle of points.
fn middle(points: &[Point]) -> [f64; 3] {
    let n = points.len() as f64;
    std::array::from_fn(|i| points.iter().map(|p| p.x_in_target[i]).sum::<f64>() / n)
}

#[cfg(test)]
mod tests {
    use camera_models::Distortion;

    use super::*;

    #[test]
    fn pose_is_recovered_for_every_lens_model() {
        let lenses = [
            Distortion::None,
            Distortion::RadTan4 {
                k1: -0.25,
                k2: 0.05,
                p1: 1e-3,
                p2: -1e-3,
            },
            Distortion::DoubleSphere {
                xi: -0.2,
                alpha: 0.55,
            },
        ];
        for distortion in lenses {
            let model = CameraModel {
                width: 672,
                height: 376,
                fx: 300.0,
                fy: 300.0,
                cx: 336.0,
                cy: 188.0,
                distortion,
            };
            for (k, turn) in [[0.0, 0.0, 0.0], [0.9, 0.1, 0.3], [-0.4, 0.8, 3.0]]
                .into_iter()
                .enumerate()
            {
                let truth = RigidTransform::from_rotation_vector(turn, [0.1, -0.05, 0.9]).unwrap();
                let lens = Lens::new(&model);
                let points: Vec<Point> = (0..48)
                    .filter_map(|i| {
                        let x_in_target = [
                            0.06 * f64::from(i % 8) - 0.2,
                            0.06 * f64::from(i / 8) - 0.15,
                            0.0,
                        ];
                        Some(Point {
                            x_in_target,
                            pixel: lens.project(truth.apply(x_in_target))?,
                            sigma_px: 0.1,
                        })
                    })
                    .collect();
                let found = planar(&model, &points, &Config::default()).unwrap();
                let off = truth.inverse() * found.eye_from_target;
                assert!(
                    off.angle_rad() < 1e-7 && off.distance_m() < 1e-7,
                    "{distortion:?} {k}"
                );
                assert!(found.rms_px < 1e-6);
            }
        }
    }

    #[test]
    fn too_few_points_give_no_pose() {
        let model = CameraModel {
            width: 640,
            height: 480,
            fx: 500.0,
            fy: 500.0,
            cx: 320.0,
            cy: 240.0,
            distortion: Distortion::None,
        };
        let point = |x: f64, u: f64| Point {
            x_in_target: [x, 0.0, 0.0],
            pixel: [u, 240.0],
            sigma_px: 0.1,
        };
        assert!(
            planar(
                &model,
                &[point(0.0, 320.0), point(0.1, 370.0)],
                &Config::default()
            )
            .is_none()
        );
    }
}
