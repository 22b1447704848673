//! Merging of Gaussians by moments.
//!
//! Weights are opacity times area, the product of the two larger scales. Mean and covariance are
//! those of the mixture (law of total variance), the color is the weighted mean, and the opacity
//! keeps the sum of the weights.

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

use crate::scene::{MAX_DEGREE, Splat, Splats, coefficients};

/// Largest opacity of a merged Gaussian.
const MAX_OPACITY: f64 = 0.99;

/// Smallest variance of a merged Gaussian, m².
const MIN_VARIANCE: f64 = 1e-14;

/// Each run of `count` neighbors as one Gaussian, unless it would be more than `max_growth` times
/// as large as the largest of them.
pub(super) fn neighbors(splats: &Splats, count: usize, max_growth: f32) -> Splats {
    let mut out = splats.select(&[]);
    let indices: Vec<usize> = (0..splats.len()).collect();
    for run in indices.chunks(count) {
        let members: Vec<Splat> = run.iter().map(|i| splats.get(*i)).collect();
        let merged = (members.len() > 1).then(|| merge(&members)).flatten();
        let largest = |splat: &Splat| {
            let logs = splat.log_scale.into_iter();
            logs.fold(f32::NEG_INFINITY, f32::max)
        };
        let limit = members
            .iter()
            .map(largest)
            .fold(f32::NEG_INFINITY, f32::max)
            + libm::logf(max_growth);
        let merged = merged.filter(|splat| largest(splat) <= limit);
        let fits = merged.is_some_and(|splat| out.push(&splat).is_ok());
        if !fits {
            for splat in &members {
                out.push(splat).expect("a Gaussian of the scene itself");
            }
        }
    }
    out
}

/// One Gaussian for several; `None` if they are too small or too transparent for numbers.
fn merge(members: &[Splat]) -> Option<Splat> {
    let mut sum = 0.0;
    let mut mean = Vector3::zeros();
    let mut second = Matrix3::zeros();
    let mut harmonics = [[0.0; 3]; coefficients(MAX_DEGREE)];
    for splat in members {
        let scale = Vector3::from(splat.log_scale).map(|s| libm::exp(f64::from(s)));
        let opacity = 1.0 / (1.0 + libm::exp(-f64::from(splat.opacity_logit)));
        let weight = opacity * area(&scale);
        let position = Vector3::from(splat.position_m).map(f64::from);
        let root = rotation(splat) * Matrix3::from_diagonal(&scale);
        sum += weight;
        mean += position * weight;
        second += (root * root.transpose() + position * position.transpose()) * weight;
        for (all, own) in harmonics
            .as_flattened_mut()
            .iter_mut()
            .zip(splat.harmonics.as_flattened())
        {
            *all += f64::from(*own) * weight;
        }
    }
    if !(sum > 0.0 && sum.is_finite()) {
        return None;
    }
    mean /= sum;
    let covariance = second / sum - mean * mean.transpose();
    let eigen = covariance.symmetric_eigen();
    let mut axes = eigen.eigenvectors;
    if axes.determinant() < 0.0 {
        axes.set_column(2, &-axes.column(2));
    }
    let scale = eigen.eigenvalues.map(|v| v.max(MIN_VARIANCE).sqrt());
    let opacity = (sum / area(&scale)).min(MAX_OPACITY);
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Some(Splat {
        position_m: mean.map(|v| v as f32).into(),
        log_scale: scale.map(|s| libm::log(s) as f32).into(),
        rotation_wxyz: [q.w, q.i, q.j, q.k].map(|v| v as f32),
        opacity_logit: libm::log(opacity / (1.0 - opacity)) as f32,
        harmonics: harmonics.map(|rgb| rgb.map(|v| (v / sum) as f32)),
    })
}

/// Product of the two larger scales.
fn area(scale: &Vector3<f64>) -> f64 {
    scale.product() / scale.min()
}

fn rotation(splat: &Splat) -> Matrix3<f64> {
    let [w, x, y, z] = splat.rotation_wxyz.map(f64::from);
    let q = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
    q.to_rotation_matrix().into_inner()
}
