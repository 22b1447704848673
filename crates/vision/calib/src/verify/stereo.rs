//! Rotation of the right eye of a stereo camera against the left one, from matched corners.
//!
//! Only the epipolar error of a match is used, not its position along the epipolar line. With the
//! right eye rotated by a small `w` about its own centre, and that centre displaced by `d` normal
//! to the baseline, `x_in_right = exp(w) (R x_in_left + t + d)`. Pitch moves all rows equally, roll
//! moves rows left and right oppositely, yaw moves those in the corners, `d` those of near points:
//! matches in the whole image and at several distances determine all of them. A decentred lens
//! moves rows in the corners exactly as a yaw does, so that the accuracy of yaw is limited by that
//! of the lens ([`StereoConfig::decentring_sigma`]).

use cad_transforms::so3;
use camera_models::{Lens, StereoCalibration};
use nalgebra::{Matrix1, Matrix3, Matrix3x2, RowVector2, SVector, UnitQuaternion, Vector3};

use serde::Serialize;

use super::config::StereoConfig;
use super::robust::{Grouped, median, sigmas_of, tukey};
use super::tracks::Burst;

/// Result; see the module.
#[derive(Clone, Debug, Serialize)]
pub struct StereoAlignment {
    /// `w`: takes directions in the nominal right optical frame to the actual one, rad.
    pub rotation_rad: [f64; 3],
    /// Standard deviation about each axis, rad.
    pub sigma_rad: [f64; 3],
    /// Its covariance, rad².
    #[serde(skip)]
    pub(super) covariance: Matrix3<f64>,
    /// RMS epipolar error of the matches with the nominal calibration, px, without outliers.
    pub nominal_rms_px: f64,
    /// The same with the estimate.
    pub found_rms_px: f64,
    /// Epipolar errors with the nominal calibration, px, for a histogram; without outliers.
    #[serde(skip)]
    pub nominal_px: Vec<f64>,
    /// The same with the estimate.
    #[serde(skip)]
    pub found_px: Vec<f64>,
    /// Number of matches used.
    pub matches: usize,
    /// Number of matches available.
    pub of: usize,
    /// Estimated `right_from_left`.
    #[serde(skip)]
    pub(super) right_from_left: (UnitQuaternion<f64>, Vector3<f64>),
}

/// The lenses and the relative pose of a stereo camera.
pub(super) struct StereoPair {
    pub(super) lenses: [Lens; 2],
    /// `right_from_left`.
    pub(super) turn: UnitQuaternion<f64>,
    pub(super) origin: Vector3<f64>,
}

/// A triangulated match.
pub(super) struct TriangulatedMatch {
    /// Inverse distance along the left ray, 1/m.
    pub(super) per_metre: f64,
    /// Motion of the right pixel with the inverse distance, px m.
    pub(super) px_per: f64,
    /// Epipolar error, px, and its Jacobian with respect to a point in the right optical frame.
    epipolar_error: f64,
    by_point: nalgebra::RowVector3<f64>,
    /// The point over its distance.
    point: Vector3<f64>,
}

impl StereoPair {
    pub(super) fn new(nominal: &StereoCalibration) -> Self {
        Self {
            lenses: [Lens::new(&nominal.left), Lens::new(&nominal.right)],
            turn: *nominal.right_from_left.rotation(),
            origin: *nominal.right_from_left.translation(),
        }
    }

    /// The point on the left ray whose projection is nearest to the right pixel.
    pub(super) fn triangulate(
        &self,
        ray: &Vector3<f64>,
        right: [f64; 2],
    ) -> Option<TriangulatedMatch> {
        let far = self.turn * ray;
        let mut per_metre = 0.3;
        for round in 0.. {
            let point = far + self.origin * per_metre;
            let projected = self.lenses[1].project_with_jacobians(point.into())?;
            let along = projected.by_point * self.origin;
            let px_per = along.norm();
            if px_per < 1e-9 {
                return None;
            }
            let along = along / px_per;
            let off = nalgebra::Vector2::new(
                right[0] - projected.pixel[0],
                right[1] - projected.pixel[1],
            );
            let step = along.dot(&off) / px_per;
            if round == 6 || step.abs() < 1e-7 {
                let across = RowVector2::new(-along.y, along.x);
                return Some(TriangulatedMatch {
                    per_metre,
                    px_per,
                    epipolar_error: (across * off)[0],
                    by_point: across * projected.by_point,
                    point,
                });
            }
            per_metre += step;
        }
        None
    }
}

/// Runs the estimation; `None` with too few matches or too few inliers.
pub(super) fn estimate(
    nominal: &StereoCalibration,
    bursts: &[Burst],
    config: &StereoConfig,
) -> Option<StereoAlignment> {
    let mut pair = StereoPair::new(nominal);
    let [nominal_rotation, nominal_origin] = [so3::log(&pair.turn), pair.origin];
    let nominal_rotation = so3::exp(nominal_rotation);
    let mut matches: Vec<(usize, Vector3<f64>, [f64; 2])> = Vec::new();
    for (group, burst) in bursts.iter().enumerate() {
        for feature in burst.segments.iter().flat_map(|m| &m.features) {
            let ray = pair.lenses[0].unproject(feature.left);
            matches.extend(
                ray.zip(feature.right)
                    .map(|(ray, right)| (group, Vector3::from(ray), right)),
            );
        }
    }
    if matches.len() < config.min_matches {
        return None;
    }
    let along = nominal_origin.normalize();
    let first = along.cross(&Vector3::y()).try_normalize(1e-3);
    let first = first.unwrap_or_else(|| along.cross(&Vector3::z()).normalize());
    let across = Matrix3x2::from_columns(&[first, along.cross(&first)]);
    let residuals = |pair: &StereoPair| -> Vec<Option<TriangulatedMatch>> {
        let triangulate =
            |(_, ray, right): &(usize, Vector3<f64>, [f64; 2])| pair.triangulate(ray, *right);
        matches.iter().map(triangulate).collect()
    };
    let epipolar_error = |placed: &[Option<TriangulatedMatch>]| -> Vec<f64> {
        placed.iter().flatten().map(|p| p.epipolar_error).collect()
    };
    let nominal_matches = residuals(&pair);

    let (turn, centre) = (config.rotation_sigma_rad, config.centre_sigma_m);
    let sigmas = SVector::<f64, 5>::from([turn, turn, turn, centre, centre]);
    let mut now = SVector::<f64, 5>::zeros();
    let mut last = None;
    for _ in 0..config.rounds {
        let turn = so3::exp(now.fixed_rows::<3>(0).into_owned());
        let centre = now.fixed_rows::<2>(3).into_owned();
        pair.turn = turn * nominal_rotation;
        pair.origin = turn * (nominal_origin + across * centre);
        let placed = residuals(&pair);
        let mut sizes: Vec<f64> = epipolar_error(&placed).iter().map(|b| b.abs()).collect();
        let spread = (1.4826 * median(&mut sizes)).max(config.min_spread_px);
        let mut sum = Grouped::<5>::new(bursts.len(), &sigmas, &-now);
        let (mut used, mut squares) = (0.0, 0.0);
        for (placed, (group, ..)) in placed.iter().zip(&matches) {
            let Some(p) = placed else { continue };
            let weight = tukey(p.epipolar_error / spread);
            if weight == 0.0 {
                continue;
            }
            let mut by = nalgebra::SMatrix::<f64, 1, 5>::zeros();
            by.fixed_columns_mut::<3>(0)
                .copy_from(&(-p.by_point * p.point.cross_matrix()));
            by.fixed_columns_mut::<2>(3)
                .copy_from(&(p.by_point * (turn.to_rotation_matrix() * across * p.per_metre)));
            let weight = weight / (spread * spread);
            sum.add(
                *group,
                &Matrix1::new(p.epipolar_error),
                &by,
                &Matrix1::new(weight),
            );
            used += 1.0;
            squares += p.epipolar_error * p.epipolar_error;
        }
        now += sum.step()?;
        last = Some((sum, used, squares, spread));
    }
    let (sum, used, squares, spread) = last?;
    if used < config.min_matches as f64 || used < config.min_inlier_ratio * matches.len() as f64 {
        return None;
    }
    let (covariance, larger) = sum.covariance(&[0, 1, 2])?;
    let floor = config.sigma_floor_px / nominal.right.fx;
    let mut covariance = covariance.fixed_view::<3, 3>(0, 0).into_owned() * larger
        + Matrix3::identity() * (floor * floor);
    covariance[(1, 1)] += (2.0 * config.decentring_sigma).powi(2);
    let found_placed = residuals(&pair);
    let limit = 4.685 * spread;
    let kept = |i: usize| {
        let found = found_placed[i].as_ref()?.epipolar_error;
        let nominal = nominal_matches[i].as_ref()?.epipolar_error;
        (found.abs() < limit).then_some((nominal, found))
    };
    let kept: Vec<(f64, f64)> = (0..matches.len()).filter_map(kept).collect();
    let rms = |values: &[f64]| {
        (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt()
    };
    let (nominal_px, found_px): (Vec<f64>, Vec<f64>) = kept.into_iter().unzip();
    Some(StereoAlignment {
        rotation_rad: now.fixed_rows::<3>(0).into_owned().into(),
        sigma_rad: sigmas_of(&covariance),
        covariance,
        nominal_rms_px: rms(&nominal_px),
        found_rms_px: (squares / used).sqrt(),
        nominal_px,
        found_px,
        matches: used as usize,
        of: matches.len(),
        right_from_left: (pair.turn, pair.origin),
    })
}
