//! Estimation of the newest pose alone: landmarks and all other frames are fixed.

use nalgebra::{SMatrix, SVector, Vector3};

use crate::backend::motion_factor;
use crate::backend::observation::{BearingObservation, CameraPose};
use crate::backend::solver::{ByPose, residuals};
use crate::backend::state::{POSE_DIM, STATE_DIM, State};
use crate::backend::window::Window;

/// Information of the newest state, everything else fixed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NewestInformation {
    /// Of images and motion factor together.
    all: SMatrix<f64, STATE_DIM, STATE_DIM>,
    /// Of images alone, about the pose.
    images: SMatrix<f64, POSE_DIM, POSE_DIM>,
}

impl NewestInformation {
    /// Covariance of the pose, if the standard deviations of images are multiplied by `times`.
    pub(crate) fn pose_covariance(&self, times: f64) -> Option<SMatrix<f64, POSE_DIM, POSE_DIM>> {
        let mut information = self.all;
        let mut view = information.fixed_view_mut::<POSE_DIM, POSE_DIM>(0, 0);
        view -= self.images * (1.0 - 1.0 / (times * times));
        let covariance = information.cholesky()?.inverse();
        Some(
            covariance
                .fixed_view::<POSE_DIM, POSE_DIM>(0, 0)
                .into_owned(),
        )
    }
}

/// Optimizes the newest state with everything else fixed, and returns its information. The loss is
/// Tukey's with a scale that decreases with the iterations. `start_covariance` is the covariance of
/// the previous state, whose velocity, biases and tilt are uncertain.
pub(crate) fn refine_newest(
    window: &mut Window,
    start_covariance: &SMatrix<f64, STATE_DIM, STATE_DIM>,
    rounds: usize,
) -> Option<NewestInformation> {
    let last = window.frames.len() - 1;
    let number = window.frames[last].number;
    let config = window.config;
    let sigma = config.observation_sigma_px;
    // Landmarks are fixed: positions in the world, scaled by their inverse ranges.
    let visual_terms: Vec<(Vector3<f64>, Vector3<f64>, f64, BearingObservation)> = window
        .landmarks
        .values()
        .filter_map(|landmark| {
            let observations = &landmark.observations[landmark.since(number)..];
            let (host_number, host) = &landmark.observations[0];
            let frame = window.position(*host_number)?;
            if observations.is_empty() || frame == last {
                return None;
            }
            let camera_pose = CameraPose::new(&window.frames[frame].state, host.exposure_offset_s);
            let (rotation, arm) = &window.cameras[host.camera].body_from_left;
            let in_host = rotation * host.left.ray + arm * landmark.rho;
            let x = camera_pose.rotation * in_host;
            let each = observations.iter();
            Some(
                each.map(move |(_, observation)| {
                    (x, camera_pose.position, landmark.rho, *observation)
                }),
            )
        })
        .flatten()
        .collect();
    // Without an IMU the guess may have a large error.
    let preintegrated = window.frames[last]
        .motion
        .as_ref()
        .is_some_and(|m| m.has_gravity);
    let reach: &[f64] = if preintegrated {
        &config.newest_pose.tukey_sigma
    } else {
        &config.newest_pose.tukey_sigma_without_imu
    };
    let mut information = None;
    for round in 0..rounds + reach.len() {
        let state: State = window.frames[last].state;
        let scale = reach
            .get(round)
            .copied()
            .unwrap_or(config.newest_pose.tukey_sigma_final);
        let mut h = SMatrix::<f64, STATE_DIM, STATE_DIM>::zeros();
        let mut g = SVector::<f64, STATE_DIM>::zeros();
        for (x, position, rho, observation) in &visual_terms {
            let camera = &window.cameras[observation.camera];
            let camera_pose = CameraPose::new(&state, observation.exposure_offset_s);
            let (rotation, arm) = &camera.body_from_left;
            let in_target =
                camera_pose.rotation.transpose() * (x + (position - camera_pose.position) * *rho);
            let x_in_left = rotation.transpose() * (in_target - arm * *rho);
            let left_from_world = rotation.transpose() * camera_pose.rotation.transpose();
            let by_rotation =
                rotation.transpose() * in_target.cross_matrix() * camera_pose.then_from_state;
            let rays = residuals(
                camera,
                observation,
                &x_in_left,
                &Vector3::zeros(),
                *rho,
                false,
                &config,
            );
            for r in rays.into_iter().flatten() {
                let size = r.residual.norm() / (sigma * scale);
                if size >= 1.0 {
                    continue;
                }
                let weight = (1.0 - size * size).powi(2) / (sigma * sigma);
                let mut j = ByPose::zeros();
                j.fixed_columns_mut::<3>(0)
                    .copy_from(&(-r.by_x * left_from_world * *rho));
                j.fixed_columns_mut::<3>(3)
                    .copy_from(&(r.by_x * by_rotation));
                let weighted = j.transpose() * weight;
                let block = weighted * j;
                let mut view = h.fixed_view_mut::<POSE_DIM, POSE_DIM>(0, 0);
                view += block;
                let mut rows = g.fixed_rows_mut::<POSE_DIM>(0);
                rows += weighted * r.residual;
            }
        }
        let images = h.fixed_view::<POSE_DIM, POSE_DIM>(0, 0).into_owned();
        if let (Some(motion), true) = (&window.frames[last].motion, last > 0) {
            let before = &window.frames[last - 1].state;
            let (information, gradient) =
                motion_factor::with_uncertain_start(motion, before, start_covariance, &state);
            h += information;
            g += gradient;
        }
        let step = -h.cholesky()?.solve(&g);
        if !step.iter().all(|v| v.is_finite()) {
            return None;
        }
        information = Some(NewestInformation { all: h, images });
        window.frames[last].state = state.plus(&step);
        if round >= reach.len() && step.fixed_rows::<POSE_DIM>(0).amax() < 1e-6 {
            break;
        }
    }
    information
}
