//! Corners of one camera, followed from picture to picture and matched between its eyes.
//!
//! Contract: [`Tracker::track`] takes the next picture; what cannot be found for sure is lost and never comes back under the
//! same number. [`Tracker::detect_new`] looks for new corners where there are none. A match between the eyes keeps to the epipolar line of
//! the calibration; without one a corner is followed all the same.

use calib::Eye as Side;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::backend::observation::{BearingMeasurement, BearingObservation, Camera};
use crate::frontend::descriptor::describe;
use crate::frontend::detector::{Search, detect};
use crate::frontend::klt::{self, normalized_patch};
use crate::frontend::pyramid::Pyramid;
use crate::keyframe::Keypoint;

/// Coarsest level on which corners are followed in time, and between the eyes.
const TEMPORAL_MAX_LEVEL: usize = 3;
const STEREO_MAX_LEVEL: usize = 1;
/// Level on which a match between the eyes is searched.
const SEARCH_LEVEL: usize = 1;
/// Nearest thing that eyes are matched on, m.
const MIN_DISTANCE_M: f64 = 0.3;
/// How far off the epipolar line a match may lie, px.
const MAX_EPIPOLAR_ERROR_PX: f64 = 1.5;
/// Cells of the grid for each corner that is wanted.
const CELL_COUNT_FACTOR: f64 = 1.3;
/// Corners kept to find a place again by, and the cells of which each gives one, pixels.
const MAX_KEYPOINTS: usize = 160;
const KEYPOINT_CELL_PX: usize = 20;
/// Least correlation of a match on the coarse level, and by how much it must be better than any other not beside it.
const MIN_NCC: f32 = 0.75;
const MIN_NCC_MARGIN: f32 = 0.05;

/// A corner that is followed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Track {
    pub(crate) id: u64,
    /// In the left picture.
    pub(crate) at: [f32; 2],
    pub(crate) left: BearingMeasurement,
    /// In the right one, if it was found there: where, and in which direction.
    pub(crate) right_at: Option<[f32; 2]>,
    pub(crate) right: Option<BearingMeasurement>,
    /// Inverse range from the left eye as the eyes tell it, 1/m.
    pub(crate) rho: Option<f64>,
}

/// Where a corner is expected.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Expected {
    /// In the left picture.
    pub(crate) at: [f32; 2],
    /// Inverse range then, 1/m.
    pub(crate) rho: Option<f64>,
}

/// See the module.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tracker {
    left: Pyramid,
    right: Pyramid,
    /// See [`crate::View::mask`]; empty for all.
    mask: Vec<u8>,
    /// By number, rising.
    pub(crate) tracks: Vec<Track>,
}

impl Tracker {
    /// Says which pixels of the next picture may be followed.
    pub(crate) fn set_mask(&mut self, mask: Option<&[u8]>) {
        self.mask.clear();
        self.mask.extend_from_slice(mask.unwrap_or_default());
    }

    /// Says how many rows of it, from the top, may be followed.
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

    /// Follows all corners into the next picture, starting where they are expected.
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

    /// Of corners that have run together the newer ones are given up.
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

    /// Looks for new corners until there are `max_count`; they get the numbers from `next` on.
    pub(crate) fn detect_new(&mut self, camera: &Camera, max_count: usize, next: &mut u64) {
        let Some(level) = self.left.levels.first() else {
            return;
        };
        let occupied: Vec<[f32; 2]> = self.tracks.iter().map(|t| t.at).collect();
        // Somewhat more cells than corners, since some are blank.
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

    /// A corner at a place of the left picture, with what the right eye sees of it; its inverse range may be expected.
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

    /// The left picture.
    pub(crate) fn image(&self) -> &Pyramid {
        &self.left
    }

    /// Whether a corner is followed already, by its number.
    pub(crate) fn is_tracked(&self, id: u64) -> bool {
        self.tracks.binary_search_by_key(&id, |t| t.id).is_ok()
    }

    /// Finds in both eyes what is drawn around the middle `at` of another picture, near where it is expected.
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

    /// Follows a corner from here on that was found, unless one is followed there. Tells whether it does.
    pub(crate) fn insert(&mut self, track: Track) -> bool {
        const NEAR: f32 = 6.0;
        if self.tracks.iter().any(|k| k.is_near(&track, NEAR)) {
            return false;
        }
        let index = self.tracks.partition_point(|k| k.id < track.id);
        self.tracks.insert(index, track);
        true
    }

    /// Corners to find the place again by: the strongest there are, whether or not they are followed.
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

    /// Forgets everything.
    pub(crate) fn clear(&mut self) {
        *self = Self::default();
    }
}

impl Track {
    fn is_near(&self, other: &Self, px: f32) -> bool {
        (0..2).all(|k| (self.at[k] - other.at[k]).abs() < px)
    }

    /// As it enters the window, seen by a camera `exposure_offset_s` later than its frame.
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

/// Pixel of the right eye for a left ray at an inverse range.
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
        // A far thing may seem to be a little behind infinity.
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

/// The best place along the epipolar line on a coarse level.
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
    // A step beyond either end, so that a best place at an end is one.
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

/// Where a point at a ray and inverse range is seen after a move of the left eye: `now_from_then`.
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
