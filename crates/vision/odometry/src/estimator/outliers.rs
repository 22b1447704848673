//! Outlier rejection: IMU preintegration that most observations contradict, a camera that was
//! moved, and observations that contradict the rest.

use std::collections::BTreeSet;

use nalgebra::Matrix6;

use super::{Odometry, camera_shift};
use crate::backend::newest_pose::{NewestInformation, refine_newest};
use crate::backend::solver::for_each_residual;
use crate::backend::state::{ROTATION, State};
use crate::backend::window::{Frame, Landmark, MotionFactor, Window};
use crate::config::EstimatorConfig;
use crate::inertial::propagation::constant_velocity;

impl Odometry {
    /// Estimates the newest pose. If the preintegrated IMU motion contradicts most observations,
    /// and these agree among themselves, the IMU is rejected: an unknown bias, a shock, or
    /// saturation that the sensor does not report.
    pub(super) fn estimate_newest_pose(&self, window: &mut Window) -> Option<NewestInformation> {
        let rounds = self.config.backend.newest_pose.max_iterations;
        let config = &self.config.estimator;
        let last = window.frames.len() - 1;
        let guess = window.frames[last].clone();
        let information = refine_newest(window, &self.keyframe_covariance, rounds, |_| true);
        let (inliers, all) = count_inliers(window);
        let has_gravity = guess.motion.as_ref().is_some_and(|m| m.has_gravity);
        if !has_gravity
            || all < config.min_inliers
            || inliers as f64 >= config.imu_suspect_inlier_ratio * all as f64
        {
            return information;
        }
        let preintegrated = window.frames[last].clone();
        let from = window.frames[last - 1].state;
        window.frames[last] = Frame {
            motion: Some(MotionFactor {
                preintegrated: constant_velocity(
                    &self.config.inertial,
                    &from,
                    self.rate(),
                    guess.state.time_ns,
                ),
                has_gravity: false,
                bias_walk: guess.motion.as_ref().map_or([1e-6; 2], |m| m.bias_walk),
            }),
            ..guess
        };
        let without_imu = refine_newest(window, &self.keyframe_covariance, rounds, |_| true);
        let (now, _) = count_inliers(window);
        if (now as f64) >= config.vision_only_inlier_ratio * all as f64 && now > 2 * inliers {
            return without_imu;
        }
        window.frames[last] = preintegrated;
        information
    }

    /// Follows a camera that was moved since the previous frame. Returns whether one was; then the
    /// newest pose has to be estimated again, without its observations.
    pub(super) fn follow_camera_shift(&mut self, window: &mut Window) -> bool {
        let config = &self.config.estimator.camera_shift;
        let Some((shift, rotation)) = camera_shift::find(config, window) else {
            return false;
        };
        let mut covariance = Matrix6::zeros();
        let sigma = config.sigma_ratio * shift.rotation_rad;
        (covariance.fixed_view_mut::<3, 3>(ROTATION, ROTATION)).fill_diagonal(sigma * sigma);
        self.add_unmodeled(&window.newest().state, covariance);
        let inflation = self.config.backend.covariance.sigma_inflation;
        let variance = (shift.rotation_rad / inflation).powi(2);
        camera_shift::rotate_camera(window, shift.camera, &rotation, variance);
        (self.keyframe_covariance).add_rotation_variance(shift.camera, variance);
        self.camera_shifts.push(shift);
        true
    }

    /// Rejects outliers of the newest frame and their tracks. Returns the number of inliers.
    pub(super) fn reject_outliers(&mut self, window: &mut Window) -> usize {
        let number = self.number;
        let newest = window.landmarks.values();
        let observed: usize = newest.map(|l| l.observations.len() - l.since(number)).sum();
        // By camera and track id.
        let mut outliers = BTreeSet::new();
        for (id, entries) in find_outliers(window, |landmark| landmark.since(number)) {
            let Some(landmark) = window.landmarks.get_mut(&id) else {
                continue;
            };
            let left = entries.iter().filter(|(_, side)| *side == 0);
            outliers.extend(
                left.map(|(observation, _)| (landmark.observations[*observation].1.camera, id)),
            );
            landmark.drop_observations(&entries);
        }
        for (k, tracker) in self.trackers.iter_mut().enumerate() {
            tracker.tracks.retain(|t| !outliers.contains(&(k, t.id)));
        }
        observed - outliers.len()
    }

    /// Discards all observations of the newest frame. Returns false if its motion factor has no
    /// measured specific force either, so that later frames are not connected to earlier ones.
    pub(super) fn discard_newest(&mut self, window: &mut Window, guess: State) -> bool {
        let number = self.number;
        let last = window.frames.len() - 1;
        window.frames[last].state = guess;
        let has_gravity = window.frames[last]
            .motion
            .as_ref()
            .is_some_and(|m| m.has_gravity);
        let is_connected = has_gravity && !self.is_lost;
        // Earlier landmarks remain: they determine the calibrations.
        window.landmarks.retain(|_, landmark| {
            landmark.observations.retain(|(n, _)| *n != number);
            !landmark.observations.is_empty()
        });
        if !is_connected {
            for tracker in &mut self.trackers {
                tracker.tracks.clear();
            }
        }
        is_connected
    }

    /// Removes outliers after optimization, and landmarks with too few remaining observations.
    pub(super) fn filter_landmarks(&mut self, window: &mut Window) {
        let mut removed = BTreeSet::new();
        for (id, entries) in find_outliers(window, |_| 0) {
            let Some(landmark) = window.landmarks.get_mut(&id) else {
                continue;
            };
            // The right observation of the host determined the inverse range: if it is an outlier,
            // so is the range.
            if entries.contains(&(0, 1)) || 3 * entries.len() > landmark.observations.len() {
                window.landmarks.remove(&id);
                removed.insert(id);
                continue;
            }
            landmark.drop_observations(&entries);
        }
        for tracker in &mut self.trackers {
            tracker.tracks.retain(|t| !removed.contains(&t.id));
        }
    }
}

/// Factor on the standard deviations of images with this number of inliers in all cameras together,
/// at least 1.
pub(crate) fn sigma_ratio(config: &EstimatorConfig, inliers: usize, cameras: usize) -> f64 {
    let independent = config.independent_inliers * cameras;
    let few = independent as f64 / inliers.max(1) as f64;
    few.max(1.0).powi(2)
}

/// Outliers per landmark: index of the observation and side (0 left, 1 right), from the index
/// `from(landmark)` on.
fn find_outliers(
    window: &Window,
    from: impl Fn(&Landmark) -> usize,
) -> Vec<(u64, Vec<(usize, usize)>)> {
    let max_squared_residual = window.config.outlier_sigma.powi(2);
    let each = window.landmarks.iter().map(|(id, landmark)| {
        let from = from(landmark);
        let mut entries = Vec::new();
        for_each_residual(window, landmark, |observation, side, squared_residual| {
            if observation >= from && squared_residual > max_squared_residual {
                entries.push((observation, side));
            }
        });
        (*id, entries)
    });
    each.filter(|(_, entries)| !entries.is_empty()).collect()
}

/// Number of inliers and of all observations of the newest frame.
pub(super) fn count_inliers(window: &Window) -> (usize, usize) {
    let number = window.newest().number;
    let max_squared_residual = window.config.outlier_sigma.powi(2);
    let (mut inliers, mut all) = (0, 0);
    for landmark in window.landmarks.values() {
        let since = landmark.since(number);
        if since == landmark.observations.len() {
            continue;
        }
        all += landmark.observations.len() - since;
        for_each_residual(window, landmark, |observation, side, squared_residual| {
            inliers += usize::from(
                observation >= since && side == 0 && squared_residual <= max_squared_residual,
            );
        });
    }
    (inliers, all)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_inliers_count_less() {
        let config = EstimatorConfig::default();
        let times = |inliers| sigma_ratio(&config, inliers, 1);
        assert_eq!(times(config.independent_inliers), 1.0);
        assert_eq!(sigma_ratio(&config, config.independent_inliers, 2), 4.0);
        assert_eq!(times(1000), 1.0);
        assert_eq!(times(config.independent_inliers / 2), 4.0);
        assert!(times(0).is_finite());
    }
}
