//! Two gyroscopes on one rigid body: rotation between them, and time offset. No images are needed.
//!
//! Both measure one rate: `b = exp(w) nominal (1 + S) a + bias + drift t`, with `a` taken
//! `time_offset` earlier. `S` is symmetric: scale and shear of both sensors together. Rates are
//! compared as integrals over short windows, which is linear in them and needs no common sampling.
//!
//! Noise acts as excitation: for two gyroscopes at rest the rotation between them appears better
//! determined than it is. A signal that only one of the two measured is noise, so that a direction
//! counts as observable if both measured rotations that determine it ([`ObservableDirections`]).

use cad_transforms::so3;
use nalgebra::{Matrix3, SMatrix, SVector, UnitQuaternion, Vector3};

use serde::Serialize;

use super::config::{Config, GyroPairConfig};
use super::gyro::{Gyro, IntegratedGyro};
use super::robust::{ClusterSums, median, sigmas_of, tukey};

const PARAMETERS: usize = 16;

/// Result; see the module.
#[derive(Clone, Debug, Serialize)]
pub struct GyroAlignment {
    /// `w`, rad, in the frame of the second IMU.
    pub rotation_rad: [f64; 3],
    /// Standard deviation about each axis, rad.
    pub sigma_rad: [f64; 3],
    /// Its covariance, rad².
    #[serde(skip)]
    pub(super) covariance: Matrix3<f64>,
    /// Time offset, s: positive if the second one's samples are stamped later.
    pub time_offset_s: f64,
    /// Its standard deviation, s.
    pub time_offset_sigma_s: f64,
}

/// Compares two gyroscopes; `None` with too little common time. `b_from_a` is nominal.
pub(super) fn estimate(
    b_from_a: &UnitQuaternion<f64>,
    a: &Gyro,
    b: &Gyro,
    config: &Config,
) -> Option<GyroAlignment> {
    let ([a0, a1], [b0, b1]) = (a.span_ns()?, b.span_ns()?);
    let max_gap_s = config.camera_imu.max_gap_s;
    let config = &config.gyro_pairs;
    let margin = config.margin_ns;
    let (from, to) = (a0.max(b0) + margin, a1.min(b1) - margin);
    let block = config.window_ns * config.windows_per_block;
    let whole = (to - from) / block;
    if whole < 2 {
        return None;
    }
    let blocks = whole.min(config.max_blocks);
    let one = Vector3::repeat(1.0);
    let (sum_a, sum_b) = (
        a.integrate(one, Vector3::zeros(), max_gap_s),
        b.integrate(one, Vector3::zeros(), max_gap_s),
    );
    let seconds = config.window_ns as f64 * 1e-9;
    let length_s = (to - from) as f64 * 1e-9;
    let mut windows = Vec::new();
    for group in 0..blocks {
        let start = from + (to - from - block) / (blocks - 1).max(1) * group;
        for k in 0..config.windows_per_block {
            let at = (start + k * config.window_ns) as f64;
            let sum = sum_b.sum(at, at + config.window_ns as f64);
            windows.extend(sum.map(|sum| (group as usize, at, sum)));
        }
    }
    if windows.len() < config.min_windows {
        return None;
    }
    let nominal = b_from_a.to_rotation_matrix().into_inner();
    let (rotation, scale, shear) = (
        config.rotation_sigma_rad,
        config.scale_sigma,
        config.shear_sigma,
    );
    let (bias, drift) = (config.bias_sigma_rad_s, config.drift_sigma_rad_s);
    let sigmas = SVector::<f64, PARAMETERS>::from([
        rotation,
        rotation,
        rotation,
        scale,
        scale,
        scale,
        shear,
        shear,
        shear,
        bias,
        bias,
        bias,
        drift,
        drift,
        drift,
        config.offset_sigma_s,
    ]);
    let seen = ObservableDirections::new(&nominal, &windows, &sum_a, &sum_b, config);
    let mut now = SVector::<f64, PARAMETERS>::zeros();
    let mut spread = config.initial_spread_rad_s * seconds;
    let mut last = None;
    for _ in 0..config.rounds {
        let turn = so3::exp(now.fixed_rows::<3>(0).into_owned());
        let shape = Matrix3::new(
            1.0 + now[3],
            now[6],
            now[7], //
            now[6],
            1.0 + now[4],
            now[8], //
            now[7],
            now[8],
            1.0 + now[5],
        );
        let b_of_a = turn.to_rotation_matrix().into_inner() * nominal;
        let mut sum = ClusterSums::<PARAMETERS>::new(&[blocks as usize], &sigmas, &-now);
        let mut sizes = Vec::with_capacity(3 * windows.len());
        for (group, at, sum_b) in &windows {
            let (at_a, end_a) = (
                at - now[15] * 1e9,
                at - now[15] * 1e9 + config.window_ns as f64,
            );
            let Some(v) = sum_a.sum(at_a, end_a) else {
                continue;
            };
            let age = (at - from as f64) * 1e-9 / length_s - 0.5;
            let expected = b_of_a * (shape * v);
            let bias = now.fixed_rows::<3>(9) + now.fixed_rows::<3>(12) * age;
            let error = sum_b - expected - bias * seconds;
            sizes.extend(error.iter().map(|e| e.abs()));
            let kept = tukey(error.norm() / (1.7 * spread));
            if kept == 0.0 {
                continue;
            }
            let mut by = SMatrix::<f64, 3, PARAMETERS>::zeros();
            by.fixed_columns_mut::<3>(0)
                .copy_from(&-expected.cross_matrix());
            by.fixed_columns_mut::<3>(3)
                .copy_from(&(b_of_a * Matrix3::from_diagonal(&v)));
            let shears = Matrix3::new(
                v.y, v.z, 0.0, //
                v.x, 0.0, v.z, //
                0.0, v.x, v.y,
            );
            by.fixed_columns_mut::<3>(6).copy_from(&(b_of_a * shears));
            by.fixed_columns_mut::<3>(9)
                .copy_from(&(Matrix3::identity() * seconds));
            by.fixed_columns_mut::<3>(12)
                .copy_from(&(Matrix3::identity() * (seconds * age)));
            let (Some(first), Some(end)) = (sum_a.rate(at_a), sum_a.rate(end_a)) else {
                continue;
            };
            by.set_column(15, &(b_of_a * (shape * (first - end))));
            let weight = Matrix3::identity() * (kept / (spread * spread));
            sum.add(&[*group], &error, &by, &weight);
        }
        now += sum.step()?;
        seen.keep(&mut now);
        spread = (1.4826 * median(&mut sizes)).max(1e-7);
        last = Some(sum);
    }
    let (covariance, larger) = last?.covariance(&[0, 1, 2, 15])?;
    let unseen = Matrix3::identity() - seen.turns;
    let of_turn = seen.turns * covariance.fixed_view::<3, 3>(0, 0) * seen.turns * larger
        + unseen * (config.rotation_sigma_rad * config.rotation_sigma_rad);
    Some(GyroAlignment {
        rotation_rad: now.fixed_rows::<3>(0).into_owned().into(),
        sigma_rad: sigmas_of(&of_turn),
        covariance: of_turn,
        time_offset_s: now[15],
        time_offset_sigma_s: match seen.is_offset_observable {
            true => (covariance[(15, 15)] * larger).sqrt(),
            false => config.offset_sigma_s,
        },
    })
}

/// A window: its group, its start (ns), and the integral of the second gyroscope's rate, rad.
type Window = (usize, f64, Vector3<f64>);

/// Directions that both gyroscopes observe.
struct ObservableDirections {
    /// Projection of rotations onto the observable directions, in the frame of the second IMU.
    turns: Matrix3<f64>,
    is_offset_observable: bool,
}

impl ObservableDirections {
    fn new(
        nominal: &Matrix3<f64>,
        windows: &[Window],
        sum_a: &IntegratedGyro<'_>,
        sum_b: &IntegratedGyro<'_>,
        config: &GyroPairConfig,
    ) -> Self {
        // Rotation of each in a window, and the change of its rate.
        let both = |(_, at, b): &Window| {
            let end = at + config.window_ns as f64;
            let a = nominal * sum_a.sum(*at, end)?;
            let change = |of: &IntegratedGyro<'_>| Some(of.rate(end)? - of.rate(*at)?);
            Some(([a, *b], [nominal * change(sum_a)?, change(sum_b)?]))
        };
        let both: Vec<_> = windows.iter().filter_map(both).collect();
        let mean = |k: usize| {
            both.iter().map(|(turns, _)| turns[k]).sum::<Vector3<f64>>() / both.len().max(1) as f64
        };
        let means = [mean(0), mean(1)];
        let (mut own, mut common) = (Matrix3::zeros(), Matrix3::zeros());
        let (mut own_change, mut common_change) = (0.0, 0.0);
        for (turns, [change_a, change_b]) in &both {
            let [a, b] = [0, 1].map(|k| turns[k] - means[k]);
            own += a * a.transpose();
            common += a * b.transpose();
            own_change += change_a.dot(change_a);
            common_change += change_a.dot(change_b);
        }
        // A rotation about an axis is observed through rates normal to it.
        let across = |m: Matrix3<f64>| Matrix3::identity() * m.trace() - (m + m.transpose()) * 0.5;
        let (own, common) = (across(own), across(common));
        let axes = own.symmetric_eigen().eigenvectors;
        let seen = axes.column_iter().filter(|axis| {
            let along = |m: &Matrix3<f64>| (axis.transpose() * m * axis)[0];
            along(&common) > config.min_common_ratio * along(&own)
        });
        Self {
            turns: seen.map(|axis| axis * axis.transpose()).sum(),
            is_offset_observable: common_change > config.min_common_ratio * own_change,
        }
    }

    /// Keeps unobservable directions at their nominal value.
    fn keep(&self, now: &mut SVector<f64, PARAMETERS>) {
        let turn = self.turns * now.fixed_rows::<3>(0);
        now.fixed_rows_mut::<3>(0).copy_from(&turn);
        if !self.is_offset_observable {
            now[15] = 0.0;
        }
    }
}
