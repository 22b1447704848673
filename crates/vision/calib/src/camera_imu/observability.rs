//! Observability from the motion of the recording alone, before the fit.
//!
//! In the joint fit noise acts as excitation: the scatter of the gyroscope rotates the lever arm
//! slightly at every sample, and a static camera appears to determine it. That contribution falls
//! with the third power of the averaging time, the contribution of real motion does not. The motion
//! is therefore averaged over windows of a quarter of a second, and a linear model (rates and
//! forces of a window against rotation, lever arm and offset; gravity and biases free) gives their
//! information matrix. Directions whose uncertainty is far above what a result may have are fixed
//! at their nominal value, and only the rest is fitted.

use camera_models::ImuNoise;
use nalgebra::{Matrix3, SMatrix, Vector3};

use super::config::ObservabilityConfig;
use super::initialization::RotationEstimate;
use super::recording::{GRAVITY, Priors};
use super::track::Track;
use super::view::Pose;

/// Rotation 3 (in the left optical frame), lever arm 3, offset, and the nuisance parameters:
/// gravity 3, accelerometer bias 3, gyroscope bias 3.
const PARAMETERS: usize = 16;

/// Directions that are fixed at their prior.
#[derive(Clone, Debug, Default)]
pub(super) struct FixedDirections {
    /// Axes of the left optical frame, length 1.
    pub rotation: Vec<Vector3<f64>>,
    /// Directions of the IMU's frame, length 1.
    pub translation: Vec<Vector3<f64>>,
    pub offset: bool,
}

/// Selects the directions to fix; see the module.
pub(super) fn fixed_directions(
    times_s: &[f64],
    poses: &[Pose],
    (track, noise): (&Track, &ImuNoise),
    rotation_estimate: &RotationEstimate,
    imu_from_left: &Matrix3<f64>,
    priors: &Priors,
    config: &ObservabilityConfig,
) -> FixedDirections {
    let window_s = config.window_s;
    let mut information = SMatrix::<f64, PARAMETERS, PARAMETERS>::zeros();
    for k in 0..3 {
        information[(k, k)] = priors.rotation_sigma_rad.powi(-2);
        information[(3 + k, 3 + k)] = priors.translation_sigma_m.powi(-2);
        information[(7 + k, 7 + k)] = GRAVITY.powi(-2);
        information[(10 + k, 10 + k)] = priors.bias_sigma[1].powi(-2);
        information[(13 + k, 13 + k)] = priors.bias_sigma[0].powi(-2);
    }
    information[(6, 6)] = priors.time_offset_sigma_s.powi(-2);
    let rate_sigma = (noise.gyro_noise_density / window_s.sqrt())
        .hypot(1.4 * config.view_pose_sigma[0] / window_s);
    let force_sigma = (noise.accel_noise_density / window_s.sqrt())
        .hypot(2.4 * config.view_pose_sigma[1] / (window_s * window_s));

    let mut next = f64::NEG_INFINITY;
    for (time_s, pose) in times_s.iter().zip(poses) {
        if *time_s < next {
            continue;
        }
        next = time_s + window_s;
        let middle = time_s + rotation_estimate.time_offset_s;
        let half = 0.5 * window_s;
        let mean = |at: f64| track.means(at - half, at + half);
        let (Some(now), Some(before), Some(after)) = (
            mean(middle),
            mean(middle - window_s),
            mean(middle + window_s),
        ) else {
            continue;
        };
        let rate = now[0] - rotation_estimate.gyro_bias;
        let spin = (after[0] - before[0]) / (2.0 * window_s);
        let (force, pull) = (now[1], (after[1] - before[1]) / (2.0 * window_s));
        let mut rates = SMatrix::<f64, 3, PARAMETERS>::zeros();
        let by_turn = rate.cross_matrix() * imu_from_left;
        rates.fixed_columns_mut::<3>(0).copy_from(&by_turn);
        rates.set_column(6, &spin);
        rates.fixed_columns_mut::<3>(13).fill_with_identity();
        let mut forces = SMatrix::<f64, 3, PARAMETERS>::zeros();
        let by_turn = force.cross_matrix() * imu_from_left;
        forces.fixed_columns_mut::<3>(0).copy_from(&by_turn);
        let whirl = rate.cross_matrix();
        let by_arm = spin.cross_matrix() + whirl * whirl;
        forces.fixed_columns_mut::<3>(3).copy_from(&by_arm);
        forces.set_column(6, &pull);
        let down = imu_from_left * pose.rotation.transpose();
        forces.fixed_columns_mut::<3>(7).copy_from(&-down);
        forces.fixed_columns_mut::<3>(10).fill_with_identity();
        information += rates.transpose() * rates / rate_sigma.powi(2)
            + forces.transpose() * forces / force_sigma.powi(2);
    }
    let Some(covariance) = information.cholesky().map(|c| c.inverse()) else {
        return FixedDirections {
            rotation: vec![Vector3::x(), Vector3::y(), Vector3::z()],
            translation: vec![Vector3::x(), Vector3::y(), Vector3::z()],
            offset: true,
        };
    };
    let directions = |at: usize, most: f64| -> Vec<Vector3<f64>> {
        let block: Matrix3<f64> = covariance.fixed_view::<3, 3>(at, at).into();
        let eigen = block.symmetric_eigen();
        (0..3)
            .filter(|&k| eigen.eigenvalues[k] > most * most)
            .map(|k| eigen.eigenvectors.column(k).into())
            .collect()
    };
    FixedDirections {
        rotation: directions(0, config.max_sigma[0]),
        translation: directions(3, config.max_sigma[1]),
        offset: covariance[(6, 6)] > config.max_sigma[2] * config.max_sigma[2],
    }
}
