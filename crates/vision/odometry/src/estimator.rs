//! Causal estimator: sliding-window visual-inertial odometry.
//!
//! Contract: [`Odometry::add_imu`] takes samples in order of time, [`Odometry::add_frames`] frame
//! sets in order of time, after the samples up to their time (later samples are used for later
//! sets). Each set gives one [`Estimate`] that depends on earlier input only. If the images of a
//! set have too few inliers, the IMU propagates the pose while its sigma is small. A pose without
//! support is lost, and its covariance states its uncertainty.

use std::collections::BTreeMap;

use cad_transforms::RigidTransform;
use nalgebra::{DMatrix, Matrix3, Matrix6, Vector3};
use rayon::prelude::*;

use crate::backend::covariance::{
    NewestCovariance, in_rig_frame, relative_in_rig_frame, tilt_uncertainty,
};
use crate::config::Config;
use crate::estimator::reinitialization::ResetUncertainty;
use crate::inertial::imu_set::{ImuSet, ImuUse, body_frame, motion_factor};
use crate::input::FrameSet;
use crate::keyframe::Keyframe;
use crate::rig::Rig;
use camera_models::ImuSample;
use imaging::Pyramid;

use crate::backend::extrinsics::{self, ExtrinsicsPrior};
use crate::backend::gyro_scale::GyroScale;
use crate::backend::heading_drift::HeadingDrift;
use crate::backend::motion_factor;
use crate::backend::newest_pose::{pose_by_calibrations, refine_newest};
use crate::backend::observation::{Camera, CameraPose};
use crate::backend::solver::{Damping, optimize_window};
use crate::backend::state::{ROTATION, State};
use crate::backend::stereo;
use crate::backend::window::{Frame, MotionFactor, Window};
use crate::frontend::stale_image::StaleImageDetector;
use crate::frontend::tracker::{PredictedPixel, Track, Tracker, transfer_pixel};

mod camera_agreement;
pub(crate) mod camera_shift;
mod cross_camera;
#[doc(hidden)]
pub mod feature_tracks;
pub(crate) mod initialization;
mod keyframes;
mod outliers;
pub(crate) mod reinitialization;

use camera_shift::CameraShift;
#[cfg(test)]
mod tests;

use camera_agreement::{Agreement, compare_cameras};
use outliers::count_inliers;
pub(crate) use outliers::sigma_ratio;

/// Status of a pose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// Enough inliers in the images.
    Tracked,
    /// Propagated by the IMU, or with very few inliers.
    DeadReckoned,
    /// Without support.
    Lost,
}

/// Estimate of one frame set.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Estimate {
    /// Time of the frame set, ns.
    pub time_ns: i64,
    /// Pose of the rig. The world has z up, and its origin and heading are those of the first pose:
    /// of the first IMU if there is one, else of the rig.
    pub world_from_rig: RigidTransform,
    /// Covariance of a small motion of the rig in its own axes relative to the first pose:
    /// translation m, rotation rad.
    pub covariance: Matrix6<f64>,
    /// Pose of the rig in the odom frame (REP 105), which begins as the world and drifts from it:
    /// the sum of the motions from keyframe to keyframe. It does not jump where the window corrects
    /// its keyframes, as `world_from_rig` does.
    pub odom_from_rig: RigidTransform,
    /// Covariance of the pose relative to the keyframe before it, as a small motion of the rig in
    /// its own axes: translation m, rotation rad. Zero for the first pose. Where the solver has
    /// none: 1 m and 1 rad, times [`sigma_inflation`](crate::config::CovarianceConfig).
    pub relative_covariance: Matrix6<f64>,
    /// Velocity of the origin of the rig in the world, m/s.
    pub velocity: Vector3<f64>,
    /// Status of the pose.
    pub status: Status,
    /// Number of inlier observations.
    pub inliers: usize,
    /// Whether the frame set became a keyframe.
    pub is_keyframe: bool,
    /// Bias of the gyroscope in use, rad/s, in the axes of the body: those of the first IMU of the
    /// rig, also while another one is in use. Without IMUs it means nothing.
    pub gyro_bias: Vector3<f64>,
    /// Bias of the accelerometer in use, m/s², in the same axes.
    pub accel_bias: Vector3<f64>,
}

/// Visual-inertial odometry of one rig.
pub struct Odometry {
    config: Config,
    cameras: Vec<Camera>,
    body_from_rig: RigidTransform,
    imus: Option<ImuSet>,
    trackers: Vec<Tracker>,
    /// Detectors of stale images, one per camera, with its last fresh left image.
    stale_detectors: Vec<Option<StaleImageDetector>>,
    window: Option<Window>,
    /// Whether the newest frame of the window is a keyframe.
    newest_is_keyframe: bool,
    /// Covariance of the state of the last keyframe and of the calibrations.
    keyframe_covariance: NewestCovariance,
    /// Priors of the extrinsics.
    extrinsics: Vec<ExtrinsicsPrior>,
    /// Information of the calibrations at the start of the window: extrinsics of all cameras,
    /// followed by their stereo calibrations.
    calibration_information: DMatrix<f64>,
    /// Scale errors of the gyroscope at the start of the window, and their information.
    gyro_scale: (Vector3<f64>, Matrix3<f64>),
    last: Option<State>,
    /// Poses of the body in the odom frame: at the last keyframe, and at the last frame set.
    odom_from_keyframe: RigidTransform,
    odom_from_body: RigidTransform,
    /// Whether tracking is lost, until the window is reinitialized.
    is_lost: bool,
    damping: Damping,
    /// Uncertainty of earlier resets that the covariance of the window does not contain.
    unmodeled: Option<ResetUncertainty>,
    camera_shifts: Vec<CameraShift>,
    number: u64,
    heading_drift: HeadingDrift,
    next_track: u64,
    /// Features of the last keyframe: camera, track id, ray.
    reference: Vec<(usize, u64, Vector3<f64>)>,
    /// Keyframes still in the window, and finished ones that have left it.
    pending: BTreeMap<u64, Keyframe>,
    ready: Vec<Keyframe>,
}

impl Odometry {
    /// Creates the estimator of a rig.
    ///
    /// # Panics
    /// If the prior of the [stereo calibrations](crate::config::StereoCalibrationConfig) is
    /// singular: for a sigma of 0, or for a correlation of 1 between several cameras.
    pub fn new(rig: &Rig, config: Config) -> Self {
        let (mut cameras, body_from_rig) = body_frame(rig);
        let stereo_information = stereo::prior_information(&config.backend, &rig.cameras);
        let inflation = config.backend.covariance.sigma_inflation;
        if let Some(covariance) = stereo_information.clone().try_inverse() {
            stereo::set_covariances(&mut cameras, inflation, &covariance);
        }
        let extrinsics =
            ExtrinsicsPrior::of_rig(&config.backend.extrinsics, &rig.cameras, &cameras);
        Self {
            config,
            cameras,
            body_from_rig,
            imus: ImuSet::new(rig, &config),
            trackers: vec![Tracker::new(config.frontend); rig.cameras.len()],
            stale_detectors: vec![None; rig.cameras.len()],
            window: None,
            newest_is_keyframe: true,
            keyframe_covariance: NewestCovariance {
                joint: DMatrix::zeros(0, 0),
                gyro_scale: Matrix3::zeros(),
            },
            gyro_scale: (
                Vector3::zeros(),
                GyroScale::prior_information(config.backend.covariance.sigma_inflation),
            ),
            calibration_information: extrinsics::joint_information(
                &extrinsics,
                inflation * inflation,
                &stereo_information,
            ),
            extrinsics,
            last: None,
            odom_from_keyframe: RigidTransform::identity(),
            odom_from_body: RigidTransform::identity(),
            is_lost: false,
            damping: Damping::UNSETTLED,
            unmodeled: None,
            camera_shifts: Vec::new(),
            number: 0,
            heading_drift: HeadingDrift::default(),
            next_track: 0,
            reference: Vec::new(),
            pending: BTreeMap::new(),
            ready: Vec::new(),
        }
    }

    /// Adds a sample of the IMU with this index in the rig.
    ///
    /// Half a second at rest shows which direction is up:
    ///
    /// ```
    /// use camera_models::ImuNoise;
    /// use odometry::rig::Imu;
    /// use odometry::{Config, FrameSet, ImuSample, Odometry, Preset, Rig};
    /// # use cad_transforms::RigidTransform;
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
    /// # let noise = ImuNoise {
    /// #     gyro_noise_density: 1e-4,
    /// #     accel_noise_density: 2e-3,
    /// #     gyro_random_walk: 1e-5,
    /// #     accel_random_walk: 1e-4,
    /// # };
    /// # let rig_from_imu = RigidTransform::identity();
    /// # let imu = Imu { name: "front/imu".to_owned(), rig_from_imu, noise, rate_hz: 100.0, range: [f64::INFINITY; 2] };
    ///
    /// let rig = Rig { cameras: vec![camera], imus: vec![imu] };
    /// let mut odometry = Odometry::new(&rig, Config::preset(Preset::Fast));
    /// for k in 0..60 {
    ///     // The y axis points down, so the specific force at rest is along -y. No sensor gives the same value for long.
    ///     let noise = 1e-4 * (k % 7) as f64;
    ///     let (gyro, accel) = ([0.0, 0.0, noise], [0.0, noise - 9.80665, 0.0]);
    ///     odometry.add_imu(0, &ImuSample { time_ns: k * 10_000_000, gyro, accel });
    /// }
    /// let estimate = odometry.add_frames(&FrameSet { time_ns: 590_000_000, views: vec![None] });
    /// let up_in_world = estimate.world_from_rig.rotate([0.0, -1.0, 0.0]);
    /// assert!(up_in_world[2] > 0.999, "{up_in_world:?}");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn add_imu(&mut self, imu: usize, sample: &ImuSample) {
        if let Some(imus) = &mut self.imus {
            imus.push(imu, sample);
        }
    }

    /// Adds a frame set and estimates its pose.
    ///
    /// # Panics
    /// If the set has fewer views than the rig has cameras: a camera without a frame has `None`.
    pub fn add_frames(&mut self, set: &FrameSet<'_>) -> Estimate {
        let time_ns = set.time_ns;
        self.number += 1;
        let pyramid = &self.config.frontend.pyramid;
        let pyramids: Vec<Option<(Pyramid, Pyramid)>> = (set.views.par_iter())
            .map(|view| {
                let view = view.as_ref()?;
                Some(rayon::join(
                    || Pyramid::new(pyramid, &view.left),
                    || Pyramid::new(pyramid, &view.right),
                ))
            })
            .collect();
        for (tracker, view) in self.trackers.iter_mut().zip(&set.views) {
            tracker.set_mask(view.as_ref().and_then(|v| v.mask));
        }
        let exposure_offset_s: Vec<f64> = (set.views.iter())
            .map(|view| {
                view.as_ref()
                    .map_or(0.0, |v| (v.time_ns - time_ns) as f64 * 1e-9)
            })
            .collect();
        let Some(mut window) = self.window.take() else {
            return self.initialize(time_ns, pyramids, &exposure_offset_s);
        };
        if !self.newest_is_keyframe {
            window.drop_newest();
        }
        let (motion, guess) = self.predict(&window, time_ns);
        // Features are predicted from the last pose, keyframe or not, and the predicted pose.
        let last = self.last.unwrap_or(window.newest().state);
        self.track(pyramids, (&last, &guess), &exposure_offset_s);
        window.frames.push(Frame {
            number: self.number,
            state: guess,
            motion: Some(motion),
        });
        self.match_in_new_frames(&mut window, &exposure_offset_s);
        let mut information = self.estimate_newest_pose(&mut window);
        let mut deviation = Matrix6::zeros();
        let start_covariance = &self.keyframe_covariance;
        match compare_cameras(
            &self.config.estimator,
            &mut window,
            &guess,
            start_covariance,
        ) {
            Agreement::All => {}
            Agreement::Majority(of_others) => information = of_others.map(|of| *of),
            Agreement::NoMajority(covariance) => {
                deviation
                    .fixed_view_mut::<3, 3>(0, 0)
                    .copy_from(&covariance);
            }
        }
        if self.follow_camera_shift(&mut window) {
            information = refine_newest(&mut window, &self.keyframe_covariance, 1, |_| true);
        }
        let (_, observed) = count_inliers(&window);
        let inliers = self.reject_outliers(&mut window);
        let is_enough = inliers >= self.config.estimator.min_inliers
            && inliers as f64 >= self.config.estimator.min_inlier_ratio * observed as f64;
        let is_tracked = is_enough && !self.is_lost;
        let mut is_connected = true;
        if !is_tracked {
            // A few accidental inliers would be accepted: the pose follows the IMU prediction.
            is_connected = self.discard_newest(&mut window, guess);
            information = refine_newest(&mut window, &self.keyframe_covariance, 1, |_| true);
            deviation = Matrix6::zeros();
        }
        let is_keyframe = self.is_keyframe(&window, is_tracked);
        let mut joint = None;
        if self.number > self.config.backend.initial_frames && self.is_tilt_known(time_ns) {
            self.damping = Damping::SETTLED;
        }
        if is_keyframe || self.optimizes_every_frame(time_ns) {
            let rounds = self.config.backend.max_iterations;
            joint = optimize_window(&mut window, rounds, self.damping).1;
        }
        let present = set.views.iter().flatten().count();
        let times = sigma_ratio(&self.config.estimator, inliers, present);
        let own = |times: f64| information.and_then(|of| of.pose_covariance(times));
        // Few inliers may all be on one object that moves.
        let relative_covariance = own(times).unwrap_or_else(Matrix6::identity) + deviation;
        let unexplained = own(1.0).map_or_else(Matrix6::zeros, |own| relative_covariance - own);
        let last_odom = self.odom_from_body;
        let before = &window.frames[window.frames.len() - 2].state;
        self.odom_from_body =
            self.odom_from_keyframe * (before.pose().inverse() * window.newest().state.pose());
        let motion = last_odom.inverse() * self.odom_from_body;
        if is_keyframe {
            self.odom_from_keyframe = self.odom_from_body;
        }
        let from_keyframe = || {
            let from = &window.frames[window.frames.len() - 2].state;
            let by = information.and_then(|of| pose_by_calibrations(&window, &of));
            self.keyframe_covariance
                .at_newest(from, &window.newest().state, by.as_ref())
        };
        let covariance = match &joint {
            Some(joint) => joint.pose() + unexplained,
            None => from_keyframe() + relative_covariance,
        };
        if let Some(joint) = joint.filter(|_| is_keyframe) {
            self.keyframe_covariance = joint;
        }
        // Features are matched with the estimated calibrations.
        self.cameras.clone_from(&window.cameras);
        stereo::set_covariances(
            &mut self.cameras,
            self.config.backend.covariance.sigma_inflation,
            &self.keyframe_covariance.stereo(),
        );
        if is_keyframe {
            self.filter_landmarks(&mut window);
            self.insert_keyframe(&mut window, &exposure_offset_s);
        }
        self.newest_is_keyframe = is_keyframe;
        self.is_lost |= !is_connected && self.needs_reinitialization(time_ns, &covariance);
        self.add_heading_drift(&window.newest().state);
        let estimate = self.estimate(
            &window,
            &covariance,
            &relative_covariance,
            inliers,
            is_tracked,
            is_keyframe,
        );
        if is_keyframe && unexplained != Matrix6::zeros() {
            self.add_unmodeled(&window.newest().state, unexplained);
        }
        if self.is_lost {
            self.reinitialize(&mut window, &covariance);
        }
        let mut state = window.newest().state;
        if self.gyro_rate(time_ns).is_none() {
            // Without a gyroscope the angular rate is assumed constant.
            let seconds = (state.time_ns - last.time_ns) as f64 * 1e-9;
            let rotation_change = cad_transforms::so3::log(motion.rotation());
            state.gyro_rate = rotation_change / seconds.max(1e-3) + state.gyro_bias;
            if let Some(newest) = window.frames.last_mut() {
                newest.state.gyro_rate = state.gyro_rate;
            }
        }
        self.last = Some(state);
        if let (Some(imus), Some(first)) = (&mut self.imus, window.frames.last()) {
            // The window preintegrates again from its last keyframe.
            let from = if self.newest_is_keyframe {
                first.state.time_ns
            } else {
                window.frames[window.frames.len() - 2].state.time_ns
            };
            let window_ns = self.config.estimator.initialization.window_ns;
            imus.forget_before(from.min(time_ns) - window_ns);
        }
        self.window = Some(window);
        estimate
    }

    /// Whether the whole window is optimized for the next frame set, keyframe or not.
    fn optimizes_every_frame(&self, time_ns: i64) -> bool {
        self.number <= self.config.backend.initial_frames || !self.is_tilt_known(time_ns)
    }

    /// Whether the tilt is known as well as it is going to be; without an IMU it always is.
    fn is_tilt_known(&self, time_ns: i64) -> bool {
        // In the world, z is the heading.
        let covariance = self.keyframe_covariance.state();
        let rotation = covariance.fixed_view::<3, 3>(ROTATION, ROTATION);
        let up = |last: State| last.rotation.inverse() * Vector3::z();
        let up = self.last.map_or(Vector3::z(), up);
        let variance = rotation.trace() - (up.transpose() * rotation * up)[0];
        let settled = self.config.backend.settled_tilt_sigma_rad.powi(2);
        self.is_imu_silent(time_ns) || variance <= settled
    }

    /// Tracks all features into new images. The predictions follow from the last and the predicted
    /// state.
    fn track(
        &mut self,
        pyramids: Vec<Option<(Pyramid, Pyramid)>>,
        (last, guess): (&State, &State),
        exposure_offset_s: &[f64],
    ) {
        for (k, (tracker, pyramids)) in self.trackers.iter_mut().zip(pyramids).enumerate() {
            let camera = &self.cameras[k];
            let stale_detectors = &mut self.stale_detectors[k];
            let fresh = pyramids.as_ref().map_or(0, |(left, _)| {
                StaleImageDetector::count_fresh_rows(
                    &self.config.frontend.stale_image,
                    stale_detectors,
                    left,
                    guess,
                    camera,
                )
            });
            let (Some((left, right)), 1..) = (pyramids, fresh) else {
                tracker.clear();
                continue;
            };
            tracker.mask_rows_below(fresh, left.levels[0].width, left.levels[0].height);
            let (then, now) = (
                world_from_left(camera, &CameraPose::new(last, exposure_offset_s[k])),
                world_from_left(camera, &CameraPose::new(guess, exposure_offset_s[k])),
            );
            let back = now.0.transpose();
            let now_from_then = (back * then.0, back * (then.1 - now.1));
            tracker.track(camera, left, right, |track| {
                let rho = track.rho.unwrap_or(0.0);
                let expected = transfer_pixel(camera, &now_from_then, &track.left.ray, rho);
                expected.map_or(
                    PredictedPixel {
                        at: track.at,
                        rho: track.rho,
                    },
                    |e| PredictedPixel {
                        rho: track.rho.and(e.rho),
                        ..e
                    },
                )
            });
        }
    }

    /// Motion factor from the newest frame of the window to `time_ns`, and the predicted state.
    fn predict(&mut self, window: &Window, time_ns: i64) -> (MotionFactor, State) {
        let from = &window.newest().state;
        let rate = self.rate();
        let imus = self.imus.as_mut();
        let motion = motion_factor(imus, &self.config, from, time_ns, rate, true);
        let mut guess = State {
            gyro_rate: self.gyro_rate(time_ns).unwrap_or(from.gyro_rate),
            ..motion_factor::predict(&motion, from, &window.prior.gyro_scale.error, time_ns)
        };
        if let (false, Some(last)) = (motion.has_gravity, &self.last) {
            // The last frame set is nearer than the keyframe, whose velocity may not yet be known.
            let seconds = (time_ns - last.time_ns) as f64 * 1e-9;
            let (rotation, position) = last.pose_after(seconds);
            let is_rotation_measured = self.gyro_rate(time_ns).is_some();
            guess = State {
                position,
                rotation: if is_rotation_measured {
                    guess.rotation
                } else {
                    rotation
                },
                velocity: last.velocity,
                ..guess
            };
        }
        (motion, guess)
    }

    /// Gyroscope measurement at a time, rad/s; `None` if it is missing or saturated.
    fn gyro_rate(&self, time_ns: i64) -> Option<Vector3<f64>> {
        self.imus.as_ref()?.current().gyro_rate(time_ns)
    }

    /// Last angular rate in the body frame, rad/s.
    fn rate(&self) -> Vector3<f64> {
        self.last.as_ref().map_or(Vector3::zeros(), State::rate)
    }

    fn add_heading_drift(&mut self, state: &State) {
        let world_from_rig = state.world_from_rig(&self.body_from_rig);
        let config = &self.config.backend.covariance;
        (self.heading_drift).add(config, state.time_ns, &world_from_rig);
    }

    fn estimate(
        &self,
        window: &Window,
        covariance: &Matrix6<f64>,
        relative_covariance: &Matrix6<f64>,
        inliers: usize,
        is_tracked: bool,
        is_keyframe: bool,
    ) -> Estimate {
        let state = &window.newest().state;
        let covariance = self.with_unmodeled(state, *covariance);
        let (config, body) = (&self.config.backend.covariance, &self.body_from_rig);
        let mut covariance = in_rig_frame(config, state, body, &covariance);
        let status = if is_tracked {
            Status::Tracked
        } else {
            let max_variance = covariance
                .fixed_view::<3, 3>(0, 0)
                .symmetric_eigenvalues()
                .amax();
            let is_near = max_variance.sqrt()
                < self.config.estimator.lost_sigma_m
                    + self.config.estimator.lost_sigma_per_metre * state.position.norm();
            if is_near && !self.is_lost {
                Status::DeadReckoned
            } else {
                Status::Lost
            }
        };
        let arm = body.translation();
        let velocity = state.velocity + state.rotation * state.rate().cross(arm);
        let world_from_rig = state.world_from_rig(body);
        covariance += self.heading_drift.covariance(config);
        if self.imus.is_none() {
            covariance += tilt_uncertainty(config, &world_from_rig);
        }
        Estimate {
            time_ns: state.time_ns,
            world_from_rig,
            covariance,
            odom_from_rig: self.odom_from_body * *body,
            relative_covariance: relative_in_rig_frame(config, state, body, relative_covariance),
            velocity,
            status,
            inliers,
            is_keyframe,
            gyro_bias: state.gyro_bias,
            accel_bias: state.accel_bias,
        }
    }

    /// The IMUs whose samples were used, in order of time: the first one with samples, then those
    /// that took over. Empty without IMU or before the first frame set.
    pub fn imu_uses(&self) -> &[ImuUse] {
        self.imus.as_ref().map_or(&[], ImuSet::uses)
    }

    /// Detected camera shifts, in order of time, as estimated when they happened.
    pub fn camera_shifts(&self) -> &[CameraShift] {
        &self.camera_shifts
    }

    /// Currently tracked features in the left image of one camera: id and position, px, for
    /// display.
    pub fn tracked_features(&self, camera: usize) -> Vec<(u64, [f32; 2])> {
        let tracks = &self.trackers[camera].tracks;
        tracks.iter().map(|t: &Track| (t.id, t.at)).collect()
    }
}

/// World from left optical frame.
fn world_from_left(camera: &Camera, pose: &CameraPose) -> (Matrix3<f64>, Vector3<f64>) {
    let (rotation, arm) = &camera.body_from_left;
    (
        pose.rotation * rotation,
        pose.position + pose.rotation * arm,
    )
}
