//! Estimation of the newest pose alone: landmarks and all other frames are fixed.

use nalgebra::{Const, Dyn, Matrix3, OMatrix, SMatrix, SVector, Vector3};

use crate::backend::covariance::{CALIBRATION_DIM, NewestCovariance};
use crate::backend::extrinsics::jacobians_by_extrinsics;
use crate::backend::motion_factor;
use crate::backend::observation::{BearingObservation, CameraPose};
use crate::backend::reprojection::{ByPose, Residual, residuals};
use crate::backend::state::{POSE_DIM, STATE_DIM, State};
use crate::backend::stereo::STEREO_DIM;
use crate::backend::window::{Landmark, Window};

/// Information of the newest state, everything else fixed.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NewestInformation {
    /// Of images and motion factor together.
    all: SMatrix<f64, STATE_DIM, STATE_DIM>,
    /// Of images alone, about the pose.
    images: SMatrix<f64, POSE_DIM, POSE_DIM>,
    /// Cameras whose observations are in it, a bit each.
    cameras: u64,
}

impl NewestInformation {
    /// Whether observations of this camera are in it.
    fn uses_camera(&self, camera: usize) -> bool {
        self.cameras & (1 << camera) != 0
    }

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

    /// Covariance of the difference between the poses of two estimates with different images and
    /// the same motion factor.
    pub(crate) fn difference_covariance(
        &self,
        other: &Self,
    ) -> Option<SMatrix<f64, POSE_DIM, POSE_DIM>> {
        // That of the other estimate is the same but for its linearization point.
        let mut motion = self.all;
        let mut view = motion.fixed_view_mut::<POSE_DIM, POSE_DIM>(0, 0);
        view -= self.images;
        let [a, b] = [self, other].map(|of| Some(of.all.cholesky()?.inverse()));
        let (a, b) = (a?, b?);
        let by_images = |covariance: &SMatrix<f64, STATE_DIM, STATE_DIM>, of: &Self| {
            let pose = covariance.fixed_view::<POSE_DIM, POSE_DIM>(0, 0);
            pose * of.images * pose
        };
        let by_motion = a.fixed_rows::<POSE_DIM>(0) - b.fixed_rows::<POSE_DIM>(0);
        let common = by_motion * motion * by_motion.transpose();
        Some(by_images(&a, self) + by_images(&b, other) + common)
    }
}

/// Observation of a landmark in the newest frame, the landmark fixed.
struct NewestObservation<'a> {
    landmark: &'a Landmark,
    observation: &'a BearingObservation,
    /// Pose of the body at the landmark's host.
    host: CameraPose,
    /// Point relative to the body at the host, in the axes of the world, scaled by its inverse
    /// range, and its derivative by the inverse range.
    x: Vector3<f64>,
    x_by_rho: Vector3<f64>,
}

/// Observations of the newest frame.
fn newest_observations<'a>(
    window: &'a Window,
    uses_camera: impl Fn(usize) -> bool,
) -> Vec<NewestObservation<'a>> {
    let last = window.frames.len() - 1;
    let number = window.frames[last].number;
    let uses_camera = &uses_camera;
    let of_landmark = |landmark: &'a Landmark| {
        let observations = &landmark.observations;
        let (host_number, host) = &observations[0];
        let frame = window
            .position(*host_number)
            .filter(|frame| *frame != last)?;
        let host_pose = CameraPose::new(&window.frames[frame].state, host.exposure_offset_s);
        let (rotation, arm) = &window.cameras[host.camera].body_from_left;
        let x_by_rho = host_pose.rotation * arm;
        let x = host_pose.rotation * (rotation * host.left.ray) + x_by_rho * landmark.rho;
        let newest = &observations[landmark.since(number)..];
        let used = newest.iter().filter(|(_, o)| uses_camera(o.camera));
        Some(used.map(move |(_, observation)| NewestObservation {
            landmark,
            observation,
            host: host_pose,
            x,
            x_by_rho,
        }))
    };
    (window.landmarks.values().filter_map(of_landmark))
        .flatten()
        .collect()
}

/// Its point in the left frame of the newest frame, scaled by its inverse range, with Jacobians.
struct NewestPoint {
    x: Vector3<f64>,
    by_rho: Vector3<f64>,
    by_rotation: Matrix3<f64>,
    left_from_world: Matrix3<f64>,
}

impl NewestObservation<'_> {
    fn point(&self, window: &Window, state: &State) -> NewestPoint {
        let rho = self.landmark.rho;
        let pose = CameraPose::new(state, self.observation.exposure_offset_s);
        let (rotation, arm) = &window.cameras[self.observation.camera].body_from_left;
        let offset = self.host.position - pose.position;
        let in_target = pose.rotation.transpose() * (self.x + offset * rho);
        let left_from_world = rotation.transpose() * pose.rotation.transpose();
        NewestPoint {
            x: rotation.transpose() * (in_target - arm * rho),
            by_rho: left_from_world * (self.x_by_rho + offset) - rotation.transpose() * arm,
            by_rotation: rotation.transpose() * in_target.cross_matrix() * pose.then_from_state,
            left_from_world,
        }
    }

    /// Residuals in both images, and their Jacobians by the pose.
    fn linearize(&self, window: &Window, point: &NewestPoint) -> [Option<(Residual, ByPose)>; 2] {
        let (rho, config) = (self.landmark.rho, &window.config);
        let camera = &window.cameras[self.observation.camera];
        let (x, by_rho) = (&point.x, &point.by_rho);
        let each = residuals(camera, self.observation, x, by_rho, rho, false, config);
        each.map(|residual| {
            let residual = residual?;
            let mut by_pose = ByPose::zeros();
            by_pose
                .fixed_columns_mut::<3>(0)
                .copy_from(&(-residual.by_x * point.left_from_world * rho));
            by_pose
                .fixed_columns_mut::<3>(3)
                .copy_from(&(residual.by_x * point.by_rotation));
            Some((residual, by_pose))
        })
    }

    /// Jacobians of the point by the extrinsics of the host and of the target.
    fn by_extrinsics(
        &self,
        window: &Window,
        point: &NewestPoint,
    ) -> [SMatrix<f64, 3, POSE_DIM>; 2] {
        let host = &self.landmark.observations[0].1;
        let (host_rotation, _) = &window.cameras[host.camera].body_from_left;
        let now_from_then = point.left_from_world * self.host.rotation * host_rotation;
        jacobians_by_extrinsics(&host.left.ray, self.landmark.rho, &now_from_then, &point.x)
    }
}

/// Weight of a residual by Tukey's loss with this scale, in standard deviations; `None` beyond it.
fn tukey_weight(residual: &Residual, sigma_px: f64, scale: f64) -> Option<f64> {
    let size = residual.residual.norm() / (sigma_px * scale);
    (size < 1.0).then(|| (1.0 - size * size).powi(2) / (sigma_px * sigma_px))
}

/// Derivative of the newest pose by the errors of the calibrations, with the cameras of its
/// information: the extrinsics of all cameras,
/// followed by their stereo calibrations, which change the inverse ranges of all landmarks alike.
pub(crate) fn pose_by_calibrations(
    window: &Window,
    information: &NewestInformation,
) -> Option<OMatrix<f64, Const<POSE_DIM>, Dyn>> {
    let state = &window.newest().state;
    let config = &window.config;
    let sigma = config.observation_sigma_px;
    let stereo_at = window.cameras.len() * POSE_DIM;
    let mut gradient =
        OMatrix::<f64, Const<POSE_DIM>, Dyn>::zeros(window.cameras.len() * CALIBRATION_DIM);
    for newest in newest_observations(window, |camera| information.uses_camera(camera)) {
        let (landmark, camera) = (newest.landmark, newest.observation.camera);
        let host = &landmark.observations[0].1;
        let rho_by_host = window.cameras[host.camera].inverse_range_by_stereo(host, landmark.rho);
        let point = newest.point(window, state);
        let by_extrinsics = newest.by_extrinsics(window, &point);
        for (r, by_pose) in newest.linearize(window, &point).into_iter().flatten() {
            let Some(weight) = tukey_weight(&r, sigma, config.newest_pose.tukey_sigma_final) else {
                continue;
            };
            let weighted = by_pose.transpose() * weight;
            for (camera, x_by) in [host.camera, camera].into_iter().zip(&by_extrinsics) {
                let mut own = gradient.fixed_columns_mut::<POSE_DIM>(camera * POSE_DIM);
                own += weighted * r.by_x * x_by;
            }
            let [of_host, of_target] = [host.camera, camera].map(|k| stereo_at + k * STEREO_DIM);
            let mut own = gradient.fixed_columns_mut::<STEREO_DIM>(of_host);
            own += weighted * r.by_rho * rho_by_host;
            let mut own = gradient.fixed_columns_mut::<STEREO_DIM>(of_target);
            own += weighted * r.by_stereo;
        }
    }
    Some(-information.pose_covariance(1.0)? * gradient)
}

/// Optimizes the newest state with everything else fixed, and returns its information. The loss is
/// Tukey's with a scale that decreases with the iterations. `start_covariance` is the covariance of
/// the previous state, whose velocity, biases and tilt are uncertain, as is the scale of the
/// gyroscope. Only observations of the cameras that `uses_camera` accepts are used.
pub(crate) fn refine_newest(
    window: &mut Window,
    start_covariance: &NewestCovariance,
    rounds: usize,
    uses_camera: impl Fn(usize) -> bool,
) -> Option<NewestInformation> {
    let last = window.frames.len() - 1;
    let config = window.config;
    let sigma = config.observation_sigma_px;
    let cameras = (0..window.cameras.len())
        .filter(|camera| uses_camera(*camera))
        .fold(0, |bits, camera| bits | 1 << camera);
    let observations = newest_observations(window, uses_camera);
    // Without measured specific force the guess may have a large error.
    let has_gravity = window.frames[last]
        .motion
        .as_ref()
        .is_some_and(|m| m.has_gravity);
    let reach: &[f64] = if has_gravity {
        &config.newest_pose.tukey_sigma
    } else {
        &config.newest_pose.tukey_sigma_without_imu
    };
    let mut state: State = window.frames[last].state;
    let mut information = None;
    for round in 0..rounds + reach.len() {
        let scale = reach
            .get(round)
            .copied()
            .unwrap_or(config.newest_pose.tukey_sigma_final);
        let mut h = SMatrix::<f64, STATE_DIM, STATE_DIM>::zeros();
        let mut g = SVector::<f64, STATE_DIM>::zeros();
        for observation in &observations {
            let both = observation.linearize(window, &observation.point(window, &state));
            for (r, j) in both.into_iter().flatten() {
                let Some(weight) = tukey_weight(&r, sigma, scale) else {
                    continue;
                };
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
            let (information, gradient) = motion_factor::with_uncertain_start(
                motion,
                before,
                start_covariance,
                &state,
                &window.prior.gyro_scale.error,
            );
            h += information;
            g += gradient;
        }
        let step = -h.cholesky()?.solve(&g);
        if !step.iter().all(|v| v.is_finite()) {
            return None;
        }
        information = Some(NewestInformation {
            all: h,
            images,
            cameras,
        });
        state = state.plus(&step);
        if round >= reach.len() && step.fixed_rows::<POSE_DIM>(0).amax() < 1e-6 {
            break;
        }
    }
    window.frames[last].state = state;
    information
}
