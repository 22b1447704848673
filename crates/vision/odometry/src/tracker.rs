//! Corners of one camera, followed from picture to picture and matched between its eyes.
//!
//! Contract: [`Tracker::follow`] takes the next picture; what cannot be found for sure is lost and never comes back under the
//! same number. [`Tracker::refill`] looks for new corners where there are none. A match between the eyes keeps to the epipolar line of
//! the calibration; without one a corner is followed all the same.

use calib::Eye as Side;
use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use crate::corners::{Search, corners};
use crate::describe::describe;
use crate::follow::{follow, signature};
use crate::keyframe::Mark;
use crate::pyramid::Pyramid;
use crate::sight::{Bearing, Camera, Sight};

/// Coarsest level on which corners are followed in time, and between the eyes.
const IN_TIME: usize = 3;
const BETWEEN: usize = 1;
/// Level on which a match between the eyes is searched.
const SEARCH: usize = 1;
/// Nearest thing that eyes are matched on, m.
const NEAREST_M: f64 = 0.3;
/// How far off the epipolar line a match may lie, px.
const OFF_LINE: f64 = 1.5;
/// Cells of the grid for each corner that is wanted.
const CELLS: f64 = 1.3;
/// Corners kept to find a place again by, and the cells of which each gives one, pixels.
const MARKS: usize = 160;
const MARK_CELL: usize = 20;
/// Least correlation of a match on the coarse level, and by how much it must be better than any other not beside it.
const ALIKE: f32 = 0.75;
const BETTER: f32 = 0.05;

/// A corner that is followed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Track {
    pub(crate) id: u64,
    /// In the left picture.
    pub(crate) at: [f32; 2],
    pub(crate) left: Bearing,
    /// In the right one, if it was found there: where, and in which direction.
    pub(crate) right_at: Option<[f32; 2]>,
    pub(crate) right: Option<Bearing>,
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
    /// See [`crate::View::usable`]; empty for all.
    usable: Vec<u8>,
    /// By number, rising.
    pub(crate) tracks: Vec<Track>,
}

impl Tracker {
    /// Says which pixels of the next picture may be followed.
    pub(crate) fn may_use(&mut self, usable: Option<&[u8]>) {
        self.usable.clear();
        self.usable.extend_from_slice(usable.unwrap_or_default());
    }

    /// Says how many rows of it, from the top, may be followed.
    pub(crate) fn may_use_rows(&mut self, rows: usize, width: usize, height: usize) {
        if rows >= height {
            return;
        }
        self.usable.resize(width * height, 1);
        self.usable[rows * width..].fill(0);
    }

    fn mask(&self) -> Option<&[u8]> {
        (!self.usable.is_empty()).then_some(&self.usable[..])
    }

    /// Follows all corners into the next picture, starting where they are expected.
    pub(crate) fn follow(
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
        let followed = self.tracks.par_iter().with_min_len(8).map(|track| {
            let expected = expect(track);
            let at = follow(&before, left, track.at, expected.at, IN_TIME)?;
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
            match_eyes(&mut track, camera, left, right, expected.rho);
            Some(track)
        });
        let followed: Vec<Option<Track>> = followed.collect();
        self.tracks = followed.into_iter().flatten().collect();
        self.part();
    }

    /// Of corners that have run together the newer ones are given up.
    fn part(&mut self) {
        const NEAR: f32 = 4.0;
        let mut kept: Vec<Track> = Vec::with_capacity(self.tracks.len());
        for track in &self.tracks {
            if !kept.iter().any(|k| k.is_near(track, NEAR)) {
                kept.push(*track);
            }
        }
        self.tracks = kept;
    }

    /// Looks for new corners until there are `most`; they get the numbers from `next` on.
    pub(crate) fn refill(&mut self, camera: &Camera, most: usize, next: &mut u64) {
        let Some(level) = self.left.levels.first() else {
            return;
        };
        let taken: Vec<[f32; 2]> = self.tracks.iter().map(|t| t.at).collect();
        // Somewhat more cells than corners, since some are blank.
        let area = (level.width * level.height) as f64;
        let cell = (area / (CELLS * most.max(1) as f64)).sqrt() as usize;
        let search = Search {
            cell: cell.max(8),
            taken: &taken,
            mask: self.mask(),
            most: most.saturating_sub(taken.len()),
        };
        let found = corners(level, &search);
        let found = found.par_iter().with_min_len(8);
        let made = found.map(|at| self.begin(camera, 0, *at, None));
        let made: Vec<Option<Track>> = made.collect();
        for mut track in made.into_iter().flatten() {
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
        match_eyes(&mut track, camera, &self.left, &self.right, rho);
        Some(track)
    }

    /// The left picture.
    pub(crate) fn picture(&self) -> &Pyramid {
        &self.left
    }

    /// Whether a corner is followed already, by its number.
    pub(crate) fn follows(&self, id: u64) -> bool {
        self.tracks.binary_search_by_key(&id, |t| t.id).is_ok()
    }

    /// Finds in both eyes what is drawn around the middle `at` of another picture, near where it is expected.
    pub(crate) fn find(
        &self,
        camera: &Camera,
        (drawn, at): (&Pyramid, [f32; 2]),
        id: u64,
        expected: Expected,
    ) -> Option<Track> {
        let at = follow(drawn, &self.left, at, expected.at, BETWEEN)?;
        let width = self.left.levels.first()?.width;
        let pixel = at[1].round() as usize * width + at[0].round() as usize;
        if self.mask().is_some_and(|mask| mask.get(pixel) == Some(&0)) {
            return None;
        }
        self.begin(camera, id, at, expected.rho)
    }

    /// Follows a corner from here on that was found, unless one is followed there. Tells whether it does.
    pub(crate) fn take(&mut self, track: Track) -> bool {
        const NEAR: f32 = 6.0;
        if self.tracks.iter().any(|k| k.is_near(&track, NEAR)) {
            return false;
        }
        let place = self.tracks.partition_point(|k| k.id < track.id);
        self.tracks.insert(place, track);
        true
    }

    /// Corners to find the place again by: the strongest there are, whether or not they are followed.
    pub(crate) fn marks(&self, camera: &Camera, index: usize) -> Vec<Mark> {
        let (Some(level), Some(half)) = (self.left.levels.first(), self.left.levels.get(1)) else {
            return Vec::new();
        };
        let search = Search {
            cell: MARK_CELL,
            taken: &[],
            mask: self.mask(),
            most: MARKS,
        };
        let found = corners(level, &search);
        let made = found.par_iter().with_min_len(8).map(|at| {
            let looks = describe(half, 0.5 * at[0], 0.5 * at[1])?;
            let track = self.begin(camera, 0, *at, None)?;
            Some(Mark {
                camera: index as u8,
                left: *at,
                rho: track.rho.map_or(0.0, |rho| rho as f32),
                looks,
            })
        });
        let made: Vec<Option<Mark>> = made.collect();
        made.into_iter().flatten().collect()
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

    /// As it enters the window, seen by a camera `after_s` later than its frame.
    pub(crate) fn sight(&self, index: usize, camera: &Camera, after_s: f64) -> Sight {
        Sight {
            camera: index,
            left: self.left,
            right: self.right,
            after_s: after_s + camera.row_after_s(Side::Left, self.at[1]),
        }
    }
}

/// Pixel of the right eye for a left ray at an inverse range.
fn seen_right(camera: &Camera, ray: &Vector3<f64>, rho: f64) -> Option<[f32; 2]> {
    let (turn, origin) = &camera.right_from_left;
    let x = turn * ray + origin * rho;
    camera
        .right
        .project(x.into())
        .map(|pixel| pixel.map(|v| v as f32))
}

fn match_eyes(
    track: &mut Track,
    camera: &Camera,
    left: &Pyramid,
    right: &Pyramid,
    expected: Option<f64>,
) {
    let from = |guess: [f32; 2], coarsest: usize| {
        let found = follow(left, right, track.at, guess, coarsest)?;
        let bearing = camera.bearing(Side::Right, found)?;
        let (rho, off) = camera.triangulate(&track.left, &bearing);
        // A far thing may seem to be a little behind infinity.
        let fits = off < OFF_LINE && rho < 1.0 / NEAREST_M && rho > -0.05;
        fits.then_some((found, bearing, rho))
    };
    let tried = expected
        .and_then(|rho| seen_right(camera, &track.left.ray, rho))
        .and_then(|guess| from(guess, BETWEEN));
    let found = tried.or_else(|| {
        let guess = search(camera, &track.left.ray, track.at, left, right)?;
        from(guess, SEARCH)
    });
    if let Some((at, bearing, rho)) = found {
        track.right_at = Some(at);
        track.right = Some(bearing);
        track.rho = Some(rho.max(crate::solve::LEAST_RHO));
    }
}

/// The best place along the epipolar line on a coarse level.
fn search(
    camera: &Camera,
    ray: &Vector3<f64>,
    at: [f32; 2],
    left: &Pyramid,
    right: &Pyramid,
) -> Option<[f32; 2]> {
    let level = SEARCH.min(left.levels.len() - 1);
    let scale = (1_u32 << level) as f32;
    let template = signature(&left.levels[level], at[0] / scale, at[1] / scale)?;
    let far = seen_right(camera, ray, 0.0)?;
    let near = seen_right(camera, ray, 1.0 / NEAREST_M)?;
    let length = (near[0] - far[0]).hypot(near[1] - far[1]) / scale;
    // A step beyond either end, so that a best place at an end is one.
    let steps = length.ceil() as i32;
    let mut scores = Vec::with_capacity(steps as usize + 3);
    for k in -1..=steps + 1 {
        let rho = f64::from(k) / f64::from(steps.max(1)) / NEAREST_M;
        let score = seen_right(camera, ray, rho).and_then(|[x, y]| {
            let there = signature(&right.levels[level], x / scale, y / scale)?;
            Some(template.iter().zip(&there).map(|(a, b)| a * b).sum::<f32>())
        });
        scores.push((score.unwrap_or(-1.0), rho));
    }
    let (best, top) = scores
        .iter()
        .enumerate()
        .max_by(|a, b| a.1.0.total_cmp(&b.1.0))?;
    if top.0 < ALIKE {
        return None;
    }
    let other = scores
        .iter()
        .enumerate()
        .filter(|(k, _)| k.abs_diff(best) > 2)
        .map(|(_, s)| s.0)
        .fold(-1.0, f32::max);
    if top.0 < other + BETTER {
        return None;
    }
    seen_right(camera, ray, top.1)
}

/// Where a point at a ray and inverse range is seen after a move of the left eye: `now_from_then`.
pub(crate) fn moved(
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
