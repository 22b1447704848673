//! Rotations of a ground truth, with their changes taken from a gyroscope.
//!
//! The orientations of EuRoC V1_01 are not accurate: OpenVINS computes them again from the marker
//! poses and the IMU (its documentation, "Supported Datasets"). Here the gyroscope alone gives the
//! changes: its noise is 0.02 degrees after 5 s, a twentieth of what the file deviates from it. One
//! rotation and one constant bias are fitted to the file's orientations, in least squares.

use anyhow::{Context, Result, ensure};
use cad_transforms::{RigidTransform, so3};
use camera_models::ImuSample;
use nalgebra::{Matrix3, Matrix3x6, Matrix6, UnitQuaternion, Vector3, Vector6};
use scene_bundle::{Pose, Trajectory};

/// Gauss-Newton steps: the problem is nearly linear.
const ITERATIONS: usize = 5;
/// Span over which changes are compared, ns.
const SPAN_NS: i64 = 5_000_000_000;

/// The gyroscope's rotations at the poses of a ground truth.
#[derive(Debug)]
pub(super) struct GyroscopeRotations {
    /// Positions of the ground truth, rotations of the gyroscope; within the samples.
    pub truth: Trajectory,
    /// Root mean square difference of the rotations, rad.
    pub difference_rad: f64,
    /// The same for changes over 5 s: root mean square and largest, rad.
    pub change_rad: [f64; 2],
}

impl GyroscopeRotations {
    /// Poses are those of the IMU.
    ///
    /// # Errors
    /// Fewer than two poses within the samples, or rotations that do not determine a bias.
    pub(super) fn fit(truth: &Trajectory, samples: &[ImuSample]) -> Result<Self> {
        let span = samples.first().zip(samples.last());
        let (first, last) = span.context("there are no IMU samples")?;
        let within = first.time_ns..=last.time_ns;
        let poses: Vec<&Pose> = (truth.poses().iter())
            .filter(|p| within.contains(&p.time_ns))
            .collect();
        let count = poses.len();
        ensure!(
            count > 1,
            "{count} poses within the IMU samples, at least 2"
        );
        let file: Vec<_> = poses.iter().map(|p| *p.world_from_rig.rotation()).collect();
        let mut bias = Vector3::zeros();
        let mut world_from_first = file[0];
        let mut rotations = Vec::new();
        for _ in 0..=ITERATIONS {
            let integrated = integrate(samples, &bias, &poses);
            rotations = (integrated.iter())
                .map(|(q, _)| world_from_first * q)
                .collect();
            let mut information = Matrix6::zeros();
            let mut gradient = Vector6::zeros();
            for ((rotation, (_, by_bias)), file) in rotations.iter().zip(&integrated).zip(&file) {
                // A small rotation in the world, and a change of the bias.
                let residual = so3::log(&(rotation * file.inverse()));
                let mut jacobian = Matrix3x6::zeros();
                jacobian.fixed_columns_mut::<3>(0).fill_with_identity();
                let by_bias = world_from_first.to_rotation_matrix() * by_bias;
                jacobian.fixed_columns_mut::<3>(3).copy_from(&by_bias);
                information += jacobian.transpose() * jacobian;
                gradient += jacobian.transpose() * residual;
            }
            let step = information
                .cholesky()
                .context("the bias is not determined")?;
            let step = -step.solve(&gradient);
            world_from_first = so3::exp(step.fixed_rows::<3>(0).into_owned()) * world_from_first;
            bias += step.fixed_rows::<3>(3);
        }
        let differences = (rotations.iter().zip(&file)).map(|(a, b)| a.angle_to(b));
        let changes: Vec<f64> = (0..count)
            .filter_map(|k| {
                let to = poses.partition_point(|p| p.time_ns < poses[k].time_ns + SPAN_NS);
                (to < count).then(|| {
                    let [a, b] = [&rotations, &file].map(|q| q[k].inverse() * q[to]);
                    a.angle_to(&b)
                })
            })
            .collect();
        let largest = changes.iter().copied().fold(0.0, f64::max);
        let poses = poses.iter().zip(&rotations).map(|(pose, rotation)| {
            let q = rotation.quaternion();
            let position = pose.world_from_rig.translation_m();
            let pose_of = RigidTransform::from_wxyz([q.w, q.i, q.j, q.k], position)?;
            Ok(Pose::new(pose.time_ns, pose_of))
        });
        Ok(Self {
            difference_rad: root_mean_square(differences),
            change_rad: [root_mean_square(changes.into_iter()), largest],
            truth: Trajectory::new(poses.collect::<Result<_>>()?)?,
        })
    }
}

fn root_mean_square(values: impl ExactSizeIterator<Item = f64>) -> f64 {
    let count = values.len() as f64;
    (values.map(|v| v * v).sum::<f64>() / count).sqrt()
}

/// Rotation from the first sample to each pose, and its derivative by the bias: a rotation in the
/// axes of the first sample per rad/s. Rates between samples are linear in time.
fn integrate(
    samples: &[ImuSample],
    bias: &Vector3<f64>,
    poses: &[&Pose],
) -> Vec<(UnitQuaternion<f64>, Matrix3<f64>)> {
    let mut rotation = UnitQuaternion::identity();
    let mut by_bias = Matrix3::zeros();
    let mut poses = poses.iter().peekable();
    let mut found = Vec::new();
    for pair in samples.windows(2) {
        let [from, to] = [&pair[0], &pair[1]];
        let span_s = 1e-9 * (to.time_ns - from.time_ns) as f64;
        let [from_rate, to_rate] = [from, to].map(|s| Vector3::from(s.gyro) - bias);
        // Through part of the interval, with the mean of the rates at its ends.
        let advance = |part: f64| {
            let mean = from_rate + 0.5 * part * (to_rate - from_rate);
            let half = rotation * so3::exp(0.5 * part * span_s * mean);
            (
                rotation * so3::exp(part * span_s * mean),
                by_bias - part * span_s * half.to_rotation_matrix().matrix(),
            )
        };
        while let Some(pose) = poses.next_if(|p| p.time_ns <= to.time_ns) {
            let part = (pose.time_ns - from.time_ns) as f64 / (to.time_ns - from.time_ns) as f64;
            found.push(advance(part));
        }
        (rotation, by_bias) = advance(1.0);
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Orientations that wander by half a degree around those of a gyroscope with a bias: fitted
    /// rotations are five times as accurate.
    #[test]
    fn the_wander_of_a_ground_truth_is_removed() {
        let rate = |t: f64| Vector3::new(0.5 * t.sin(), 0.3 * (0.7 * t).cos(), 0.4);
        let bias = Vector3::new(-0.002, 0.02, 0.08);
        let sample = |k: i64| ImuSample {
            time_ns: 5_000_000 * k,
            gyro: (rate(0.005 * k as f64) + bias).into(),
            accel: [0.0; 3],
        };
        let samples: Vec<ImuSample> = (0..=6000).map(sample).collect();
        let mut rotation = so3::exp(Vector3::new(0.2, -1.0, 0.4));
        let (mut exact, mut file) = (Vec::new(), Vec::new());
        for k in 0..600_000_i64 {
            let t = 5e-5 * k as f64;
            if k % 1000 == 0 {
                let wander =
                    0.0087 * Vector3::new((0.9 * t).sin(), (1.3 * t).cos(), (0.6 * t).sin());
                exact.push(rotation);
                let q = (so3::exp(wander) * rotation).into_inner();
                let pose = RigidTransform::from_wxyz([q.w, q.i, q.j, q.k], [0.0; 3]).unwrap();
                file.push(Pose::new(50_000 * k, pose));
            }
            rotation *= so3::exp(5e-5 * rate(t + 2.5e-5));
        }
        let fitted = GyroscopeRotations::fit(&Trajectory::new(file).unwrap(), &samples).unwrap();
        let errors = fitted.truth.poses().iter().zip(&exact);
        let errors = root_mean_square(errors.map(|(p, q)| p.world_from_rig.rotation().angle_to(q)));
        assert_eq!(fitted.truth.poses().len(), exact.len());
        assert!(
            (0.007..0.013).contains(&fitted.difference_rad),
            "{fitted:?}"
        );
        assert!(errors < 0.2 * fitted.difference_rad, "{errors} rad");
    }

    /// A pose between two samples.
    #[test]
    fn rotations_are_interpolated() {
        let sample = |time_ns| ImuSample {
            time_ns,
            gyro: [0.0, 0.0, 1.0],
            accel: [0.0; 3],
        };
        let samples = [0, 10_000_000, 20_000_000].map(sample);
        let at = |time_ns| Pose::new(time_ns, RigidTransform::identity());
        let poses = [at(0), at(13_000_000), at(20_000_000)];
        let poses: Vec<&Pose> = poses.iter().collect();
        let found = integrate(&samples, &Vector3::zeros(), &poses);
        for ((rotation, by_bias), angle) in found.iter().zip([0.0, 0.013, 0.02]) {
            assert!((rotation.angle() - angle).abs() < 1e-12, "{rotation}");
            assert!((by_bias[(2, 2)] + angle).abs() < 1e-12, "{by_bias}");
        }
    }
}
