//! Initial estimates in closed form.
//!
//! 1. The time offset with the best agreement of the angular rates of camera and gyroscope,
//!    whatever the rotation between the two: the sum of the singular values of their covariance,
//!    normalized.
//! 2. The rotation that aligns them at this offset (Kabsch 1976; means removed, so that a constant
//!    bias does no harm), and the remaining bias.
//! 3. Gravity, lever arm and accelerometer bias from three views at a time, linear once velocities
//!    are eliminated (as in Qin, Li and Shen, VINS-Mono 2018, section V-B).

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};

use super::config::InitializationConfig;
use super::preintegrate::{ACCEL_BIAS, preintegrate};
use super::recording::Priors;
use super::so3;
use super::track::{Correction, Track};
use super::view::Pose;

/// Angular rates of camera and gyroscope over the same intervals.
struct AngularRates {
    covariance: Matrix3<f64>,
    camera_mean: Vector3<f64>,
    imu_mean: Vector3<f64>,
    /// Spread of the camera's rates.
    camera: Matrix3<f64>,
    agreement: f64,
    ratio: f64,
    count: usize,
}

/// Estimates from the angular rates.
pub(super) struct RotationEstimate {
    pub time_offset_s: f64,
    /// All candidates for the rotation of `imu_from_left`.
    pub rotations: Vec<Matrix3<f64>>,
    pub gyro_bias: Vector3<f64>,
    /// Time offset and correlation.
    pub correlation: Vec<[f64; 2]>,
    /// Spread of the gyroscope's rates over that of the camera's; `None` if both are static.
    pub rate_ratio: Option<f64>,
}

fn rates(
    times_s: &[f64],
    poses: &[Pose],
    track: &Track,
    offset_s: f64,
    config: &InitializationConfig,
) -> AngularRates {
    let mut pairs = Vec::with_capacity(times_s.len());
    for i in 1..times_s.len() {
        let (a, b) = (times_s[i - 1], times_s[i]);
        if b - a > config.max_rotation_interval_s {
            continue;
        }
        let Some([measured, _]) = track.means(a + offset_s, b + offset_s) else {
            continue;
        };
        let turn = poses[i - 1].rotation.transpose() * poses[i].rotation;
        pairs.push((so3::log(&turn) / (b - a), measured));
    }
    let count = pairs.len();
    let share = 1.0 / count.max(1) as f64;
    let camera_mean = pairs.iter().map(|p| p.0).sum::<Vector3<f64>>() * share;
    let imu_mean = pairs.iter().map(|p| p.1).sum::<Vector3<f64>>() * share;
    let (mut covariance, mut camera, mut measured) = (Matrix3::zeros(), Matrix3::zeros(), 0.0);
    for pair in &pairs {
        let (s, m) = (pair.0 - camera_mean, pair.1 - imu_mean);
        covariance += m * s.transpose() * share;
        camera += s * s.transpose() * share;
        measured += m.norm_squared() * share;
    }
    let singular = covariance.singular_values();
    let sign = covariance.determinant().signum();
    let agreed = singular[0] + singular[1] + sign * singular[2];
    let most = (camera.trace() * measured).sqrt();
    AngularRates {
        covariance,
        camera_mean,
        imu_mean,
        camera,
        agreement: if most > 0.0 { agreed / most } else { 0.0 },
        ratio: (measured / camera.trace()).sqrt(),
        count,
    }
}

/// Time offset, rotation and gyroscope bias. Poses are of the left camera in the target's frame.
pub(super) fn from_rates(
    times_s: &[f64],
    poses: &[Pose],
    track: &Track,
    nominal: Option<&Matrix3<f64>>,
    middle_s: f64,
    reach_s: f64,
    config: &InitializationConfig,
) -> RotationEstimate {
    let step = (config.offset_step_periods * track.period_s)
        .clamp(config.offset_step_s[0], config.offset_step_s[1]);
    let steps = (reach_s / step).ceil() as i32;
    let needed = (config.min_overlap_ratio * times_s.len() as f64) as usize;
    let correlation: Vec<[f64; 2]> = (-steps..=steps)
        .map(|k| {
            let offset_s = middle_s + f64::from(k) * step;
            let rates = rates(times_s, poses, track, offset_s, config);
            let enough = rates.count >= needed.max(4);
            [offset_s, if enough { rates.agreement } else { 0.0 }]
        })
        .collect();
    let best = (0..correlation.len())
        .max_by(|&a, &b| correlation[a][1].total_cmp(&correlation[b][1]))
        .unwrap_or(0);
    let mut offset_s = correlation[best][0];
    if best > 0 && best + 1 < correlation.len() {
        let [a, b, c] = [-1_i32, 0, 1].map(|k| correlation[(best as i32 + k) as usize][1]);
        let bend = a - 2.0 * b + c;
        if bend < 0.0 {
            offset_s += (0.5 * (a - c) / bend).clamp(-1.0, 1.0) * step;
        }
    }
    let still = rates(times_s, poses, track, middle_s, config);
    let spread = still.camera.symmetric_eigenvalues();
    if spread.max().sqrt() < config.static_rate_rad_s {
        offset_s = middle_s;
    }
    let found = rates(times_s, poses, track, offset_s, config);
    let rotations = rotations(&found, nominal, config);
    let gyro_bias = found.imu_mean - rotations[0] * found.camera_mean;
    RotationEstimate {
        time_offset_s: offset_s,
        rotations,
        gyro_bias,
        correlation,
        rate_ratio: (spread.max().sqrt() >= config.static_rate_rad_s).then_some(found.ratio),
    }
}

/// Candidate rotations: one, or several about the only axis of rotation of the recording.
fn rotations(
    rates: &AngularRates,
    nominal: Option<&Matrix3<f64>>,
    config: &InitializationConfig,
) -> Vec<Matrix3<f64>> {
    let fallback = nominal.copied().unwrap_or_else(Matrix3::identity);
    let camera = rates.camera.symmetric_eigen();
    let mut order = [0, 1, 2];
    order.sort_by(|&a, &b| camera.eigenvalues[b].total_cmp(&camera.eigenvalues[a]));
    let spread = order.map(|k| camera.eigenvalues[k].max(0.0).sqrt());
    if spread[0] < config.static_rate_rad_s {
        return vec![fallback];
    }
    let svd = rates.covariance.svd(true, true);
    let (Some(u), Some(v)) = (svd.u, svd.v_t) else {
        return vec![fallback];
    };
    let sign = (u.determinant() * v.determinant()).signum();
    if spread[1] >= config.static_rate_rad_s
        && spread[1] >= config.min_second_axis_ratio * spread[0]
    {
        return vec![u * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, sign)) * v];
    }
    // Single axis: `u₁` in the IMU, `v₁` in the camera.
    let (in_imu, in_left): (Vector3<f64>, Vector3<f64>) =
        (u.column(0).into(), v.row(0).transpose());
    let onto = |from: &Matrix3<f64>| {
        // The smallest rotation that aligns the axis with its measurement.
        let rotation_estimate = from * in_left;
        let axis = rotation_estimate.cross(&in_imu);
        let (sine, cosine) = (axis.norm(), rotation_estimate.dot(&in_imu));
        let axis = axis.try_normalize(1e-9).unwrap_or_else(|| {
            // Parallel or opposite: any normal axis.
            let other = if in_imu.x.abs() < 0.9 {
                Vector3::x()
            } else {
                Vector3::y()
            };
            in_imu.cross(&other).normalize()
        });
        so3::exp(&(axis * sine.atan2(cosine))) * from
    };
    let first = onto(&fallback);
    if nominal.is_some() {
        return vec![first];
    }
    (0..8)
        .map(|k| so3::exp(&(in_imu * (std::f64::consts::FRAC_PI_4 * f64::from(k)))) * first)
        .collect()
}

/// Gravity in the target's frame (not scaled to its known length), lever arm (the left camera in
/// the IMU's frame) and accelerometer bias.
pub(super) struct GravityEstimate {
    pub gravity: Vector3<f64>,
    pub lever: Vector3<f64>,
    pub accel_bias: Vector3<f64>,
    /// RMS residual, m/s.
    pub error: f64,
}

/// See the module; `None` without a triple of views. Priors of lever arm and bias
/// are used.
pub(super) fn from_forces(
    times_s: &[f64],
    poses: &[Pose],
    track: &Track,
    rotation_estimate: &RotationEstimate,
    imu_from_left: &Matrix3<f64>,
    priors: &Priors,
    config: &InitializationConfig,
) -> Option<GravityEstimate> {
    let correction = Correction {
        gyro_bias: rotation_estimate.gyro_bias,
        accel_bias: Vector3::zeros(),
        gyro_shape_inverse: Matrix3::identity(),
        accel_shape_inverse: Matrix3::identity(),
    };
    let lever = priors
        .imu_from_left
        .map_or(Vector3::zeros(), |t| *t.translation());
    let lever = (lever, priors.translation_sigma_m);
    let bias_sigma = priors.bias_sigma[1];
    let mut normal = SMatrix::<f64, 9, 9>::zeros();
    let mut right = SVector::<f64, 9>::zeros();
    for k in 0..3 {
        normal[(3 + k, 3 + k)] += lever.1.powi(-2);
        right[3 + k] += lever.0[k] * lever.1.powi(-2);
        normal[(6 + k, 6 + k)] += bias_sigma.powi(-2);
    }
    let mut raw = Vec::new();
    let mut rows = Vec::new();
    let mut first = 0;
    while first < times_s.len() {
        let later = |from: usize| {
            let next =
                times_s.partition_point(|&t| t < times_s[from] + config.min_triple_interval_s);
            (next < times_s.len()
                && times_s[next] < times_s[from] + 2.0 * config.min_triple_interval_s)
                .then_some(next)
        };
        let triple = later(first).and_then(|second| Some((second, later(second)?)));
        let i = first;
        first += 1;
        let Some((j, k)) = triple else { continue };
        let mut motion = |a: usize, b: usize| {
            let from = times_s[a] + rotation_estimate.time_offset_s;
            let to = times_s[b] + rotation_estimate.time_offset_s;
            track.between(from, to, &mut raw)?;
            Some(preintegrate(&raw, &correction, [0.0; 2]))
        };
        let (Some(one), Some(two)) = (motion(i, j), motion(j, k)) else {
            continue;
        };
        let [ri, rj, rk] = [i, j, k].map(|n| poses[n].rotation * imu_from_left.transpose());
        let [pi, pj, pk] = [i, j, k].map(|n| poses[n].position);
        let (t1, t2) = (one.seconds, two.seconds);
        let by_bias = |m: &super::preintegrate::Preintegration, row: usize| -> Matrix3<f64> {
            m.by_sensor.fixed_view::<3, 3>(row, ACCEL_BIAS).into()
        };
        let mut row = SMatrix::<f64, 3, 9>::zeros();
        row.fixed_columns_mut::<3>(0)
            .copy_from(&(Matrix3::identity() * (0.5 * (t1 + t2))));
        row.fixed_columns_mut::<3>(3)
            .copy_from(&((rk - rj) / t2 - (rj - ri) / t1));
        let bias = rj * by_bias(&two, 6) / t2 + ri * (by_bias(&one, 3) - by_bias(&one, 6) / t1);
        row.fixed_columns_mut::<3>(6).copy_from(&bias);
        let moved = (pk - pj) / t2 - (pj - pi) / t1;
        let pulled = rj * two.displacement / t2 + ri * (one.velocity - one.displacement / t1);
        let value = moved - pulled;
        let weight = config.velocity_sigma.powi(-2);
        normal += row.transpose() * row * weight;
        right += row.transpose() * value * weight;
        rows.push((row, value));
    }
    if rows.is_empty() {
        return None;
    }
    let found = normal.cholesky()?.solve(&right);
    let squares: f64 = (rows.iter())
        .map(|(row, value)| (row * found - value).norm_squared())
        .sum();
    Some(GravityEstimate {
        gravity: found.fixed_rows::<3>(0).into(),
        lever: found.fixed_rows::<3>(3).into(),
        accel_bias: found.fixed_rows::<3>(6).into(),
        error: (squares / rows.len() as f64).sqrt(),
    })
}
