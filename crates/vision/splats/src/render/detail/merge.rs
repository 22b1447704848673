//! Merging of Gaussians by moments.
//!
//! Weights are optical depths, `-ln(1 - opacity)`, times areas: the product of the two larger
//! scales, with the dilation of the images in which the merged Gaussian is to be used. Mean and
//! covariance are those of the mixture (law of total variance), the color is the weighted mean, and
//! the opacity keeps the sum of the weights: it is that of all together where they cover each
//! other, and their mean where they lie side by side.

use nalgebra::{Matrix3, Quaternion, Rotation3, UnitQuaternion, Vector3};

use super::config::DetailConfig;
use crate::scene::{MAX_DEGREE, Splat, Splats, coefficients};

/// Largest opacity of a merged Gaussian.
const MAX_OPACITY: f64 = 0.99;

/// Smallest variance of a merged Gaussian, m².
const MIN_VARIANCE: f64 = 1e-14;

/// How Gaussians are merged.
#[derive(Clone, Copy, Debug)]
pub(super) struct Merging {
    /// Neighbors that become one.
    pub(super) count: usize,
    /// Largest factor on the largest scale of them.
    pub(super) max_growth: f32,
    /// Standard deviation of the dilation, as a share of the largest scale of the merged Gaussian.
    pub(super) dilation: f64,
}

impl Merging {
    pub(super) fn new(config: &DetailConfig) -> Self {
        let dilation = f64::from(config.dilation_px2).sqrt() / f64::from(config.max_sigma_px);
        Self {
            count: config.merge,
            max_growth: config.max_growth,
            // Without coarser levels it has no meaning.
            dilation: if dilation.is_finite() { dilation } else { 0.0 },
        }
    }
}

/// Each run of neighbors as one Gaussian, unless it would be too large.
pub(super) fn neighbors(splats: &Splats, merging: &Merging) -> Splats {
    let mut out = splats.select(&[]);
    let indices: Vec<usize> = (0..splats.len()).collect();
    for run in indices.chunks(merging.count) {
        let members: Vec<Splat> = run.iter().map(|i| splats.get(*i)).collect();
        let merged = (members.len() > 1)
            .then(|| merge(&members, merging.dilation))
            .flatten();
        let largest = |splat: &Splat| {
            let logs = splat.log_scale.into_iter();
            logs.fold(f32::NEG_INFINITY, f32::max)
        };
        let limit = members
            .iter()
            .map(largest)
            .fold(f32::NEG_INFINITY, f32::max)
            + libm::logf(merging.max_growth);
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
fn merge(members: &[Splat], dilation: f64) -> Option<Splat> {
    // The size of the result decides the dilation.
    let first = Mixture::of(members, 0.0)?;
    let dilation_m = dilation * first.scale.max();
    let mixture = Mixture::of(members, dilation_m)?;
    let optical_depth = mixture.weight / area(&mixture.scale, dilation_m);
    let opacity = (1.0 - libm::exp(-optical_depth)).min(MAX_OPACITY);
    let q = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(mixture.axes));
    Some(Splat {
        position_m: mixture.mean.map(|v| v as f32).into(),
        log_scale: mixture.scale.map(|s| libm::log(s) as f32).into(),
        rotation_wxyz: [q.w, q.i, q.j, q.k].map(|v| v as f32),
        opacity_logit: libm::log(opacity / (1.0 - opacity)) as f32,
        harmonics: mixture.harmonics,
    })
}

/// Moments of several Gaussians.
struct Mixture {
    weight: f64,
    mean: Vector3<f64>,
    axes: Matrix3<f64>,
    /// Along the axes.
    scale: Vector3<f64>,
    harmonics: [[f32; 3]; coefficients(MAX_DEGREE)],
}

impl Mixture {
    fn of(members: &[Splat], dilation_m: f64) -> Option<Self> {
        let mut sum = 0.0;
        let mut mean = Vector3::zeros();
        let mut second = Matrix3::zeros();
        let mut harmonics = [[0.0; 3]; coefficients(MAX_DEGREE)];
        for splat in members {
            let scale = Vector3::from(splat.log_scale).map(|s| libm::exp(f64::from(s)));
            let opacity = 1.0 / (1.0 + libm::exp(-f64::from(splat.opacity_logit)));
            let optical_depth = -libm::log1p(-opacity.min(MAX_OPACITY));
            let weight = optical_depth * area(&scale, dilation_m);
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
        Some(Self {
            weight: sum,
            mean,
            axes,
            scale: eigen.eigenvalues.map(|v| v.max(MIN_VARIANCE).sqrt()),
            harmonics: harmonics.map(|rgb| rgb.map(|v| (v / sum) as f32)),
        })
    }
}

/// Product of the two larger scales of a Gaussian with dilation, m².
fn area(scale: &Vector3<f64>, dilation_m: f64) -> f64 {
    let dilated = scale.map(|s| libm::sqrt(s * s + dilation_m * dilation_m));
    dilated.product() / dilated.min()
}

fn rotation(splat: &Splat) -> Matrix3<f64> {
    let [w, x, y, z] = splat.rotation_wxyz.map(f64::from);
    let q = UnitQuaternion::new_normalize(Quaternion::new(w, x, y, z));
    q.to_rotation_matrix().into_inner()
}
