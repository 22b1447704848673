//! Disparity at infinity of a rectified recording with known positions, by another way than that of
//! `calib verify`: from two images of the left eye and the true distance between them.
//!
//! Relative rotation and direction of motion of a track segment are fitted to the epipolar
//! constraint between its two left images (five parameters; no depth enters); the true positions
//! give its length. Then every feature has a distance without the right eye, and its disparity is
//! `d0 + s f B / z`: `d0` is the disparity at infinity, and `s` differs from 1 by the error of the
//! baseline. Outliers are down-weighted by Tukey's biweight; the sigma is that of the jackknife
//! over segments.

use calib::verify::{Burst, Feature, TrackSegment};
use camera_models::StereoCalibration;
use harness::sequences::Sequence;
use nalgebra::{Matrix2, Rotation3, SMatrix, SVector, Vector2, Vector3};
use serde::Serialize;

/// Sigma of a position and of a disparity, px.
const SIGMA_PX: f64 = 0.3;

/// Result of the regression.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Infinity {
    /// Disparity at infinity beyond the nominal 0, px, and its sigma.
    pub(super) px: f64,
    pub(super) sigma_px: f64,
    /// The same as a rotation about y, degrees.
    pub(super) deg: f64,
    pub(super) sigma_deg: f64,
    /// Measured over nominal baseline.
    pub(super) baseline_ratio: f64,
    /// Number of features.
    pub(super) features: usize,
}

/// Inverse depth in the left eye, its sigma (1/m), and the disparity (px).
type Sample = [f64; 3];

/// The disparity at infinity; `None` with fewer than three segments with known motion.
pub(super) fn measure(
    sequence: &Sequence,
    nominal: &StereoCalibration,
    bursts: &[Burst],
) -> Option<Infinity> {
    let segments = bursts.iter().flat_map(|b| &b.segments);
    let segments: Vec<Vec<Sample>> = segments
        .filter_map(|segment| samples(sequence, nominal, segment))
        .collect();
    if segments.len() < 3 {
        return None;
    }
    let scale = nominal.left.fx * nominal.right_from_left.distance_m();
    let [px, slope] = line(&segments.concat(), scale);
    let without = (0..segments.len()).map(|k| {
        let rest = segments.iter().enumerate().filter(|(i, _)| *i != k);
        let rest: Vec<Sample> = rest.flat_map(|(_, s)| s).copied().collect();
        (line(&rest, scale)[0] - px).powi(2)
    });
    let count = segments.len() as f64;
    let sigma_px = (without.sum::<f64>() * (count - 1.0) / count).sqrt();
    let deg = |px: f64| (px / nominal.left.fx).to_degrees();
    Some(Infinity {
        px,
        sigma_px,
        deg: deg(px),
        sigma_deg: deg(sigma_px),
        baseline_ratio: slope,
        features: segments.iter().map(Vec::len).sum(),
    })
}

/// Features of a segment with their distances by motion.
fn samples(
    sequence: &Sequence,
    nominal: &StereoCalibration,
    segment: &TrackSegment,
) -> Option<Vec<Sample>> {
    let rig_from_left = sequence.rig().cameras[0].rig_from_left;
    let [from, to] =
        [segment.from_ns, segment.to_ns].map(|t| Some(sequence.world_from_rig(t)? * rig_from_left));
    let later_from_first = to?.inverse() * from?;
    let lens = nominal.left;
    let plane =
        |[u, v]: [f64; 2]| Vector3::new((u - lens.cx) / lens.fx, (v - lens.cy) / lens.fy, 1.0);
    let both = |f: &Feature| Some((plane(f.left), plane(f.later?), f.left[0] - f.right?[0]));
    let seen: Vec<_> = segment.features.iter().filter_map(both).collect();
    let length = later_from_first.distance_m();
    if seen.len() < 30 || length < 0.5 {
        return None;
    }
    let mut rotation = later_from_first.rotation().to_rotation_matrix();
    let mut direction = later_from_first.translation().normalize();
    let sigma = SIGMA_PX / lens.fx;
    for _ in 0..15 {
        let aside = direction.cross(&Vector3::x()).normalize();
        let sides = [aside, direction.cross(&aside)];
        let (mut information, mut gradient) =
            (SMatrix::<f64, 5, 5>::identity(), SVector::<f64, 5>::zeros());
        for (first, later, _) in &seen {
            let error = |w: Vector3<f64>, side: Vector3<f64>| {
                let normal = (direction + side).cross(&(Rotation3::new(w) * rotation * first));
                later.dot(&normal) / normal.xy().norm()
            };
            let now = error(Vector3::zeros(), Vector3::zeros());
            let weight = tukey(now / sigma) / (sigma * sigma);
            let step = 1e-6;
            let by = SVector::<f64, 5>::from_fn(|k, _| {
                let mut w = Vector3::zeros();
                let mut side = Vector3::zeros();
                if k < 3 {
                    w[k] = step;
                } else {
                    side = sides[k - 3] * step;
                }
                (error(w, side) - now) / step
            });
            information += by * by.transpose() * weight;
            gradient -= by * (now * weight);
        }
        let step = information.cholesky()?.solve(&gradient);
        rotation = Rotation3::new(step.fixed_rows::<3>(0).into_owned()) * rotation;
        direction = (direction + sides[0] * step[3] + sides[1] * step[4]).normalize();
    }
    let translation = direction * length;
    let sample = |(first, later, disparity): &(Vector3<f64>, Vector3<f64>, f64)| {
        let x = rotation * first;
        let normal = translation.cross(&x);
        let is_inlier = (later.dot(&normal) / normal.xy().norm()).abs() < 3.0 * sigma;
        let at = x.xy() - later.xy() * x.z;
        let by = translation.xy() - later.xy() * translation.z;
        let per_metre = -by.dot(&at) / by.norm_squared();
        is_inlier.then_some([per_metre, sigma * 2.0_f64.sqrt() / by.norm(), *disparity])
    };
    Some(seen.iter().filter_map(sample).collect())
}

/// Intercept and slope of disparities over `scale` times inverse depth, with errors in both.
fn line(samples: &[Sample], scale: f64) -> [f64; 2] {
    let mut found = Vector2::new(0.0, 1.0);
    for round in 0..30 {
        // From a wide to a narrow rejection of outliers.
        let wide = 1.0 + 10.0 * (0.7_f64).powi(round);
        let (mut information, mut gradient) = (Matrix2::identity() * 1e-9, Vector2::zeros());
        for [per_metre, sigma, disparity] in samples {
            let by = Vector2::new(1.0, scale * per_metre);
            let error = disparity - by.dot(&found);
            let sigma = SIGMA_PX.hypot(found.y * scale * sigma);
            let weight = tukey(error / (sigma * wide)) / (sigma * sigma);
            information += by * by.transpose() * weight;
            gradient += by * (error * weight);
        }
        found += information.try_inverse().unwrap_or_default() * gradient;
    }
    found.into()
}

fn tukey(off: f64) -> f64 {
    let ratio = off / 4.685;
    (1.0 - (ratio * ratio).min(1.0)).powi(2)
}
