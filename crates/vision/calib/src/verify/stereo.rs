//! Rotation of the right eye of a stereo camera against the left one, from matched corners.
//!
//! Two independent observations determine it, and are solved together:
//!
//! - *Epipolar errors* of matches. Pitch moves all rows equally, roll moves rows left and right
//!   oppositely, a displaced centre moves those of near points. Yaw moves rows in the corners only,
//!   exactly as a decentered lens does: rows alone determine it no better than the lens
//!   ([`StereoConfig::lens_sigma`]).
//! - *Parallax* between frames ([`Parallax`]), which determines the disparity at infinity, and with
//!   it yaw, as far as the camera moves and observes near and far points.
//!
//! The differences of the lenses are unknowns with a prior. Residuals of neighbouring matches are
//! correlated, because lenses deviate from their model and objects move: the covariance is that of
//! the jackknife over bursts and over image regions ([`ClusterSums::jackknife`]).

use camera_models::StereoCalibration;
use nalgebra::{Matrix1, Matrix3, SVector, Vector3};

use serde::Serialize;

use super::camera::Camera;
use super::config::{Config, StereoConfig};
use super::pair::{STEREO_PARAMETERS, StereoPair, TriangulatedMatch};
use super::parallax::Parallax;
use super::robust::{ClusterSums, median, sigmas_of, tukey};
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
    /// Number of track segments with enough parallax.
    pub parallax_segments: usize,
    /// Number of track segments.
    pub segments: usize,
    /// The stereo pair with the estimate.
    #[serde(skip)]
    pub(super) pair: StereoPair,
}

impl StereoAlignment {
    /// What a recording needs to determine the rotation, from what this one lacks.
    pub(super) fn remedy(&self) -> &'static str {
        match self.parallax_segments {
            0 => "move while recording, past near and far texture in good light",
            _ => "record longer, past near and far texture in good light",
        }
    }
}

/// A match: its burst, left pixel and ray, right pixel.
struct Match {
    group: usize,
    left: [f64; 2],
    ray: Vector3<f64>,
    right: [f64; 2],
}

/// The epipolar errors of all matches under one calibration.
struct Rows<'a> {
    matches: &'a [Match],
    placed: Vec<Option<TriangulatedMatch>>,
    spread_px: f64,
}

impl<'a> Rows<'a> {
    fn new(pair: &StereoPair, matches: &'a [Match], config: &StereoConfig) -> Self {
        let triangulate = |m: &Match| pair.triangulate(&m.ray, m.right);
        let placed: Vec<Option<TriangulatedMatch>> = matches.iter().map(triangulate).collect();
        let sizes = placed.iter().flatten().map(|p| p.epipolar_error.abs());
        let spread = 1.4826 * median(&mut sizes.collect::<Vec<f64>>());
        Self {
            matches,
            placed,
            spread_px: spread.max(config.min_spread_px),
        }
    }

    /// Matches that are not outliers, with their weights, 1/px².
    fn inliers(&self) -> impl Iterator<Item = (&Match, &TriangulatedMatch, f64)> {
        let all = self.matches.iter().zip(&self.placed);
        all.filter_map(|(m, placed)| {
            let placed = placed.as_ref()?;
            let weight = tukey(placed.epipolar_error / self.spread_px);
            (weight > 0.0).then(|| (m, placed, weight / self.spread_px.powi(2)))
        })
    }
}

/// Runs the estimation; `None` with too few matches or too few inliers.
pub(super) fn estimate(camera: &Camera<'_>, all: &Config) -> Option<StereoAlignment> {
    let (nominal, bursts, config) = (camera.nominal, camera.bursts, &all.stereo);
    let mut pair = StereoPair::new(nominal);
    let matches = matches(&pair, bursts);
    if matches.len() < config.min_matches {
        return None;
    }
    let sigmas = prior(nominal, config);
    let [columns, rows] = config.regions;
    let region = |[x, y]: [f64; 2]| {
        let index = |at: f64, size: u32, count: usize| {
            ((at / f64::from(size) * count as f64).max(0.0) as usize).min(count - 1)
        };
        index(x, nominal.left.width, columns) + columns * index(y, nominal.left.height, rows)
    };
    let groups = [bursts.len(), columns * rows];
    let add_rows = |pair: &StereoPair| {
        let of = Rows::new(pair, &matches, config);
        let mut sum = ClusterSums::<STEREO_PARAMETERS>::new(&groups, &sigmas, &-pair.unknowns());
        for (m, placed, weight) in of.inliers() {
            sum.add(
                &[m.group, region(m.left)],
                &Matrix1::new(placed.epipolar_error),
                &placed.epipolar_by,
                &Matrix1::new(weight),
            );
        }
        sum
    };
    for _ in 0..config.rounds {
        let step = add_rows(&pair).step()?;
        let unknowns = pair.unknowns() + step;
        pair.set(&unknowns);
    }
    let mut parallax = Parallax::new(camera, all);
    let sigma = config.rotation_sigma_rad / nominal.right_from_left.distance_m();
    for _ in 0..all.parallax.start_rounds {
        let mut unknowns = *pair.unknowns();
        let turn = pair.rotation_of_offset(parallax.offset(&pair, sigma));
        let turn = unknowns.fixed_rows::<3>(0) + turn;
        unknowns.fixed_rows_mut::<3>(0).copy_from(&turn);
        pair.set(&unknowns);
    }
    let mut last = None;
    for _ in 0..all.parallax.rounds {
        let mut sum = add_rows(&pair);
        let (residuals, segments) = parallax.residuals(&pair);
        for r in &residuals {
            sum.add(&[r.group, region(r.pixel)], &r.error, &r.by, &r.weight);
        }
        let unknowns = pair.unknowns() + sum.step()?;
        pair.set(&unknowns);
        last = Some((sum, segments));
    }
    let (sum, segments) = last?;
    let found = Rows::new(&pair, &matches, config);
    let used = found.inliers().count();
    if used < config.min_matches || (used as f64) < config.min_inlier_ratio * matches.len() as f64 {
        return None;
    }
    let floor = config.sigma_floor_px / nominal.right.fx;
    let covariance = sum.jackknife()?.fixed_view::<3, 3>(0, 0).into_owned()
        + Matrix3::identity() * (floor * floor);
    let before = Rows::new(&StereoPair::new(nominal), &matches, config);
    let spread_px = found.spread_px;
    let kept = (found.placed.iter().zip(&before.placed)).filter_map(|(found, before)| {
        let (found, before) = (
            found.as_ref()?.epipolar_error,
            before.as_ref()?.epipolar_error,
        );
        (tukey(found / spread_px) > 0.0).then_some((before, found))
    });
    let (nominal_px, found_px): (Vec<f64>, Vec<f64>) = kept.unzip();
    let rms = |values: &[f64]| {
        (values.iter().map(|v| v * v).sum::<f64>() / values.len().max(1) as f64).sqrt()
    };
    Some(StereoAlignment {
        rotation_rad: pair.unknowns().fixed_rows::<3>(0).into_owned().into(),
        sigma_rad: sigmas_of(&covariance),
        covariance,
        nominal_rms_px: rms(&nominal_px),
        found_rms_px: rms(&found_px),
        nominal_px,
        found_px,
        matches: used,
        of: matches.len(),
        parallax_segments: segments,
        segments: bursts.iter().map(|b| b.segments.len()).sum(),
        pair,
    })
}

fn matches(pair: &StereoPair, bursts: &[Burst]) -> Vec<Match> {
    let mut matches = Vec::new();
    for (group, burst) in bursts.iter().enumerate() {
        for feature in burst.segments.iter().flat_map(|m| &m.features) {
            let ray = pair.left().unproject(feature.left);
            matches.extend(ray.zip(feature.right).map(|(ray, right)| Match {
                group,
                left: feature.left,
                ray: ray.into(),
                right,
            }));
        }
    }
    matches
}

/// Prior sigmas of the unknowns.
fn prior(nominal: &StereoCalibration, config: &StereoConfig) -> SVector<f64, STEREO_PARAMETERS> {
    let turn = config.rotation_sigma_rad;
    let centre = config.center_sigma_ratio * nominal.right_from_left.distance_m();
    let lens = config.lens_sigma;
    SVector::from_fn(|k, _| match k {
        0..3 => turn,
        3..5 => centre,
        _ => lens,
    })
}
