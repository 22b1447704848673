//! Which frames become keyframes, what is kept of them, and when they leave.

use std::collections::BTreeMap;

use nalgebra::Matrix3;

use super::Odometry;
use crate::keyframe::{Keyframe, Seen};
use crate::marginal::marginalise;
use crate::solve::LEAST_RHO;
use crate::window::{Frame, Landmark, Window};

/// Longest time from one keyframe to the next, s: what the IMU felt is integrated anew from the last one.
const LONGEST_S: f64 = 0.6;
/// Time between keyframes that are kept for the adjustment at rest, ns: they show what the ones before did, and wait until the window
/// has moved on.
const REST_NS: i64 = 10_000_000_000;
/// Share of a keyframe's corners that must still be followed, some time after it, s, and at once: pictures that are all noise
/// lose a third of them from one to the next, and would all be keyframes.
const LEAST_SHARE: f64 = 0.65;
const LEAST_AT_ONCE: f64 = 0.35;
const AT_ONCE_S: f64 = 0.17;

impl Odometry {
    /// Whether the newest frame is to stay.
    pub(super) fn is_keyframe(&self, window: &Window, is_seen: bool) -> bool {
        let n = window.frames.len();
        let (newest, before) = (&window.frames[n - 1].state, &window.frames[n - 2].state);
        let seconds = (newest.time_ns - before.time_ns) as f64 * 1e-9;
        if seconds >= LONGEST_S || !is_seen {
            return true;
        }
        let turn = newest.turn.inverse() * before.turn;
        let mut shifts = Vec::new();
        let mut at = 0;
        for (k, tracker) in self.trackers.iter().enumerate() {
            let camera = &self.cameras[k];
            let (eye, _) = &camera.body_from_left;
            let turn: Matrix3<f64> = eye.transpose() * turn.to_rotation_matrix().into_inner() * eye;
            let scale = camera.left.model().fx * 672.0 / f64::from(camera.left.model().width);
            // Both are in the order of their numbers.
            for track in &tracker.tracks {
                while self
                    .reference
                    .get(at)
                    .is_some_and(|r| (r.0, r.1) < (k, track.id))
                {
                    at += 1;
                }
                if let Some((c, id, ray)) = self.reference.get(at)
                    && (*c, *id) == (k, track.id)
                {
                    shifts.push((turn * ray - track.left.ray).norm() * scale);
                }
            }
        }
        let least = if seconds < AT_ONCE_S {
            LEAST_AT_ONCE
        } else {
            LEAST_SHARE
        };
        if (shifts.len() as f64) < least * self.reference.len() as f64 || shifts.is_empty() {
            return true;
        }
        let middle = shifts.len() / 2;
        let (_, median, _) = shifts.select_nth_unstable_by(middle, f64::total_cmp);
        *median >= self.settings.parallax_px
    }

    /// The newest frame becomes a keyframe: new corners, new landmarks, and room in the window.
    pub(super) fn keep(&mut self, window: &mut Window, after_s: &[f64]) {
        self.look_across(window, after_s);
        let settings = &self.settings;
        self.reference.clear();
        for (k, tracker) in self.trackers.iter_mut().enumerate() {
            let camera = &self.cameras[k];
            tracker.refill(camera, settings.corners, &mut self.next_track);
            for track in &tracker.tracks {
                self.reference.push((k, track.id, track.left.ray));
                if let (None, Some(rho)) = (window.landmarks.get(&track.id), track.rho) {
                    let sight = track.sight(k, camera, after_s[k]);
                    let landmark = Landmark {
                        rho: rho.max(LEAST_RHO),
                        sights: vec![(self.number, sight)],
                    };
                    window.landmarks.insert(track.id, landmark);
                }
            }
        }
        let mut kept = Keyframe {
            number: self.number,
            state: (&window.newest().state).into(),
            is_felt: is_felt(window.newest()),
            after_s: after_s.to_vec(),
            seen: Vec::new(),
            marks: Vec::new(),
        };
        for (k, tracker) in self.trackers.iter().enumerate() {
            kept.seen.extend(tracker.tracks.iter().map(|t| Seen {
                id: t.id,
                camera: k as u8,
                left: t.at,
                right: t.right_at,
            }));
            kept.marks.extend(tracker.marks(&self.cameras[k], k));
        }
        self.pending.insert(self.number, kept);
        while window.frames.len() > settings.frames {
            let leaving = leaving(window);
            let frame = &window.frames[leaving];
            if leaving == 0 || self.is_due(window, leaving) {
                (self.ready).extend(leave(&mut self.pending, frame));
            } else {
                self.pending.remove(&frame.number);
            }
            marginalise(window, leaving);
        }
    }

    /// Whether a keyframe that leaves at rest is to be kept: it is long enough after the one before it, or it saw nothing and only seems to
    /// rest, or the IMU was believed up to it and not from it on, or the other way about.
    fn is_due(&self, window: &Window, leaving: usize) -> bool {
        let (this, next) = (&window.frames[leaving], window.newest());
        let pending = self.pending.get(&this.number);
        if pending.is_none_or(|k| k.seen.is_empty()) || is_felt(this) != is_felt(next) {
            return true;
        }
        let time_ns = this.state.time_ns;
        let in_window = window.frames[leaving - 1].state.time_ns;
        let before = (self.ready.iter().rev())
            .map(|k| k.state.time_ns)
            .find(|t| *t < time_ns)
            .map_or(in_window, |t| t.max(in_window));
        time_ns - before >= REST_NS
    }

    /// Keyframes that will not change any more, in order of time, each once; at rest one every ten seconds. Behind the last frame
    /// set, `all` gives the rest.
    pub fn take_keyframes(&mut self, all: bool) -> Vec<Keyframe> {
        if let (true, Some(window)) = (all, &self.window) {
            for frame in &window.frames {
                self.ready.extend(leave(&mut self.pending, frame));
            }
        }
        // One that hardly moved leaves before older ones do.
        let oldest = self.pending.keys().next().copied().unwrap_or(u64::MAX);
        self.ready.sort_by_key(|k| k.number);
        let count = self.ready.partition_point(|k| k.number < oldest);
        self.ready.drain(..count).collect()
    }
}

/// A frame's keyframe, if it is one, as it is kept when the frame leaves the window.
pub(super) fn leave(pending: &mut BTreeMap<u64, Keyframe>, frame: &Frame) -> Option<Keyframe> {
    Some(Keyframe {
        state: (&frame.state).into(),
        ..pending.remove(&frame.number)?
    })
}

fn is_felt(frame: &Frame) -> bool {
    frame.motion.as_ref().is_some_and(|m| m.has_gravity)
}

/// Which frame is to leave: the newest but one if hardly anything moved from it to the newest, else the oldest.
pub(super) fn leaving(window: &Window) -> usize {
    let n = window.frames.len();
    let (a, b) = (&window.frames[n - 2].state, &window.frames[n - 1].state);
    let still = (a.position - b.position).norm() < 0.01 && a.turn.angle_to(&b.turn) < 0.01;
    if still { n - 2 } else { 0 }
}
