//! Features of one camera: tracked from frame to frame and matched in stereo.
//!
//! Contract: [`Tracker::track`] takes the next frame; a feature that is not found reliably is lost,
//! and its id is never used again. [`Tracker::detect_new`] detects features where there are none. A
//! stereo match satisfies the epipolar constraint of the calibration, as far as that is known; a
//! feature without a stereo match is still tracked.

use camera_models::Eye as Side;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::backend::observation::{BearingMeasurement, BearingObservation, Camera};
use crate::config::FrontendConfig;
use crate::frontend::descriptor::describe;
use crate::frontend::detector::{Search, detect};
use crate::keyframe::Keypoint;
use imaging::Pyramid;
use imaging::klt::{self, normalized_patch};

/// Side of tracked patches, px: a row is one vector register.
const PATCH_SIDE: usize = 8;

/// A tracked feature.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Track {
    pub(crate) id: u64,
    /// Position in the left image, px.
    pub(crate) at: [f32; 2],
    pub(crate) left: BearingMeasurement,
    /// Position in the right image and its bearing, if matched.
    pub(crate) right_at: Option<[f32; 2]>,
    pub(crate) right: Option<BearingMeasurement>,
    /// Inverse range from the left camera by stereo, 1/m.
    pub(crate) rho: Option<f64>,
}

/// Predicted position of a feature.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PredictedPixel {
    /// Position in the left image, px.
    pub(crate) at: [f32; 2],
    /// Predicted inverse range, 1/m.
    pub(crate) rho: Option<f64>,
}

/// Tracker of one camera.
#[derive(Clone, Debug)]
pub(crate) struct Tracker {
    config: FrontendConfig,
    left: Pyramid,
    right: Pyramid,
    /// See [`crate::View::mask`]; empty for no mask.
    mask: Vec<u8>,
    /// Sorted by id.
    pub(crate) tracks: Vec<Track>,
}

impl Tracker {
    /// Creates a tracker without an image.
    pub(crate) fn new(config: FrontendConfig) -> Self {
        Self {
            config,
            left: Pyramid::default(),
            right: Pyramid::default(),
            mask: Vec::new(),
            tracks: Vec::new(),
        }
    }

    /// Sets the mask of the next frame.
    pub(crate) fn set_mask(&mut self, mask: Option<&[u8]>) {
        self.mask.clear();
        self.mask.extend_from_slice(mask.unwrap_or_default());
    }

    /// Masks all rows of the next frame from this one down.
    pub(crate) fn mask_rows_below(&mut self, rows: usize, width: usize, height: usize) {
        if rows >= height {
            return;
        }
        self.mask.resize(width * height, 1);
        self.mask[rows * width..].fill(0);
    }

    fn mask(&self) -> Option<&[u8]> {
        (!self.mask.is_empty()).then_some(&self.mask[..])
    }

    /// Tracks all features into the next frame, starting at their predictions.
    pub(crate) fn track(
        &mut self,
        camera: &Camera,
        left: Pyramid,
        right: Pyramid,
        expect: impl Fn(&Track) -> PredictedPixel + Sync,
    ) {
        let before = std::mem::replace(&mut self.left, left);
        self.right = right;
        let left = &self.left;
        let width = left.levels.first().map_or(0, |level| level.width);
        let mask = self.mask();
        let config = &self.config;
        let tracked = self.tracks.par_iter().with_min_len(8).map(|track| {
            let expected = expect(track);
            let at = klt::track::<PATCH_SIDE>(
                &config.klt,
                &before,
                left,
                track.at,
                expected.at,
                config.temporal_max_level,
            )?;
            let pixel = at[1].round() as usize * width + at[0].round() as usize;
            if mask.is_some_and(|mask| mask.get(pixel) == Some(&0)) {
                return None;
            }
            let bearing = camera.bearing(Side::Left, at)?;
            let mut track = Track {
                at,
                left: bearing,
                right_at: None,
                right: None,
                rho: None,
                ..*track
            };
            self.match_stereo(camera, &mut track, expected.rho);
            Some(track)
        });
        let tracked: Vec<Option<Track>> = tracked.collect();
        self.tracks = tracked.into_iter().flatten().collect();
        self.drop_duplicates();
    }

    /// Drops the newer ones of features that converged to the same position.
    fn drop_duplicates(&mut self) {
        let near = self.config.min_track_distance_px as f32;
        let mut distinct: Vec<Track> = Vec::with_capacity(self.tracks.len());
        for track in &self.tracks {
            if !distinct.iter().any(|k| k.is_near(track, near)) {
                distinct.push(*track);
            }
        }
        self.tracks = distinct;
    }

    /// Detects new features until there are enough; their ids are counted from `next`.
    pub(crate) fn detect_new(&mut self, camera: &Camera, next: &mut u64) {
        let max_count = self.config.max_features;
        let Some(level) = self.left.levels.first() else {
            return;
        };
        let occupied: Vec<[f32; 2]> = self.tracks.iter().map(|t| t.at).collect();
        // More cells than features, since some have no texture.
        let area = (level.width * level.height) as f64;
        let cell =
            (area / (self.config.cells_per_feature * max_count.max(1) as f64)).sqrt() as usize;
        let search = Search {
            cell: cell.max(self.config.min_cell_px),
            occupied: &occupied,
            mask: self.mask(),
            max_count: max_count.saturating_sub(occupied.len()),
        };
        let found = detect(&self.config.detector, level, &search);
        let found = found.par_iter().with_min_len(8);
        let found = found.map(|at| self.begin(camera, 0, *at, None));
        let found: Vec<Option<Track>> = found.collect();
        for mut track in found.into_iter().flatten() {
            track.id = *next;
            *next += 1;
            self.tracks.push(track);
        }
    }

    /// Creates the feature at a position in the left image, with its stereo match; `expected` may
    /// predict its inverse range.
    fn begin(&self, camera: &Camera, id: u64, at: [f32; 2], rho: Option<f64>) -> Option<Track> {
        let mut track = Track {
            id,
            at,
            left: camera.bearing(Side::Left, at)?,
            right_at: None,
            right: None,
            rho: None,
        };
        self.match_stereo(camera, &mut track, rho);
        Some(track)
    }

    /// Matches a feature in the right image; `expected` may predict its inverse range.
    fn match_stereo(&self, camera: &Camera, track: &mut Track, expected: Option<f64>) {
        let FrontendConfig { klt, stereo, .. } = &self.config;
        let from = |guess: [f32; 2], coarsest: usize| {
            let found =
                klt::track::<PATCH_SIDE>(klt, &self.left, &self.right, track.at, guess, coarsest)?;
            let bearing = camera.bearing(Side::Right, found)?;
            let (rho, epipolar_error) = camera.triangulate(&track.left, &bearing);
            let tolerance = || {
                let sigma = camera.epipolar_sigma(&track.left, &bearing, rho);
                stereo.max_epipolar_error_px + stereo.epipolar_sigmas * sigma
            };
            // A distant point may have a slightly negative inverse range.
            let fits = (epipolar_error < stereo.max_epipolar_error_px
                || epipolar_error < tolerance())
                && rho < 1.0 / stereo.min_distance_m
                && rho > stereo.min_inverse_range_per_m;
            fits.then_some((found, bearing, rho))
        };
        let tried = expected
            .and_then(|rho| camera.project_right(&track.left.ray, rho))
            .and_then(|guess| from(guess, stereo.max_level));
        let found = tried.or_else(|| {
            let guess = self.search_epipolar(camera, track)?;
            from(guess, stereo.search_level)
        });
        if let Some((at, bearing, rho)) = found {
            track.right_at = Some(at);
            track.right = Some(bearing);
            track.rho = Some(rho.max(crate::backend::solver::MIN_INVERSE_RANGE_PER_M));
        }
    }

    /// Best match along the epipolar line on a coarse level.
    fn search_epipolar(&self, camera: &Camera, track: &Track) -> Option<[f32; 2]> {
        let (klt, config) = (&self.config.klt, &self.config.stereo);
        let (ray, at) = (&track.left.ray, track.at);
        let level = config.search_level.min(self.left.levels.len() - 1);
        let scale = (1_u32 << level) as f32;
        let template = normalized_patch::<PATCH_SIDE>(
            klt,
            &self.left.levels[level],
            at[0] / scale,
            at[1] / scale,
        )?;
        let far = camera.project_right(ray, 0.0)?;
        let near = camera.project_right(ray, 1.0 / config.min_distance_m)?;
        let length = (near[0] - far[0]).hypot(near[1] - far[1]) / scale;
        // One step beyond either end, so that a maximum at an end is recognized.
        let steps = length.ceil() as i32;
        let mut scores = Vec::with_capacity(steps as usize + 3);
        for k in -1..=steps + 1 {
            let rho = f64::from(k) / f64::from(steps.max(1)) / config.min_distance_m;
            let score = camera.project_right(ray, rho).and_then(|[x, y]| {
                let there = normalized_patch::<PATCH_SIDE>(
                    klt,
                    &self.right.levels[level],
                    x / scale,
                    y / scale,
                )?;
                let products = template.as_flattened().iter().zip(there.as_flattened());
                Some(products.map(|(a, b)| a * b).sum::<f32>())
            });
            scores.push((score.unwrap_or(-1.0), rho));
        }
        let (best, top) = scores
            .iter()
            .enumerate()
            .max_by(|a, b| a.1.0.total_cmp(&b.1.0))?;
        if top.0 < config.min_ncc as f32 {
            return None;
        }
        let other = scores
            .iter()
            .enumerate()
            .filter(|(k, _)| k.abs_diff(best) > 2)
            .map(|(_, s)| s.0)
            .fold(-1.0, f32::max);
        if top.0 < other + config.min_ncc_margin as f32 {
            return None;
        }
        camera.project_right(ray, top.1)
    }

    /// Pyramid of the left image.
    pub(crate) fn image(&self) -> &Pyramid {
        &self.left
    }

    /// Whether a feature with this id is tracked.
    pub(crate) fn is_tracked(&self, id: u64) -> bool {
        self.tracks.binary_search_by_key(&id, |t| t.id).is_ok()
    }

    /// Finds the patch around `at` of another image in both images, near the prediction.
    pub(crate) fn find(
        &self,
        camera: &Camera,
        (patch, at): (&Pyramid, [f32; 2]),
        id: u64,
        expected: PredictedPixel,
    ) -> Option<Track> {
        let at = klt::track::<PATCH_SIDE>(
            &self.config.klt,
            patch,
            &self.left,
            at,
            expected.at,
            self.config.stereo.max_level,
        )?;
        let width = self.left.levels.first()?.width;
        let pixel = at[1].round() as usize * width + at[0].round() as usize;
        if self.mask().is_some_and(|mask| mask.get(pixel) == Some(&0)) {
            return None;
        }
        self.begin(camera, id, at, expected.rho)
    }

    /// Adds a feature to the tracks, unless one is tracked at its position. Returns whether it was
    /// added.
    pub(crate) fn insert(&mut self, track: Track) -> bool {
        let near = self.config.min_handover_distance_px as f32;
        if self.tracks.iter().any(|k| k.is_near(&track, near)) {
            return false;
        }
        let index = self.tracks.partition_point(|k| k.id < track.id);
        self.tracks.insert(index, track);
        true
    }

    /// Keypoints for loop closure: the strongest corners, tracked or not.
    pub(crate) fn keypoints(&self, camera: &Camera, index: usize) -> Vec<Keypoint> {
        let (Some(level), Some(half)) = (self.left.levels.first(), self.left.levels.get(1)) else {
            return Vec::new();
        };
        let search = Search {
            cell: self.config.keypoints.cell_px,
            occupied: &[],
            mask: self.mask(),
            max_count: self.config.keypoints.max_keypoints,
        };
        let found = detect(&self.config.detector, level, &search);
        let keypoints = found.par_iter().with_min_len(8).map(|at| {
            let descriptor = describe(half, 0.5 * at[0], 0.5 * at[1])?;
            let track = self.begin(camera, 0, *at, None)?;
            Some(Keypoint {
                camera: index as u8,
                left: *at,
                rho: track.rho.map_or(0.0, |rho| rho as f32),
                descriptor,
            })
        });
        let keypoints: Vec<Option<Keypoint>> = keypoints.collect();
        keypoints.into_iter().flatten().collect()
    }

    /// Removes all tracks and images.
    pub(crate) fn clear(&mut self) {
        *self = Self::new(self.config);
    }
}

impl Track {
    fn is_near(&self, other: &Self, px: f32) -> bool {
        (0..2).all(|k| (self.at[k] - other.at[k]).abs() < px)
    }

    /// The observation for the window, with the exposure offset of the camera against its frame, s.
    pub(crate) fn observation(
        &self,
        index: usize,
        camera: &Camera,
        exposure_offset_s: f64,
    ) -> BearingObservation {
        BearingObservation {
            camera: index,
            left: self.left,
            right: self.right,
            exposure_offset_s: exposure_offset_s + camera.row_after_s(Side::Left, self.at[1]),
        }
    }
}

/// Pixel and inverse range of a point after the motion `now_from_then` of the left camera.
pub(crate) fn transfer_pixel(
    camera: &Camera,
    now_from_then: &(Matrix3<f64>, Vector3<f64>),
    ray: &Vector3<f64>,
    rho: f64,
) -> Option<PredictedPixel> {
    let x = now_from_then.0 * ray + now_from_then.1 * rho;
    let at = camera.left.project(x.into())?;
    Some(PredictedPixel {
        at: at.map(|v| v as f32),
        rho: Some(rho / x.norm()),
    })
}
