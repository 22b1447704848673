//! Mapping of a whole session: keyframes, their observations, preintegrated IMU motion and loop
//! closures.
//!
//! Contract. [`Mapping`] takes samples and keyframes of the estimator in order of time, and is
//! solved once. It gives a pose for every keyframe, in the world of the first one;
//! [`interpolate_poses`] gives the frame sets between keyframes theirs. The result is not causal: a
//! pose depends on all later input. Memory grows with the session: about 40 kB per keyframe, and
//! ten times that while solving. Same input, same bytes, on any number of threads.

use std::collections::BTreeMap;

use cad_transforms::RigidTransform;
use camera_models::Eye as Side;
use nalgebra::{DMatrix, Matrix6, UnitQuaternion, Vector3};

use crate::backend::covariance::{in_rig_frame, tilt_uncertainty};
use crate::backend::extrinsics::{self, ExtrinsicsPrior};
use crate::backend::gyro_scale::GyroScale;
use crate::backend::observation::{BearingObservation, Camera};
use crate::backend::solver::MIN_INVERSE_RANGE_PER_M;
use crate::backend::state::{POSE_DIM, ROTATION, State};
use crate::backend::stereo;
use crate::backend::window::{Frame, Landmark, MotionFactor, Prior, Window};
use crate::config::Config;
use crate::estimator::initialization::initial_sigmas;
use crate::estimator::sigma_ratio;
use crate::inertial::imu_set::{ImuSet, body_frame, motion_factor};
use crate::keyframe::Keyframe;
use crate::rig::Rig;
use camera_models::ImuSample;

mod bundle_adjustment;
mod connectivity;
mod loop_closure;
mod pose_interpolation;
mod stereo_calibration;

pub use bundle_adjustment::Progress;
pub use connectivity::Connectivity;
pub use pose_interpolation::{InterpolatedPose, OdomPose, interpolate_poses};
pub use stereo_calibration::RefinedStereo;

/// Pose of a keyframe after bundle adjustment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefinedPose {
    /// Number of the frame set.
    pub number: u64,
    /// Time, ns.
    pub time_ns: i64,
    /// Pose in the world of the first one.
    pub world_from_rig: RigidTransform,
    /// Covariance of a small motion of the rig in its own axes relative to the first pose:
    /// translation m, rotation rad. After a tracking loss it contains the unknown motion meanwhile,
    /// by the constant-velocity model.
    pub covariance: Matrix6<f64>,
}

/// Loop closure between two keyframes that observe the same place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopClosure {
    /// Numbers of the frame sets, the earlier one first.
    pub frames: [u64; 2],
    /// Number of inlier keypoint matches.
    pub inliers: usize,
    /// Error of the loop closure before bundle adjustment, m and rad.
    pub initial_error: [f64; 2],
}

/// Result of mapping.
#[derive(Clone, Debug)]
pub struct MappingResult {
    /// Poses, one per keyframe.
    pub poses: Vec<RefinedPose>,
    /// Loop closures that were used.
    pub loop_closures: Vec<LoopClosure>,
    /// Number of solver iterations.
    pub iterations: usize,
    /// Whether the solver converged. If not, poses and extrinsics are less accurate than their
    /// covariances state.
    pub is_converged: bool,
    /// Number of landmarks.
    pub landmarks: usize,
    /// Estimated extrinsics, one per camera of the rig.
    pub extrinsics: Vec<RefinedExtrinsics>,
    /// Estimated stereo calibrations, one per camera of the rig.
    pub stereo: Vec<RefinedStereo>,
}

/// Estimated extrinsics of a camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefinedExtrinsics {
    /// Extrinsics of the left camera, m.
    pub rig_from_left: RigidTransform,
    /// Covariance of a small motion of the left optical frame in its own axes: translation m,
    /// rotation rad.
    pub covariance: Matrix6<f64>,
    /// Deviation from the nominal extrinsics, m and rad.
    pub initial_error: [f64; 2],
    /// Whether its rotation deviates from the nominal one by more than three sigmas of the prior:
    /// the camera was moved, or the calibration belongs to another rig.
    pub is_moved: bool,
}

/// Bundle adjustment of a session.
///
/// ```
/// use odometry::{Config, FrameSet, Mapping, Odometry, Preset, Rig, View};
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
/// # let mut odometry = Odometry::new(&rig, Config::preset(Preset::Fast));
/// # for number in 0..3 {
/// #     let time_ns = number * 66_666_667;
/// #     let [left, right] = [0, 4].map(|shift| image(shift, 2 * number as u64 + shift as u64));
/// #     let [left, right] = [&left, &right].map(|pixels| ImageView::new(160, 120, 160, pixels).unwrap());
/// #     odometry.add_frames(&FrameSet { time_ns, views: vec![Some(View { time_ns, left, right, mask: None })] });
/// # }
///
/// let mut mapping = Mapping::new(&rig, &Config::preset(Preset::Fast));
/// for keyframe in odometry.take_keyframes(true) {
///     mapping.add_keyframe(keyframe);
/// }
/// let refined = mapping.optimize(|_| {});
/// assert_eq!(refined.poses.len(), mapping.len());
/// assert_eq!(refined.extrinsics.len(), 1);
/// // The rig was at rest, and nobody moved its camera.
/// assert!(refined.poses.iter().all(|pose| pose.world_from_rig.distance_m() < 0.02));
/// assert!(!refined.extrinsics[0].is_moved);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Mapping {
    cameras: Vec<Camera>,
    extrinsics: Vec<ExtrinsicsPrior>,
    /// Information of the calibrations before any image.
    calibration_information: DMatrix<f64>,
    body_from_rig: RigidTransform,
    imus: Option<ImuSet>,
    config: Config,
    keyframes: Vec<Keyframe>,
    motions: Vec<Option<MotionFactor>>,
}

impl Mapping {
    /// Creates the mapping of a rig, with the configuration of the estimator.
    ///
    /// # Panics
    /// If the prior of the [stereo calibrations](crate::config::StereoCalibrationConfig) is
    /// singular: for a sigma of 0, or for a correlation of 1 between several cameras.
    pub fn new(rig: &Rig, config: &Config) -> Self {
        let (cameras, body_from_rig) = body_frame(rig);
        let extrinsics =
            ExtrinsicsPrior::of_rig(&config.backend.extrinsics, &rig.cameras, &cameras);
        let stereo = stereo::prior_information(&config.backend, &rig.cameras);
        Self {
            // By stated sigmas, see `ExtrinsicsPrior::inflate`.
            calibration_information: extrinsics::joint_information(&extrinsics, 1.0, &stereo),
            extrinsics,
            cameras,
            body_from_rig,
            imus: ImuSet::new(rig, config),
            config: *config,
            keyframes: Vec::new(),
            motions: Vec::new(),
        }
    }

    /// Adds a sample of the IMU with this index in the rig.
    pub fn add_imu(&mut self, imu: usize, sample: &ImuSample) {
        if let Some(imus) = &mut self.imus {
            imus.push(imu, sample);
        }
    }

    /// Adds a keyframe, after the samples up to its time.
    pub fn add_keyframe(&mut self, keyframe: Keyframe) {
        let to = &keyframe.state;
        let motion = self.keyframes.last().map(|from| {
            let from = State::from(&from.state);
            let seconds = (to.time_ns - from.time_ns) as f64 * 1e-9;
            let rotation_change = from.rotation.inverse() * to.rotation;
            let rate = cad_transforms::so3::log(&rotation_change) / seconds.max(1e-3);
            let (imus, has_valid_samples) = (self.imus.as_mut(), keyframe.imu_valid);
            motion_factor(
                imus,
                &self.config,
                &from,
                to.time_ns,
                rate,
                has_valid_samples,
            )
        });
        if let Some(imus) = &mut self.imus {
            if motion.is_none() {
                imus.initialize(to.time_ns);
            }
            imus.forget_before(to.time_ns - 50_000_000);
        }
        self.motions.push(motion);
        self.keyframes.push(keyframe);
    }

    /// Number of keyframes.
    pub fn len(&self) -> usize {
        self.keyframes.len()
    }

    /// Whether there are no keyframes.
    pub fn is_empty(&self) -> bool {
        self.keyframes.is_empty()
    }

    /// Solves loop closure and bundle adjustment. `progress` is called with the current step.
    pub fn optimize(&self, mut progress: impl FnMut(Progress)) -> MappingResult {
        let Some(first) = self.keyframes.first() else {
            return MappingResult {
                poses: Vec::new(),
                loop_closures: Vec::new(),
                iterations: 0,
                is_converged: true,
                landmarks: 0,
                extrinsics: Vec::new(),
                stereo: Vec::new(),
            };
        };
        let config = &self.config.mapping;
        let [trusting, robust, cleaned] = config.max_iterations;
        let mut window = self.window(&State::from(&first.state));
        // Outliers with respect to causal poses and stereo ranges. This also removes correct
        // observations of distant points at the end of long tracks, which have drifted most. With
        // ranges fitted to all observations first, errors nearly double in bad light.
        bundle_adjustment::filter_landmarks(config, &mut window);
        let mut found = loop_closure::find(
            &config.loop_closure,
            &self.keyframes,
            &window,
            &mut progress,
        );
        // A long path has a large closure error: loop closures are trusted at first, and get a
        // tighter robust loss after they converged.
        let far = bundle_adjustment::optimize(config, &mut window, &found, trusting, &mut progress);
        found
            .iter_mut()
            .for_each(|closure| closure.tighten_loss(config.loop_closure.cauchy_sigma));
        let near = bundle_adjustment::optimize(config, &mut window, &found, robust, &mut progress);
        bundle_adjustment::filter_landmarks(config, &mut window);
        let last = bundle_adjustment::optimize(config, &mut window, &found, cleaned, &mut progress);
        let covariances = bundle_adjustment::covariances(config.max_covariances, &window, &found);
        let poses = window.frames.iter().zip(&covariances.poses);
        MappingResult {
            poses: poses
                .map(|(frame, covariance)| {
                    let world_from_rig = frame.state.world_from_rig(&self.body_from_rig);
                    let mut covariance = in_rig_frame(
                        &self.config.backend.covariance,
                        &frame.state,
                        &self.body_from_rig,
                        covariance,
                    );
                    if self.imus.is_none() {
                        covariance +=
                            tilt_uncertainty(&self.config.backend.covariance, &world_from_rig);
                    }
                    RefinedPose {
                        number: frame.number,
                        time_ns: frame.state.time_ns,
                        world_from_rig,
                        covariance,
                    }
                })
                .collect(),
            loop_closures: found.iter().map(loop_closure::Closure::report).collect(),
            iterations: far.iterations + near.iterations + last.iterations,
            is_converged: last.is_converged,
            landmarks: window.landmarks.len(),
            extrinsics: self.refined_extrinsics(&window, &covariances.extrinsics),
            stereo: RefinedStereo::of(
                self.config.backend.covariance.sigma_inflation,
                &window,
                &covariances.stereo,
            ),
        }
    }

    fn refined_extrinsics(
        &self,
        window: &Window,
        covariances: &[Matrix6<f64>],
    ) -> Vec<RefinedExtrinsics> {
        let rig_from_body = self.body_from_rig.inverse();
        let each = self.extrinsics.iter().zip(&window.cameras).zip(covariances);
        each.map(|((prior, camera), covariance)| {
            let initial_error = prior.error(camera);
            let sigmas = prior.sigmas();
            let exceeds = |k: usize| initial_error[k].abs() > 3.0 * sigmas[k];
            let rotation_components = 3..POSE_DIM;
            let (rotation, arm) = &camera.body_from_left;
            let rotation = UnitQuaternion::from_matrix(rotation);
            let body_from_left = RigidTransform::from_wxyz(
                [rotation.w, rotation.i, rotation.j, rotation.k],
                (*arm).into(),
            )
            .expect("extrinsics are finite, since steps that are not finite are rejected");
            RefinedExtrinsics {
                rig_from_left: rig_from_body * body_from_left,
                covariance: prior
                    .inflate(self.config.backend.covariance.sigma_inflation, covariance),
                initial_error: [
                    initial_error.fixed_rows::<3>(0).norm(),
                    initial_error.fixed_rows::<3>(3).norm(),
                ],
                is_moved: rotation_components.into_iter().any(exceeds),
            }
        })
        .collect()
    }

    /// A window of all keyframes.
    fn window(&self, first: &State) -> Window {
        let mut sigmas = initial_sigmas(&self.config.estimator.initialization, self.imus.is_some());
        let is_levelled = self.motions.iter().flatten().any(|m| m.has_gravity);
        if self.imus.is_some() && !is_levelled {
            sigmas[ROTATION..ROTATION + 3]
                .fill(self.config.estimator.initialization.unknown_tilt_sigma_rad);
        }
        let mut prior = Prior::of(self.keyframes[0].number, *first, &sigmas);
        let up = first.rotation.inverse() * nalgebra::Vector3::z();
        let mut view = prior.information.fixed_view_mut::<3, 3>(ROTATION, ROTATION);
        view += up * up.transpose() * 1e8;
        let mut frames = Vec::with_capacity(self.keyframes.len());
        let mut observations: BTreeMap<u64, Vec<(u64, BearingObservation)>> = BTreeMap::new();
        for (keyframe, motion) in self.keyframes.iter().zip(&self.motions) {
            frames.push(Frame {
                number: keyframe.number,
                state: (&keyframe.state).into(),
                motion: motion.clone(),
            });
            for observation in &keyframe.observations {
                let index = usize::from(observation.camera);
                let camera = &self.cameras[index];
                let Some(left) = camera.bearing(Side::Left, observation.left) else {
                    continue;
                };
                let right = observation
                    .right
                    .and_then(|at| camera.bearing(Side::Right, at));
                let bearing = BearingObservation {
                    camera: index,
                    left,
                    right,
                    exposure_offset_s: keyframe.exposure_offset_s[index]
                        + camera.row_after_s(Side::Left, observation.left[1]),
                };
                observations
                    .entry(observation.id)
                    .or_default()
                    .push((keyframe.number, bearing));
            }
        }
        let numbers: Vec<u64> = self.keyframes.iter().map(|k| k.number).collect();
        let mut continued: BTreeMap<u64, usize> = BTreeMap::new();
        for (number, _) in observations.values().flat_map(|of| of.iter().skip(1)) {
            *continued.entry(*number).or_default() += 1;
        }
        for (number, observation) in observations
            .values_mut()
            .flat_map(|of| of.iter_mut().skip(1))
        {
            let count = continued[number];
            let times = sigma_ratio(&self.config.estimator, count, self.cameras.len());
            *observation = observation.widened(times);
        }
        // The prior is about the nominal calibration, the start is the last causal estimate.
        let inflation = self.config.backend.covariance.sigma_inflation;
        let gyro_scale = GyroScale::prior_information(inflation);
        let prior = prior
            .with_calibrations(&self.cameras, &self.calibration_information)
            .with_gyro_scale(Vector3::zeros(), gyro_scale);
        let mut cameras = self.cameras.clone();
        if let Some(last) = self.keyframes.last() {
            for (camera, error) in cameras.iter_mut().zip(&last.stereo_errors) {
                stereo::apply_error(camera, &(*error).into());
            }
            for (camera, error) in cameras.iter_mut().zip(&last.extrinsics_errors) {
                extrinsics::apply_error(&mut camera.body_from_left, &(*error).into());
            }
        }
        let mut landmarks = BTreeMap::new();
        for (id, mut observations) in observations {
            // The first stereo observation is the host; earlier observations are dropped.
            let Some(host) = observations.iter().position(|(_, s)| s.right.is_some()) else {
                continue;
            };
            observations.drain(..host);
            if observations.len() < self.config.mapping.min_observations {
                continue;
            }
            widen(&mut observations, &numbers);
            let observation = &observations[0].1;
            let Some(right) = &observation.right else {
                continue;
            };
            let (rho, _) = cameras[observation.camera].triangulate(&observation.left, right);
            let landmark = Landmark {
                rho: rho.max(MIN_INVERSE_RANGE_PER_M),
                observations,
            };
            landmarks.insert(id, landmark);
        }
        Window {
            cameras,
            frames,
            landmarks,
            prior,
            config: self.config.backend,
        }
    }
}

/// Increases the sigma of later observations: a tracked feature drifts from its start, and its
/// variance grows by that of one observation per keyframe.
fn widen(observations: &mut [(u64, BearingObservation)], keyframes: &[u64]) {
    let index = |number: u64| keyframes.partition_point(|k| *k < number);
    let host = index(observations[0].0);
    for (number, observation) in observations {
        let age = index(*number) - host;
        *observation = observation.widened((1.0 + age as f64).sqrt());
    }
}

#[cfg(test)]
mod tests;
