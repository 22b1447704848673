//! What is refused: feelings that most of what is seen contradicts, and sights that the others contradict.

use std::collections::BTreeSet;

use nalgebra::SMatrix;

use super::{FEWEST, Odometry};
use crate::felt::leap;
use crate::solve::{for_each_residual, solve_newest};
use crate::state::{SIZE, State};
use crate::window::{Frame, Landmark, Motion, Window};

/// Residual, in standard deviations, from which a sight is wrong.
const WRONG: f64 = 5.0;
/// Share of sights that agree below which what was felt is put in doubt, and that must agree without it.
const DOUBTFUL: f64 = 0.35;
const CLEAR: f64 = 0.6;

impl Odometry {
    /// Finds the newest pose. Where what was felt contradicts most of what is seen, and what is seen agrees with itself, the
    /// feeling was wrong: a bias that was not known, a shock, a sensor that clips without saying so.
    pub(super) fn locate(&self, window: &mut Window) -> Option<SMatrix<f64, SIZE, SIZE>> {
        let last = window.frames.len() - 1;
        let guess = window.frames[last].clone();
        let information = solve_newest(window, &self.kept, 4);
        let (good, all) = agreeing(window);
        let has_gravity = guess.motion.as_ref().is_some_and(|m| m.has_gravity);
        if !has_gravity || all < FEWEST || good as f64 >= DOUBTFUL * all as f64 {
            return information;
        }
        let felt = window.frames[last].clone();
        let from = window.frames[last - 1].state;
        window.frames[last] = Frame {
            motion: Some(Motion {
                felt: leap(&from, self.rate(), guess.state.time_ns),
                has_gravity: false,
                walk: guess.motion.as_ref().map_or([1e-6; 2], |m| m.walk),
            }),
            ..guess
        };
        let seen = solve_newest(window, &self.kept, 4);
        let (now, _) = agreeing(window);
        if (now as f64) >= CLEAR * all as f64 && now > 2 * good {
            return seen;
        }
        window.frames[last] = felt;
        information
    }

    /// Takes back sights of the newest frame that cannot be right, and their corners. Gives the number of those that can.
    pub(super) fn reject(&mut self, window: &mut Window) -> usize {
        let number = self.number;
        let newest = window.landmarks.values();
        let seen: usize = newest.map(|l| l.sights.len() - l.since(number)).sum();
        // By camera and number.
        let mut wrong = BTreeSet::new();
        for (id, places) in contradicted(window, |landmark| landmark.since(number)) {
            let Some(landmark) = window.landmarks.get_mut(&id) else {
                continue;
            };
            let left = places.iter().filter(|(_, eye)| *eye == 0);
            wrong.extend(left.map(|(sight, _)| (landmark.sights[*sight].1.camera, id)));
            landmark.drop_sights(&places);
        }
        for (k, tracker) in self.trackers.iter_mut().enumerate() {
            tracker.tracks.retain(|t| !wrong.contains(&(k, t.id)));
        }
        seen - wrong.len()
    }

    /// Takes back everything that the newest frame saw. Where nothing was felt either, nothing ties what comes to what was:
    /// false.
    pub(super) fn overlook(&mut self, window: &mut Window, guess: State) -> bool {
        let number = self.number;
        let last = window.frames.len() - 1;
        window.frames[last].state = guess;
        let felt = window.frames[last]
            .motion
            .as_ref()
            .is_some_and(|m| m.has_gravity);
        let is_tied = felt && !self.is_adrift;
        if is_tied {
            for landmark in window.landmarks.values_mut() {
                landmark.sights.retain(|(n, _)| *n != number);
            }
        } else {
            window.landmarks.clear();
            for tracker in &mut self.trackers {
                tracker.tracks.clear();
            }
        }
        is_tied
    }

    /// Takes away sights that do not fit after all has been solved, and landmarks with too few left.
    pub(super) fn prune(&mut self, window: &mut Window) {
        let mut gone = BTreeSet::new();
        for (id, places) in contradicted(window, |_| 0) {
            let Some(landmark) = window.landmarks.get_mut(&id) else {
                continue;
            };
            // The host's right eye made the inverse range: if it is wrong, so was that.
            if places.contains(&(0, 1)) || 3 * places.len() > landmark.sights.len() {
                window.landmarks.remove(&id);
                gone.insert(id);
                continue;
            }
            landmark.drop_sights(&places);
        }
        for tracker in &mut self.trackers {
            tracker.tracks.retain(|t| !gone.contains(&t.id));
        }
    }
}

/// Landmarks with sights, by place and eye, that everything else contradicts, from some place on.
fn contradicted(
    window: &Window,
    from: impl Fn(&Landmark) -> usize,
) -> Vec<(u64, Vec<(usize, usize)>)> {
    let each = window.landmarks.iter().map(|(id, landmark)| {
        let from = from(landmark);
        let mut places = Vec::new();
        for_each_residual(window, landmark, |sight, eye, square| {
            if sight >= from && square > WRONG * WRONG {
                places.push((sight, eye));
            }
        });
        (*id, places)
    });
    each.filter(|(_, places)| !places.is_empty()).collect()
}

/// How many sights of the newest frame are where they should be, and how many there are.
pub(super) fn agreeing(window: &Window) -> (usize, usize) {
    let number = window.newest().number;
    let (mut good, mut all) = (0, 0);
    for landmark in window.landmarks.values() {
        let since = landmark.since(number);
        if since == landmark.sights.len() {
            continue;
        }
        all += landmark.sights.len() - since;
        for_each_residual(window, landmark, |sight, eye, square| {
            good += usize::from(sight >= since && eye == 0 && square <= WRONG * WRONG);
        });
    }
    (good, all)
}
