//! Keyframe selection, insertion and removal.

use std::collections::BTreeMap;

use nalgebra::Matrix3;

use super::Odometry;
use crate::backend::marginalization::marginalize;
use crate::backend::solver::MIN_INVERSE_RANGE_PER_M;
use crate::backend::window::{Frame, Landmark, Window};
use crate::config::KeyframeConfig;
use crate::keyframe::{Keyframe, StereoObservation};

impl Odometry {
    /// Whether the newest frame becomes a keyframe.
    pub(super) fn is_keyframe(&self, window: &Window, is_tracked: bool) -> bool {
        let config = &self.config.estimator.keyframes;
        let n = window.frames.len();
        let (newest, before) = (&window.frames[n - 1].state, &window.frames[n - 2].state);
        let seconds = (newest.time_ns - before.time_ns) as f64 * 1e-9;
        if seconds >= config.max_interval_s || !is_tracked {
            return true;
        }
        let rotation = newest.rotation.inverse() * before.rotation;
        let mut parallaxes = Vec::new();
        let mut at = 0;
        for (k, tracker) in self.trackers.iter().enumerate() {
            let camera = &self.cameras[k];
            let (body_from_left, _) = &camera.body_from_left;
            let rotation: Matrix3<f64> = body_from_left.transpose()
                * rotation.to_rotation_matrix().into_inner()
                * body_from_left;
            let scale = camera.left.model().fx / f64::from(camera.left.model().width);
            // Both are sorted by camera and track id.
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
                    parallaxes.push((rotation * ray - track.left.ray).norm() * scale);
                }
            }
        }
        let min_ratio = if seconds < config.early_s {
            config.min_tracked_ratio_early
        } else {
            config.min_tracked_ratio
        };
        if (parallaxes.len() as f64) < min_ratio * self.reference.len() as f64
            || parallaxes.is_empty()
        {
            return true;
        }
        let middle = parallaxes.len() / 2;
        let (_, median, _) = parallaxes.select_nth_unstable_by(middle, f64::total_cmp);
        *median >= config.min_parallax
    }

    /// Makes the newest frame a keyframe: detects features, creates landmarks, and marginalizes old
    /// frames.
    pub(super) fn insert_keyframe(&mut self, window: &mut Window, exposure_offset_s: &[f64]) {
        self.match_across_cameras(window, exposure_offset_s);
        let config = &self.config;
        self.reference.clear();
        for (k, tracker) in self.trackers.iter_mut().enumerate() {
            let camera = &self.cameras[k];
            tracker.detect_new(camera, &mut self.next_track);
            for track in &tracker.tracks {
                self.reference.push((k, track.id, track.left.ray));
                if let (None, Some(rho)) = (window.landmarks.get(&track.id), track.rho) {
                    let observation = track.observation(k, camera, exposure_offset_s[k]);
                    let landmark = Landmark {
                        rho: rho.max(MIN_INVERSE_RANGE_PER_M),
                        observations: vec![(self.number, observation)],
                    };
                    window.landmarks.insert(track.id, landmark);
                }
            }
        }
        let mut keyframe = Keyframe {
            number: self.number,
            state: (&window.newest().state).into(),
            imu_valid: imu_valid(window.newest()),
            stereo_errors: (window.cameras.iter())
                .map(|camera| camera.stereo.error.into())
                .collect(),
            extrinsics_errors: (self.extrinsics.iter().zip(&window.cameras))
                .map(|(prior, camera)| prior.error(camera).into())
                .collect(),
            exposure_offset_s: exposure_offset_s.to_vec(),
            observations: Vec::new(),
            keypoints: Vec::new(),
        };
        for (k, tracker) in self.trackers.iter().enumerate() {
            keyframe
                .observations
                .extend(tracker.tracks.iter().map(|t| StereoObservation {
                    id: t.id,
                    camera: k as u8,
                    left: t.at,
                    right: t.right_at,
                }));
            keyframe
                .keypoints
                .extend(tracker.keypoints(&self.cameras[k], k));
        }
        self.pending.insert(self.number, keyframe);
        while window.frames.len() > config.backend.window_size {
            let frame_to_marginalize =
                frame_to_marginalize(&self.config.estimator.keyframes, window);
            let frame = &window.frames[frame_to_marginalize];
            if frame_to_marginalize == 0 || self.is_due_at_rest(window, frame_to_marginalize) {
                (self.ready).extend(finish_keyframe(&mut self.pending, frame));
            } else {
                self.pending.remove(&frame.number);
            }
            marginalize(window, frame_to_marginalize);
        }
    }

    /// Whether a keyframe that leaves at rest is kept: enough time has passed since the previous
    /// one, or it has no observations and only seems to be at rest, or the validity of the IMU
    /// changes at it.
    fn is_due_at_rest(&self, window: &Window, frame_to_marginalize: usize) -> bool {
        let (this, next) = (&window.frames[frame_to_marginalize], window.newest());
        let pending = self.pending.get(&this.number);
        if pending.is_none_or(|k| k.observations.is_empty()) || imu_valid(this) != imu_valid(next) {
            return true;
        }
        let time_ns = this.state.time_ns;
        let in_window = window.frames[frame_to_marginalize - 1].state.time_ns;
        let before = (self.ready.iter().rev())
            .map(|k| k.state.time_ns)
            .find(|t| *t < time_ns)
            .map_or(in_window, |t| t.max(in_window));
        time_ns - before >= self.config.estimator.keyframes.interval_at_rest_ns
    }

    /// Takes the keyframes that will not change any more, in order of time, each once; at rest one
    /// every ten seconds. After the last frame set, `all` also returns the remaining ones.
    ///
    /// ```
    /// use odometry::{Config, FrameSet, Odometry, Preset, Rig, View};
    /// # use cad_transforms::RigidTransform;
    /// # use imaging::ImageView;
    /// # use camera_models::{CameraModel, Distortion};
    /// # use odometry::rig::StereoCamera;
    /// # let lens = CameraModel::new((160, 120), [100.0, 100.0, 79.5, 59.5], Distortion::None);
    /// # let camera = StereoCamera {
    /// #     name: "front".to_owned(),
    /// #     left: lens,
    /// #     right: lens,
    /// #     rig_from_left: RigidTransform::identity(),
    /// #     covariance: None,
    /// #     right_from_left: RigidTransform::from_translation_m([-0.08, 0.0, 0.0])?,
    /// #     right_from_left_covariance: None,
    /// #     line_s: 0.0,
    /// # };
    /// # // Gray patches of 5 x 5 pixels, shifted to the left, with sensor noise of each image.
    /// # let image = |shift: usize, noise: u64| -> Vec<u8> {
    /// #     let hash = |a: u64| (a.wrapping_mul(0x9e37_79b9_7f4a_7c15) >> 40) as u8;
    /// #     let gray = |i: usize| {
    /// #         let (x, y) = (i % 160, i / 160);
    /// #         let patch = hash(((x + shift) / 5 * 1009 + y / 5) as u64);
    /// #         40 + patch / 2 + hash(noise.wrapping_mul(7919) + i as u64) % 3
    /// #     };
    /// #     (0..160 * 120).map(gray).collect()
    /// # };
    /// # let rig = Rig { cameras: vec![camera], imus: Vec::new() };
    /// # let (left, right) = (image(0, 1), image(4, 2));
    /// # let [left, right] = [&left, &right].map(|pixels| ImageView::new(160, 120, 160, pixels).unwrap());
    /// # let view = View { time_ns: 0, left, right, mask: None };
    /// let mut odometry = Odometry::new(&rig, Config::preset(Preset::Fast));
    /// odometry.add_frames(&FrameSet { time_ns: 0, views: vec![Some(view)] });
    ///
    /// // The only keyframe may still change, unless this was the last frame set.
    /// assert!(odometry.take_keyframes(false).is_empty());
    /// let keyframes = odometry.take_keyframes(true);
    /// assert_eq!((keyframes.len(), keyframes[0].number), (1, 1));
    /// assert!(keyframes[0].observations.iter().any(|observation| observation.right.is_some()));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn take_keyframes(&mut self, all: bool) -> Vec<Keyframe> {
        if let (true, Some(window)) = (all, &self.window) {
            for frame in &window.frames {
                self.ready.extend(finish_keyframe(&mut self.pending, frame));
            }
        }
        // A keyframe with little motion leaves before older ones.
        let oldest = self.pending.keys().next().copied().unwrap_or(u64::MAX);
        self.ready.sort_by_key(|k| k.number);
        let count = self.ready.partition_point(|k| k.number < oldest);
        self.ready.drain(..count).collect()
    }
}

/// The keyframe of a frame, if there is one, with its final state when the frame leaves the window.
pub(super) fn finish_keyframe(
    pending: &mut BTreeMap<u64, Keyframe>,
    frame: &Frame,
) -> Option<Keyframe> {
    Some(Keyframe {
        state: (&frame.state).into(),
        ..pending.remove(&frame.number)?
    })
}

fn imu_valid(frame: &Frame) -> bool {
    let motion = frame.motion.as_ref();
    motion.is_some_and(|m| m.has_gravity || m.preintegrated.has_gyroscope())
}

/// Index of the frame to marginalize: the second newest if there is little motion from it to the
/// newest, else the oldest.
pub(super) fn frame_to_marginalize(config: &KeyframeConfig, window: &Window) -> usize {
    let n = window.frames.len();
    let (a, b) = (&window.frames[n - 2].state, &window.frames[n - 1].state);
    let is_static = (a.position - b.position).norm() < config.rest_motion[0]
        && a.rotation.angle_to(&b.rotation) < config.rest_motion[1];
    if is_static { n - 2 } else { 0 }
}
