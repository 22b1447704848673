//! Features of one camera: tracked from frame to frame and matched in stereo.
//!
//! Contract: [`Tracker::track`] takes the next frame; a feature that is not found reliably is lost,
//! and its id is never used again. [`Tracker::detect_new`] detects features where there are none. A
//! stereo match satisfies the epipolar constraint of the calibration; a feature without a stereo
//! match is still tracked.

use calib::Eye as Side;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::backend::observation::{BearingMeasurement, BearingObservation, Camera};
use crate::frontend::descriptor::describe;
use crate::frontend::detector::{Search, detect};
use crate::frontend::klt::{self, normalized_patch};
use crate::frontend::pyramid::Pyramid;
use crate::keyframe::Keypoint;

/// Coarsest pyramid level of temporal and of stereo tracking.
const TEMPORAL_MAX_LEVEL: usize = 3;
const STEREO_MAX_LEVEL: usize = 1;
/// Pyramid level of the epipolar search.
const SEARCH_LEVEL: usize = 1;
/// Minimum distance of a stereo match, m.
const MIN_DISTANCE_M: f64 = 0.3;
/// Maximum epipolar error of a stereo match, px.
const MAX_EPIPOLAR_ERROR_PX: f64 = 1.5;
/// Number of grid cells per requested feature.
const CELL_COUNT_FACTOR: f64 = 1.3;
/// Maximum number of keypoints for loop closure, and the side of the grid cells with one keypoint
/// each, px.
const MAX_KEYPOINTS: usize = 160;
const KEYPOINT_CELL_PX: usize = 20;
/// Minimum NCC of a match on the coarse level, and its minimum margin over all non-adjacent
/// candidates.
const MIN_NCC: f32 = 0.75;
const MIN_NCC_MARGIN: f32 = 0.05;

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
pub(crate) struct Expected {
    /// Position in the left image, px.
    pub(crate) at: [f32; 2],
    /// Predicted inverse range, 1/m.
    pub(crate) rho: Option<f64>,
}

/// Tracker of one camera.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tracker {
    left: Pyramid,
    right: Pyramid,
    /// See [`crate::View::mask`]; empty for no mask.
    mask: Vec<u8>,
    /// Sorted by id.
    pub(crate) tracks: Vec<Track>,
}

impl Tracker {
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
        expect: impl Fn(&Track) -> Expected + Sync,
    ) {
        let before = std::mem::replace(&mut self.left, left);
        self.right = right;
        let (left, right) = (&self.left, &self.right);
        let width = left.levels.first().map_or(0, |level| level.width);
        let mask = self.mask();
        let tracked = self.tracks.par_iter().with_min_len(8).map(|track| {
            let expected = expect(track);
            let at = klt::track(&before, left, track.at, expected.at, TEMPORAL_MAX_LEVEL)?;
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
            match_stereo(&mut track, camera, left, right, expected.rho);
            Some(track)
        });
        let tracked: Vec<Option<Track>> = tracked.collect();
        self.tracks = tracked.into_iter().flatten().collect();
        self.drop_duplicates();
    }

    /// Drops the newer ones of features that converged to the same position.
    fn drop_duplicates(&mut self) {
        const NEAR: f32 = 4.0;
        let mut distinct: Vec<Track> = Vec::with_capacity(self.tracks.len());
        for track in &self.tracks {
            if !distinct.iter().any(|k| k.is_near(track, NEAR)) {
                distinct.push(*track);
            }
        }
        self.tracks = distinct;
    }

    /// Detects new features until there are `max_count`; their ids are counted from `next`.
    pub(crate) fn detect_new(&mut self, camera: &Camera, max_count: usize, next: &mut u64) {
        let Some(level) = self.left.levels.first() else {
            return;
        };
        let occupied: Vec<[f32; 2]> = self.tracks.iter().map(|t| t.at).collect();
        // More cells than features, since some have no texture.
        let area = (level.width * level.height) as f64;
        let cell = (area / (CELL_COUNT_FACTOR * max_count.max(1) as f64)).sqrt() as usize;
        let search = Search {
            cell: cell.max(8),
            occupied: &occupied,
            mask: self.mask(),
            max_count: max_count.saturating_sub(occupied.len()),
        };
        let found = detect(level, &search);
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
        match_stereo(&mut track, camera, &self.left, &self.right, rho);
        Some(track)
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
        expected: Expected,
    ) -> Option<Track> {
        let at = klt::track(patch, &self.left, at, expected.at, STEREO_MAX_LEVEL)?;
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
        const NEAR: f32 = 6.0;
        if self.tracks.iter().any(|k| k.is_near(&track, NEAR)) {
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
            cell: KEYPOINT_CELL_PX,
            occupied: &[],
            mask: self.mask(),
            max_count: MAX_KEYPOINTS,
        };
        let found = detect(level, &search);
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
        *self = Self::default();
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

/// Pixel in the right image of a left ray at an inverse range.
fn project_right(camera: &Camera, ray: &Vector3<f64>, rho: f64) -> Option<[f32; 2]> {
    let (rotation, origin) = &camera.right_from_left;
    let x = rotation * ray + origin * rho;
    camera
        .right
        .project(x.into())
        .map(|pixel| pixel.map(|v| v as f32))
}

fn match_stereo(
    track: &mut Track,
    camera: &Camera,
    left: &Pyramid,
    right: &Pyramid,
    expected: Option<f64>,
) {
    let from = |guess: [f32; 2], coarsest: usize| {
        let found = klt::track(left, right, track.at, guess, coarsest)?;
        let bearing = camera.bearing(Side::Right, found)?;
        let (rho, epipolar_error) = camera.triangulate(&track.left, &bearing);
        // A distant point may have a slightly negative inverse range.
        let fits =
            epipolar_error < MAX_EPIPOLAR_ERROR_PX && rho < 1.0 / MIN_DISTANCE_M && rho > -0.05;
        fits.then_some((found, bearing, rho))
    };
    let tried = expected
        .and_then(|rho| project_right(camera, &track.left.ray, rho))
        .and_then(|guess| from(guess, STEREO_MAX_LEVEL));
    let found = tried.or_else(|| {
        let guess = search_epipolar(camera, &track.left.ray, track.at, left, right)?;
        from(guess, SEARCH_LEVEL)
    });
    if let Some((at, bearing, rho)) = found {
        track.right_at = Some(at);
        track.right = Some(bearing);
        track.rho = Some(rho.max(crate::backend::solver::MIN_INVERSE_RANGE_PER_M));
    }
}

/// Best match along the epipolar line on a coarse level.
fn search_epipolar(
    camera: &Camera,
    ray: &Vector3<f64>,
    at: [f32; 2],
    left: &Pyramid,
    right: &Pyramid,
) -> Option<[f32; 2]> {
    let level = SEARCH_LEVEL.min(left.levels.len() - 1);
    let scale = (1_u32 << level) as f32;
    let template = normalized_patch(&left.levels[level], at[0] / scale, at[1] / scale)?;
    let far = project_right(camera, ray, 0.0)?;
    let near = project_right(camera, ray, 1.0 / MIN_DISTANCE_M)?;
    let length = (near[0] - far[0]).hypot(near[1] - far[1]) / scale;
    // One step beyond either end, so that a maximum at an end is recognized.
    let steps = length.ceil() as i32;
    let mut scores = Vec::with_capacity(steps as usize + 3);
    for k in -1..=steps + 1 {
        let rho = f64::from(k) / f64::from(steps.max(1)) / MIN_DISTANCE_M;
        let score = project_right(camera, ray, rho).and_then(|[x, y]| {
            let there = normalized_patch(&right.levels[level], x / scale, y / scale)?;
            Some(template.iter().zip(&there).map(|(a, b)| a * b).sum::<f32>())
        });
        scores.push((score.unwrap_or(-1.0), rho));
    }
    let (best, top) = scores
        .iter()
        .enumerate()
        .max_by(|a, b| a.1.0.total_cmp(&b.1.0))?;
    if top.0 < MIN_NCC {
        return None;
    }
    let other = scores
        .iter()
        .enumerate()
        .filter(|(k, _)| k.abs_diff(best) > 2)
        .map(|(_, s)| s.0)
        .fold(-1.0, f32::max);
    if top.0 < other + MIN_NCC_MARGIN {
        return None;
    }
    project_right(camera, ray, top.1)
}

/// Pixel and inverse range of a point after the motion `now_from_then` of the left camera.
pub(crate) fn transfer_pixel(
    camera: &Camera,
    now_from_then: &(Matrix3<f64>, Vector3<f64>),
    ray: &Vector3<f64>,
    rho: f64,
) -> Option<Expected> {
    let x = now_from_then.0 * ray + now_from_then.1 * rho;
    let at = camera.left.project(x.into())?;
    Some(Expected {
        at: at.map(|v| v as f32),
        rho: Some(rho / x.norm()),
    })
}
