//! Loop closure detection.
//!
//! Candidates are keyframes that may observe the same place according to their poses: close, with
//! similar viewing directions, and far apart in time. Keypoints are matched by their descriptors.
//! The relative pose is estimated robustly from the predicted one ([`relative_pose`]). A closure
//! with a larger correction than the possible drift is perceptual aliasing and is rejected. A loop
//! closure enters bundle adjustment as a relative-pose factor with the covariance of its own
//! solution.

use camera_models::Eye as Side;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use rayon::prelude::*;

use super::LoopClosure;
use super::bundle_adjustment::Progress;
use crate::backend::landmark_elimination::{PoseMatrix, PoseVector};
use crate::backend::observation::{self, BearingMeasurement, Camera};
use crate::backend::state::State;
use crate::backend::stereo::{self, StereoVector};
use crate::backend::window::Window;
use crate::config::LoopClosureConfig;
use crate::frontend::descriptor::hamming_distance;
use crate::keyframe::{Keyframe, Keypoint};
use cad_transforms::so3;
use relative_pose::{Match, RelativePose, RobustPose};

mod relative_pose;

/// Relative-pose factor of two keyframes, by index in the window.
#[derive(Clone, Debug)]
pub(super) struct Closure {
    pub(super) frames: [usize; 2],
    numbers: [u64; 2],
    /// Measured rotation: first body from second.
    rotation: UnitQuaternion<f64>,
    translation: Vector3<f64>,
    information: PoseMatrix,
    inliers: f64,
    initial_error: [f64; 2],
    /// Scale of the Cauchy loss, in standard deviations.
    loss_scale: f64,
}

/// Linearized relative-pose factor.
pub(super) struct Term {
    pub(super) own: PoseMatrix,
    pub(super) cross: PoseMatrix,
    pub(super) other: PoseMatrix,
    pub(super) gradient_own: PoseVector,
    pub(super) gradient_other: PoseVector,
    pub(super) cost: f64,
}

impl Closure {
    /// Public summary.
    pub(super) fn report(&self) -> LoopClosure {
        LoopClosure {
            frames: self.numbers,
            inliers: self.inliers.round() as usize,
            initial_error: self.initial_error,
        }
    }

    /// Sets the final, tighter scale of the loss.
    pub(super) fn tighten_loss(&mut self, cauchy_sigma: f64) {
        self.loss_scale = cauchy_sigma;
    }

    /// Residual: translation and rotation error of the two poses.
    fn residual(&self, window: &Window) -> PoseVector {
        let [a, b] = self.frames.map(|f| &window.frames[f].state);
        let now = RelativePose::between(a, b);
        let mut r = PoseVector::zeros();
        r.fixed_rows_mut::<3>(0)
            .copy_from(&(now.translation - self.translation));
        r.fixed_rows_mut::<3>(3)
            .copy_from(&so3::log(&(self.rotation.inverse() * now.rotation)));
        r
    }

    pub(super) fn cost(&self, window: &Window) -> f64 {
        let r = self.residual(window);
        let squared_residual = (r.transpose() * self.information * r)[0];
        let loss_scale = self.loss_scale * self.loss_scale;
        loss_scale * (1.0 + squared_residual / loss_scale).ln()
    }

    pub(super) fn linearize(&self, window: &Window) -> Term {
        let [a, b] = self.frames.map(|f| &window.frames[f].state);
        let r = self.residual(window);
        let squared_residual = (r.transpose() * self.information * r)[0];
        let weight =
            self.information / (1.0 + squared_residual / (self.loss_scale * self.loss_scale));
        let back: Matrix3<f64> = a.rotation.inverse().to_rotation_matrix().into_inner();
        let translation = back * (b.position - a.position);
        let inverse = so3::right_jacobian_inverse(&r.fixed_rows::<3>(3).into_owned());
        let relative = back * b.rotation.to_rotation_matrix().into_inner();
        let mut by_a = PoseMatrix::zeros();
        let mut by_b = PoseMatrix::zeros();
        by_a.fixed_view_mut::<3, 3>(0, 0).copy_from(&-back);
        by_b.fixed_view_mut::<3, 3>(0, 0).copy_from(&back);
        by_a.fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&translation.cross_matrix());
        by_a.fixed_view_mut::<3, 3>(3, 3)
            .copy_from(&(-inverse * relative.transpose()));
        by_b.fixed_view_mut::<3, 3>(3, 3).copy_from(&inverse);
        let (weighted_a, weighted_b) = (by_a.transpose() * weight, by_b.transpose() * weight);
        Term {
            own: weighted_a * by_a,
            cross: weighted_a * by_b,
            other: weighted_b * by_b,
            gradient_own: weighted_a * r,
            gradient_other: weighted_b * r,
            cost: self.cost(window),
        }
    }
}

/// Finds all loop closures.
pub(super) fn find(
    config: &LoopClosureConfig,
    keyframes: &[Keyframe],
    window: &Window,
    progress: &mut impl FnMut(Progress),
) -> Vec<Closure> {
    // Path length up to each keyframe.
    let mut path_length = vec![0.0];
    for pair in window.frames.windows(2) {
        let step = (pair[1].state.position - pair[0].state.position).norm();
        path_length.push(path_length[path_length.len() - 1] + step);
    }
    let mut queried = Vec::new();
    let mut last: Option<usize> = None;
    for k in 0..keyframes.len() {
        let far = |l: usize| {
            let (a, b) = (&window.frames[l].state, &window.frames[k].state);
            (a.position - b.position).norm() > config.query_spacing_m
                || a.rotation.angle_to(&b.rotation) > config.query_spacing_rad
        };
        if last.is_none_or(far) {
            queried.push(k);
            last = Some(k);
        }
    }
    let mut closures = Vec::new();
    const KEYFRAMES_PER_BATCH: usize = 64;
    for (n, some) in queried.chunks(KEYFRAMES_PER_BATCH).enumerate() {
        progress(Progress::SearchingLoops {
            done: n * KEYFRAMES_PER_BATCH,
            all: queried.len(),
        });
        let found: Vec<Vec<Closure>> = some
            .par_iter()
            .map(|b| {
                let candidates = candidates(config, *b, window, &path_length, &queried);
                let tried = candidates.iter().filter_map(|a| {
                    close(
                        config,
                        &keyframes[*a],
                        &keyframes[*b],
                        [*a, *b],
                        window,
                        &path_length,
                    )
                });
                tried.take(1).collect()
            })
            .collect();
        closures.extend(found.into_iter().flatten());
    }
    closures
}

/// Earlier keyframes that may observe the same place, the nearest first.
fn candidates(
    config: &LoopClosureConfig,
    b: usize,
    window: &Window,
    path_length: &[f64],
    queried: &[usize],
) -> Vec<usize> {
    let now = &window.frames[b].state;
    let mut near: Vec<(f64, usize)> = queried
        .iter()
        .take_while(|a| **a < b)
        .filter_map(|a| {
            let then = &window.frames[*a].state;
            let seconds = (now.time_ns - then.time_ns) as f64 * 1e-9;
            let far = (now.position - then.position).norm();
            let rotated = then.rotation.angle_to(&now.rotation);
            let fits = seconds > config.min_interval_s
                && far
                    < config.max_distance_m
                        + config.drift_rate * (path_length[b] - path_length[*a]);
            fits.then_some((far + rotated, *a))
        })
        .collect();
    near.sort_by(|x, y| x.0.total_cmp(&y.0));
    near.truncate(config.max_candidates);
    near.into_iter().map(|(_, a)| a).collect()
}

/// A keypoint with the extrinsics of its camera at its exposure time: rows and cameras have
/// exposure offsets, during which the body moves.
struct PosedKeypoint<'a> {
    keypoint: &'a Keypoint,
    bearing: BearingMeasurement,
    /// Body at the time of the keyframe from left optical frame at the time of the keypoint.
    body_from_left: Matrix3<f64>,
    arm: Vector3<f64>,
    /// Inverse range with its standard deviation, 1/m, if stereo determines it.
    range: Option<[f64; 2]>,
}

impl PosedKeypoint<'_> {
    /// Optical axis in the body frame.
    fn axis(&self) -> Vector3<f64> {
        self.body_from_left.column(2).into_owned()
    }
}

/// Keypoints of one camera.
fn pose_keypoints<'a>(
    config: &LoopClosureConfig,
    keyframe: &'a Keyframe,
    state: &State,
    (index, camera): (usize, &Camera),
) -> Vec<PosedKeypoint<'a>> {
    let own = (keyframe.keypoints.iter()).filter(|m| usize::from(m.camera) == index);
    // Ranges are from the calibration as it was estimated then.
    let mut then_calibrated = camera.clone();
    if let Some(error) = keyframe.stereo_errors.get(index) {
        let difference = StereoVector::from(*error) - camera.stereo.error;
        stereo::apply_error(&mut then_calibrated, &difference);
    }
    let each = own.filter_map(|keypoint| {
        let bearing = camera.bearing(Side::Left, keypoint.left)?;
        let exposure_offset_s =
            keyframe.exposure_offset_s[index] + camera.row_after_s(Side::Left, keypoint.left[1]);
        let then = observation::CameraPose::new(state, exposure_offset_s);
        let (body_from_left, arm) = &camera.body_from_left;
        let translation = state.rotation.inverse() * (then.position - state.position);
        let rotation = then.then_from_state.transpose();
        let range = || {
            let right = then_calibrated.project_right(&bearing.ray, f64::from(keypoint.rho))?;
            let right = camera.bearing(Side::Right, right)?;
            let (rho, _) = camera.triangulate(&bearing, &right);
            let length = camera.in_right(&bearing.ray, rho).norm();
            let by_rho = (right.basis * camera.right_from_left.1).norm() / length;
            (rho > 0.0).then_some([rho, config.disparity_sigma_px / by_rho])
        };
        Some(PosedKeypoint {
            keypoint,
            bearing,
            range: (keypoint.rho > 0.0).then(range).flatten(),
            body_from_left: rotation * body_from_left,
            arm: rotation * arm + translation,
        })
    });
    each.collect()
}

fn close(
    config: &LoopClosureConfig,
    from: &Keyframe,
    to: &Keyframe,
    frames: [usize; 2],
    window: &Window,
    path_length: &[f64],
) -> Option<Closure> {
    let [a, b] = frames.map(|f| &window.frames[f].state);
    let expected = RelativePose::between(a, b);
    let matches = matches(config, from, to, (a, b), &expected, &window.cameras);
    let all: f64 = matches.iter().map(|m| m.weight).sum();
    if all < config.min_inliers {
        return None;
    }
    let path_length = path_length[frames[1]] - path_length[frames[0]];
    let max_correction_m = config.max_correction_m + config.drift_rate * path_length;
    let correction = |pose: &RelativePose| {
        [
            (pose.translation - expected.translation).norm(),
            pose.rotation.angle_to(&expected.rotation),
        ]
    };
    let is_plausible = |pose: &RelativePose| {
        let [distance_m, angle_rad] = correction(pose);
        distance_m < max_correction_m && angle_rad < config.max_correction_rad
    };
    let RobustPose {
        pose,
        information,
        inlier_weight,
    } = expected.estimate(config, &matches, is_plausible)?;
    let initial_error = correction(&pose);
    let is_consistent =
        inlier_weight >= config.min_inliers && inlier_weight >= config.min_inlier_ratio * all;
    is_consistent.then_some(Closure {
        frames,
        numbers: [from.number, to.number],
        rotation: pose.rotation,
        translation: pose.translation,
        information,
        inliers: inlier_weight,
        initial_error,
        loss_scale: config.cauchy_sigma_first,
    })
}

fn matches(
    config: &LoopClosureConfig,
    from: &Keyframe,
    to: &Keyframe,
    (a, b): (&State, &State),
    predicted: &RelativePose,
    cameras: &[Camera],
) -> Vec<Match> {
    let mut out = Vec::new();
    let translation = predicted.translation;
    let r: Matrix3<f64> = predicted.rotation.to_rotation_matrix().into_inner();
    let all = |keyframe, state| -> Vec<Vec<PosedKeypoint<'_>>> {
        let each = cameras.iter().enumerate();
        each.map(|camera| pose_keypoints(config, keyframe, state, camera))
            .collect()
    };
    let (of_a, of_b) = (all(from, a), all(to, b));
    for keypoints_a in &of_a {
        for keypoints_b in &of_b {
            let (Some(first_a), Some(first_b)) = (keypoints_a.first(), keypoints_b.first()) else {
                continue;
            };
            if first_a.axis().dot(&(r * first_b.axis())) < config.max_view_angle_rad.cos() {
                continue;
            }
            // Predicted point of a keypoint of the first in the body frame of the second.
            let expected: Vec<(Vector3<f64>, f64)> = keypoints_a
                .iter()
                .map(|m| {
                    let rho = f64::from(m.keypoint.rho);
                    let x = m.body_from_left * m.bearing.ray + (m.arm - translation) * rho;
                    (r.transpose() * x, rho)
                })
                .collect();
            let best =
                |descriptor: &[u64; 4], among: &mut dyn Iterator<Item = (usize, &[u64; 4])>| {
                    let (mut best, mut second) = ((u32::MAX, usize::MAX), u32::MAX);
                    for (k, other) in among {
                        let bits = hamming_distance(descriptor, other);
                        if bits < best.0 {
                            second = best.0;
                            best = (bits, k);
                        } else if bits < second {
                            second = bits;
                        }
                    }
                    let sure = best.0 <= config.max_hamming
                        && f64::from(best.0) < config.second_best_ratio * f64::from(second);
                    sure.then_some(best.1)
                };
            for (q, keypoint_b) in keypoints_b.iter().enumerate() {
                let is_near = |p: usize| {
                    let (x, rho) = &expected[p];
                    let there = keypoint_b.body_from_left.transpose() * (x - keypoint_b.arm * *rho);
                    there.dot(&keypoint_b.bearing.ray)
                        > config.max_search_angle_rad.cos() * there.norm()
                };
                let mut near = (keypoints_a.iter().enumerate())
                    .filter(|(p, _)| is_near(*p))
                    .map(|(p, m)| (p, &m.keypoint.descriptor));
                let Some(p) = best(&keypoint_b.keypoint.descriptor, &mut near) else {
                    continue;
                };
                let keypoint_a = &keypoints_a[p];
                let mut all =
                    (keypoints_b.iter().enumerate()).map(|(q, m)| (q, &m.keypoint.descriptor));
                if best(&keypoint_a.keypoint.descriptor, &mut all) != Some(q) {
                    continue;
                }
                let weight = if keypoint_a.range.is_some() && keypoint_b.range.is_some() {
                    0.5
                } else {
                    1.0
                };
                for (point, by, is_back) in [
                    (keypoint_a, keypoint_b, false),
                    (keypoint_b, keypoint_a, true),
                ] {
                    out.extend(point.range.map(|[rho, rho_sigma]| Match {
                        ray: point.body_from_left * point.bearing.ray,
                        origin: point.arm,
                        rho,
                        rho_sigma,
                        body_from_left: by.body_from_left,
                        arm: by.arm,
                        bearing: by.bearing,
                        is_back,
                        weight,
                    }));
                }
            }
        }
    }
    out
}

#[cfg(test)]
mod tests;
