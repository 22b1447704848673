//! Nonlinear least squares solver of a window, with elimination of landmarks.
//!
//! Levenberg–Marquardt on manifolds. A landmark has one parameter, its inverse range, which is
//! eliminated immediately after linearization (Schur complement). Observations have a Huber loss.
//! Landmarks are accumulated in pieces of a fixed size, sequentially within a piece and pieces in
//! order, so that sums are the same on any number of threads.

use nalgebra::{DMatrix, DVector, SMatrix, SVector, Vector2, Vector3};
use rayon::prelude::*;

use crate::backend::extrinsics::{apply_error, jacobians_by_extrinsics};
use crate::backend::motion_factor;
use crate::backend::observation::{
    BearingMeasurement, BearingObservation, Camera, CameraPose, transfer,
};
use crate::backend::state::{Error, POSE_DIM, STATE_DIM};
use crate::backend::window::{Landmark, Window};
use crate::config::BackendConfig;

/// Number of landmarks per piece.
const LANDMARKS_PER_PIECE: usize = 48;
/// Minimum inverse range, 1/m: more distant points are treated as infinitely far.
pub(crate) const MIN_INVERSE_RANGE_PER_M: f64 = 1e-4;

pub(crate) type PoseVector = SVector<f64, POSE_DIM>;
pub(crate) type PoseMatrix = SMatrix<f64, POSE_DIM, POSE_DIM>;
pub(super) type ByPose = SMatrix<f64, 2, POSE_DIM>;

/// Linearized problem: information matrix and gradient of all frames, landmarks eliminated.
pub(crate) struct LinearSystem {
    pub(crate) information: DMatrix<f64>,
    pub(crate) gradient: DVector<f64>,
    pub(crate) cost: f64,
    /// Blocks for the back substitution of landmark steps, in the order of the landmarks of the
    /// window.
    landmark_blocks: Vec<LandmarkBlock>,
}

/// Normal equation of one landmark.
#[derive(Clone, Debug, Default)]
pub(crate) struct LandmarkBlock {
    information: f64,
    gradient: f64,
    /// Coupling to poses of frames and extrinsics of cameras, in the order of [`Window::blocks`].
    by: Vec<(usize, PoseVector)>,
}

impl LandmarkBlock {
    fn add(&mut self, block: usize, by: &PoseVector) {
        match self.by.iter_mut().find(|(b, _)| *b == block) {
            Some((_, sum)) => *sum += by,
            None => self.by.push((block, *by)),
        }
    }
}

/// Huber weight and cost of a squared residual and a threshold in standard deviations.
#[inline]
pub(crate) fn huber(huber_sigma: f64, squared_residual: f64) -> (f64, f64) {
    if squared_residual <= huber_sigma * huber_sigma {
        (1.0, squared_residual)
    } else {
        let size = squared_residual.sqrt();
        (
            huber_sigma / size,
            2.0 * huber_sigma * size - huber_sigma * huber_sigma,
        )
    }
}

/// Accumulator of information matrix and gradient: blocks of frames, followed by blocks of
/// extrinsics.
pub(crate) trait NormalEquations {
    /// Adds a block of the information matrix, on or above the diagonal.
    fn add(&mut self, row: usize, column: usize, block: &PoseMatrix);
    /// Adds to the gradient of a block.
    fn add_gradient(&mut self, row: usize, rows: &PoseVector);
}

/// Dense normal equations, for few frames that observe mostly the same landmarks.
struct Dense {
    information: DMatrix<f64>,
    gradient: DVector<f64>,
}

impl NormalEquations for Dense {
    fn add(&mut self, row: usize, column: usize, block: &PoseMatrix) {
        let mut view = (self.information)
            .fixed_view_mut::<POSE_DIM, POSE_DIM>(row * POSE_DIM, column * POSE_DIM);
        view += block;
    }

    fn add_gradient(&mut self, row: usize, rows: &PoseVector) {
        let mut view = self.gradient.fixed_rows_mut::<POSE_DIM>(row * POSE_DIM);
        view += rows;
    }
}

/// Accumulated landmarks of one piece.
pub(crate) struct Accumulated<S> {
    pub(crate) sums: S,
    pub(crate) cost: f64,
    pub(crate) landmark_blocks: Vec<LandmarkBlock>,
}

/// Terms of one landmark, before elimination.
struct Part {
    own: LandmarkBlock,
    cost: f64,
}

/// Reprojection residual in one image, px, with its Jacobians by the point in the left frame and by
/// the inverse range, and its robust weight and cost.
pub(super) struct Residual {
    pub(super) residual: Vector2<f64>,
    pub(super) by_x: SMatrix<f64, 2, 3>,
    by_rho: Vector2<f64>,
    weight: f64,
    cost: f64,
}

/// Residuals in both images of a point in the left frame, scaled by the inverse range. The left
/// residual of a host is zero by definition and omitted. A saturated residual has a constant cost
/// and no gradient.
pub(super) fn residuals(
    camera: &Camera,
    observation: &BearingObservation,
    x: &Vector3<f64>,
    by_rho: &Vector3<f64>,
    rho: f64,
    is_host: bool,
    config: &BackendConfig,
) -> [Option<Residual>; 2] {
    let (observation_sigma_px, huber_sigma) = (config.observation_sigma_px, config.huber_sigma);
    let weigh = |residual: Vector2<f64>, by_x: SMatrix<f64, 2, 3>, by_rho: Vector2<f64>| {
        let (weight, cost) = huber(
            huber_sigma,
            residual.norm_squared() / (observation_sigma_px * observation_sigma_px),
        );
        Residual {
            residual,
            by_x,
            by_rho,
            weight: weight / (observation_sigma_px * observation_sigma_px),
            cost,
        }
    };
    let saturated = |bearing: &BearingMeasurement| Residual {
        residual: Vector2::zeros(),
        by_x: SMatrix::zeros(),
        by_rho: Vector2::zeros(),
        weight: 0.0,
        cost: huber(
            huber_sigma,
            bearing.saturated_residual() / (observation_sigma_px * observation_sigma_px),
        )
        .1,
    };
    let left = (!is_host).then(|| match observation.left.residual(x) {
        Some((residual, by)) => weigh(residual, by, by * by_rho),
        None => saturated(&observation.left),
    });
    let right = observation.right.as_ref().map(|right| {
        let (rotation, origin) = &camera.right_from_left;
        let Some((residual, by)) = right.residual(&(rotation * x + origin * rho)) else {
            return saturated(right);
        };
        let by_left = by * rotation;
        weigh(residual, by_left, by_left * by_rho + by * origin)
    });
    [left, right]
}

/// Terms of a landmark for the extrinsics of a camera.
#[derive(Default)]
struct ExtrinsicsTerms {
    own: PoseMatrix,
    gradient: PoseVector,
    by_rho: PoseVector,
    /// Coupling of the poses of host and target with the extrinsics, for one observation.
    by_host: PoseMatrix,
    by_target: PoseMatrix,
}

impl ExtrinsicsTerms {
    fn add(&mut self, r: &Residual, j: &ByPose, j_host: &ByPose, j_target: &ByPose) {
        let weighted = j * r.weight;
        self.own += weighted.transpose() * j;
        self.gradient += weighted.transpose() * r.residual;
        self.by_rho += weighted.transpose() * r.by_rho;
        self.by_host += j_host.transpose() * weighted;
        self.by_target += j_target.transpose() * weighted;
    }

    /// Adds the coupling of the extrinsics with the poses of an observation; the blocks are those
    /// of host, target and extrinsics.
    fn flush_into(
        &mut self,
        sums: &mut impl NormalEquations,
        [host, target, extrinsics]: [usize; 3],
    ) {
        sums.add(host, extrinsics, &self.by_host);
        sums.add(target, extrinsics, &self.by_target);
        self.by_host.fill(0.0);
        self.by_target.fill(0.0);
    }
}

/// Adds the terms of one landmark to the sums; blocks are in the order of the frames of the window.
fn add(window: &Window, landmark: &Landmark, sums: &mut impl NormalEquations) -> Part {
    let mut part = Part {
        own: LandmarkBlock::default(),
        cost: 0.0,
    };
    let (host_number, host) = &landmark.observations[0];
    let Some(host_frame) = window.position(*host_number) else {
        return part;
    };
    let host_camera = &window.cameras[host.camera];
    let host_pose = CameraPose::new(&window.frames[host_frame].state, host.exposure_offset_s);
    let mut by_host = PoseVector::zeros();
    let mut extrinsics = ExtrinsicsTerms::default();
    for (k, (number, observation)) in landmark.observations.iter().enumerate() {
        let camera = &window.cameras[observation.camera];
        if k == 0 {
            let rays = residuals(
                camera,
                observation,
                &host.left.ray,
                &Vector3::zeros(),
                landmark.rho,
                true,
                &window.config,
            );
            for r in rays.into_iter().flatten() {
                part.cost += r.cost;
                part.own.information += r.weight * r.by_rho.norm_squared();
                part.own.gradient += r.weight * r.by_rho.dot(&r.residual);
            }
            continue;
        }
        let Some(frame) = window.position(*number) else {
            continue;
        };
        let camera_pose =
            CameraPose::new(&window.frames[frame].state, observation.exposure_offset_s);
        let transferred = transfer(
            &host.left.ray,
            landmark.rho,
            (host_camera, &host_pose),
            (camera, &camera_pose),
        );
        let same = frame == host_frame;
        // Jacobians of the point by the two poses.
        let to_left = &transferred.left_from_world;
        let by_position = to_left * landmark.rho;
        let host_rotation = -(to_left * host_pose.rotation)
            * transferred.in_host.cross_matrix()
            * host_pose.then_from_state;
        let left_from_body = camera.body_from_left.0.transpose();
        let target_rotation =
            left_from_body * transferred.in_target.cross_matrix() * camera_pose.then_from_state;
        let mut by_target = PoseVector::zeros();
        let mut h_target = PoseMatrix::zeros();
        let mut h_host = PoseMatrix::zeros();
        let mut h_between = PoseMatrix::zeros();
        let (mut g_target, mut g_host) = (PoseVector::zeros(), PoseVector::zeros());
        let found = residuals(
            camera,
            observation,
            &transferred.x,
            &transferred.by_rho,
            landmark.rho,
            false,
            &window.config,
        );
        let by_cameras = (!window.extrinsics.is_empty()).then(|| {
            let now_from_then =
                transferred.left_from_world * host_pose.rotation * host_camera.body_from_left.0;
            jacobians_by_extrinsics(&host.left.ray, landmark.rho, &now_from_then, &transferred.x)
        });
        // Extrinsics of the other camera, and their coupling with those of the host camera.
        let is_across = observation.camera != host.camera;
        let mut other = ExtrinsicsTerms::default();
        let mut extrinsics_cross = PoseMatrix::zeros();
        for r in found.into_iter().flatten() {
            part.cost += r.cost;
            part.own.information += r.weight * r.by_rho.norm_squared();
            part.own.gradient += r.weight * r.by_rho.dot(&r.residual);
            let mut j_host = ByPose::zeros();
            let by_point = r.by_x * by_position;
            j_host.fixed_columns_mut::<3>(0).copy_from(&by_point);
            j_host
                .fixed_columns_mut::<3>(3)
                .copy_from(&(r.by_x * host_rotation));
            let mut j_target = ByPose::zeros();
            j_target.fixed_columns_mut::<3>(0).copy_from(&-by_point);
            j_target
                .fixed_columns_mut::<3>(3)
                .copy_from(&(r.by_x * target_rotation));
            match &by_cameras {
                Some([by_own, by_other]) if is_across => {
                    let (own, across) = (r.by_x * by_own, r.by_x * by_other);
                    extrinsics.add(&r, &own, &j_host, &j_target);
                    other.add(&r, &across, &j_host, &j_target);
                    extrinsics_cross += own.transpose() * across * r.weight;
                }
                Some([by_own, by_other]) => {
                    extrinsics.add(&r, &(r.by_x * (by_own + by_other)), &j_host, &j_target);
                }
                None => {}
            }
            if same {
                // Another camera in the frame of the host: both poses are the same.
                j_host += j_target;
                let weighted = j_host.transpose() * r.weight;
                h_host += weighted * j_host;
                g_host += weighted * r.residual;
                by_host += weighted * r.by_rho;
                continue;
            }
            let host_weighted = j_host.transpose() * r.weight;
            let target_weighted = j_target.transpose() * r.weight;
            h_host += host_weighted * j_host;
            h_target += target_weighted * j_target;
            h_between += host_weighted * j_target;
            g_host += host_weighted * r.residual;
            g_target += target_weighted * r.residual;
            by_host += host_weighted * r.by_rho;
            by_target += target_weighted * r.by_rho;
        }
        let (h, t) = (host_frame, frame);
        if by_cameras.is_some() {
            let block = window.frames.len() + host.camera;
            extrinsics.flush_into(sums, [h, t, block]);
            if is_across {
                let beside = window.frames.len() + observation.camera;
                other.flush_into(sums, [h, t, beside]);
                sums.add(beside, beside, &other.own);
                sums.add_gradient(beside, &other.gradient);
                part.own.add(beside, &other.by_rho);
                if block < beside {
                    sums.add(block, beside, &extrinsics_cross);
                } else {
                    let between = extrinsics_cross.transpose();
                    sums.add(beside, block, &between);
                }
            }
        }
        sums.add(h, h, &h_host);
        sums.add_gradient(h, &g_host);
        if !same {
            sums.add(t, t, &h_target);
            // Only the upper triangle is stored.
            if h < t {
                sums.add(h, t, &h_between);
            } else {
                sums.add(t, h, &h_between.transpose());
            }
            sums.add_gradient(t, &g_target);
            part.own.add(frame, &by_target);
        }
    }
    part.own.add(host_frame, &by_host);
    if !window.extrinsics.is_empty() {
        let block = window.frames.len() + host.camera;
        sums.add(block, block, &extrinsics.own);
        sums.add_gradient(block, &extrinsics.gradient);
        part.own.add(block, &extrinsics.by_rho);
    }
    part.own.by.sort_by_key(|(frame, _)| *frame);
    part
}

/// Accumulates landmarks sequentially, and eliminates them with this damping.
pub(crate) fn accumulate<S: NormalEquations>(
    window: &Window,
    landmarks: &[&Landmark],
    damping: f64,
    empty: S,
) -> Accumulated<S> {
    let mut accumulate = Accumulated {
        sums: empty,
        cost: 0.0,
        landmark_blocks: Vec::with_capacity(landmarks.len()),
    };
    for landmark in landmarks {
        let part = add(window, landmark, &mut accumulate.sums);
        accumulate.cost += part.cost;
        let mut own = part.own;
        own.information *= 1.0 + damping;
        if own.information > 0.0 {
            let inverse = 1.0 / own.information;
            for (i, (a, by_a)) in own.by.iter().enumerate() {
                let scaled = by_a * inverse;
                for (b, by_b) in &own.by[i..] {
                    accumulate.sums.add(*a, *b, &-(scaled * by_b.transpose()));
                }
                accumulate.sums.add_gradient(*a, &(-scaled * own.gradient));
            }
        }
        accumulate.landmark_blocks.push(own);
    }
    accumulate
}

/// Linearizes the given landmarks, all motion factors or those selected by `keep` (by the index of
/// their later frame), and the prior. Pose blocks are accumulated in the upper triangle only and
/// mirrored before the return.
pub(crate) fn linearize(
    window: &Window,
    landmarks: &[&Landmark],
    keep: impl Fn(usize) -> bool,
    damping: f64,
) -> LinearSystem {
    let size = window.frames.len() * STATE_DIM;
    let mut information = DMatrix::zeros(size, size);
    let mut gradient = DVector::zeros(size);
    let mut cost = 0.0;
    let mut landmark_blocks = Vec::with_capacity(landmarks.len());
    let poses = window.frames.len() * POSE_DIM;
    let empty = || Dense {
        information: DMatrix::zeros(poses, poses),
        gradient: DVector::zeros(poses),
    };
    let pieces: Vec<Accumulated<Dense>> = landmarks
        .par_chunks(LANDMARKS_PER_PIECE)
        .map(|landmarks| accumulate(window, landmarks, damping, empty()))
        .collect();
    for accumulate in pieces {
        for a in 0..window.frames.len() {
            for b in a..window.frames.len() {
                let block = (accumulate.sums.information)
                    .fixed_view::<POSE_DIM, POSE_DIM>(a * POSE_DIM, b * POSE_DIM);
                let mut view =
                    information.fixed_view_mut::<POSE_DIM, POSE_DIM>(a * STATE_DIM, b * STATE_DIM);
                view += block;
            }
            let rows = accumulate
                .sums
                .gradient
                .fixed_rows::<POSE_DIM>(a * POSE_DIM);
            let mut view = gradient.fixed_rows_mut::<POSE_DIM>(a * STATE_DIM);
            view += rows;
        }
        cost += accumulate.cost;
        landmark_blocks.extend(accumulate.landmark_blocks);
    }
    for a in 0..window.frames.len() {
        let block = information
            .fixed_view::<POSE_DIM, POSE_DIM>(a * STATE_DIM, a * STATE_DIM)
            .into_owned();
        // Diagonal blocks of pieces are complete where they were added directly, and upper
        // triangular where landmarks were eliminated; both are symmetric by construction.
        let mut view =
            information.fixed_view_mut::<POSE_DIM, POSE_DIM>(a * STATE_DIM, a * STATE_DIM);
        view.copy_from(&((block + block.transpose()) * 0.5));
        for b in a + 1..window.frames.len() {
            let block = information
                .fixed_view::<POSE_DIM, POSE_DIM>(a * STATE_DIM, b * STATE_DIM)
                .transpose();
            let mut view =
                information.fixed_view_mut::<POSE_DIM, POSE_DIM>(b * STATE_DIM, a * STATE_DIM);
            view.copy_from(&block);
        }
    }
    for k in (1..window.frames.len()).filter(|k| keep(*k)) {
        let Some(motion) = &window.frames[k].motion else {
            continue;
        };
        let term =
            motion_factor::linearize(motion, &window.frames[k - 1].state, &window.frames[k].state);
        cost += term.cost;
        let at = (k - 1) * STATE_DIM;
        let mut view = information.view_mut((at, at), (2 * STATE_DIM, 2 * STATE_DIM));
        view += term.information;
        let mut rows = gradient.rows_mut(at, 2 * STATE_DIM);
        rows += term.gradient;
    }
    cost += add_prior(window, &mut information, &mut gradient);
    LinearSystem {
        information,
        gradient,
        cost,
        landmark_blocks,
    }
}

/// Errors of the frames of the prior relative to its linearization point.
pub(crate) fn prior_error(window: &Window) -> DVector<f64> {
    let mut error = DVector::zeros(window.prior.at.len() * STATE_DIM);
    for (k, (number, at)) in window.prior.at.iter().enumerate() {
        if let Some(frame) = window.position(*number) {
            let residual: Error = window.frames[frame].state.minus(at);
            error
                .fixed_rows_mut::<STATE_DIM>(k * STATE_DIM)
                .copy_from(&residual);
        }
    }
    error
}

pub(crate) fn prior_cost(window: &Window, error: &DVector<f64>) -> f64 {
    let prior = &window.prior;
    (error.transpose() * (&prior.information * error + &prior.gradient * 2.0))[0]
}

fn add_prior(window: &Window, information: &mut DMatrix<f64>, gradient: &mut DVector<f64>) -> f64 {
    let prior = &window.prior;
    let error = prior_error(window);
    let moved = &prior.information * &error + &prior.gradient;
    let places: Vec<Option<usize>> = prior.at.iter().map(|(n, _)| window.position(*n)).collect();
    for (a, frame_a) in places.iter().enumerate() {
        let Some(frame_a) = frame_a else { continue };
        let mut rows = gradient.fixed_rows_mut::<STATE_DIM>(frame_a * STATE_DIM);
        rows += moved.fixed_rows::<STATE_DIM>(a * STATE_DIM);
        for (b, frame_b) in places.iter().enumerate() {
            let Some(frame_b) = frame_b else { continue };
            let block = prior
                .information
                .fixed_view::<STATE_DIM, STATE_DIM>(a * STATE_DIM, b * STATE_DIM);
            let mut view = information
                .fixed_view_mut::<STATE_DIM, STATE_DIM>(frame_a * STATE_DIM, frame_b * STATE_DIM);
            view += block;
        }
    }
    prior_cost(window, &error)
}

/// Cost without derivatives.
fn cost(window: &Window, landmarks: &[&Landmark]) -> f64 {
    let pieces: Vec<f64> = landmarks
        .par_chunks(LANDMARKS_PER_PIECE)
        .map(|landmarks| landmarks.iter().map(|l| landmark_cost(window, l)).sum())
        .collect();
    let mut sum: f64 = pieces.iter().sum();
    for pair in window.frames.windows(2) {
        if let Some(motion) = &pair[1].motion {
            sum += motion_factor::cost(motion, &pair[0].state, &pair[1].state);
        }
    }
    sum + prior_cost(window, &prior_error(window))
}

pub(crate) fn landmark_cost(window: &Window, landmark: &Landmark) -> f64 {
    let mut sum = 0.0;
    for_each_residual(window, landmark, |_, _, squared_residual| {
        sum += huber(window.config.huber_sigma, squared_residual).1
    });
    sum
}

/// Squared residuals of a landmark, in standard deviations, by index of the observation and side (0
/// left, 1 right).
pub(crate) fn for_each_residual(
    window: &Window,
    landmark: &Landmark,
    mut found: impl FnMut(usize, usize, f64),
) {
    let (host_number, host) = &landmark.observations[0];
    let Some(host_frame) = window.position(*host_number) else {
        return;
    };
    let host_camera = &window.cameras[host.camera];
    let host_pose = CameraPose::new(&window.frames[host_frame].state, host.exposure_offset_s);
    let scale = 1.0 / (window.config.observation_sigma_px * window.config.observation_sigma_px);
    for (k, (number, observation)) in landmark.observations.iter().enumerate() {
        let Some(frame) = window.position(*number) else {
            continue;
        };
        let camera = &window.cameras[observation.camera];
        let x = if k == 0 {
            host.left.ray
        } else {
            let camera_pose =
                CameraPose::new(&window.frames[frame].state, observation.exposure_offset_s);
            let to = (camera, &camera_pose);
            transfer(&host.left.ray, landmark.rho, (host_camera, &host_pose), to).x
        };
        if k > 0 {
            found(k, 0, observation.left.squared_residual(&x) * scale);
        }
        if let Some(right) = &observation.right {
            let (rotation, origin) = &camera.right_from_left;
            let x = rotation * x + origin * landmark.rho;
            found(k, 1, right.squared_residual(&x) * scale);
        }
    }
}

/// Result of an optimization.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Solved {
    /// Number of iterations.
    pub(crate) rounds: usize,
    /// Cost before and after, in standard deviations squared.
    pub(crate) cost: [f64; 2],
}

/// Optimizes a window in at most `rounds` iterations. Also returns the covariance of the error of
/// the newest state, if it exists.
pub(crate) fn optimize_window(
    window: &mut Window,
    rounds: usize,
) -> (Solved, Option<SMatrix<f64, STATE_DIM, STATE_DIM>>) {
    let mut solved = Solved {
        rounds: 0,
        cost: [0.0; 2],
    };
    let mut damping = 1e-5;
    let mut latest = None;
    let mut before: Option<f64> = None;
    for round in 0..rounds {
        let landmarks: Vec<&Landmark> = window.landmarks.values().collect();
        let linear = linearize(window, &landmarks, |_| true, damping);
        if round == 0 {
            solved.cost[0] = linear.cost;
        }
        solved.rounds += 1;
        let now = before.unwrap_or(linear.cost);
        let mut damped = linear.information.clone();
        for k in 0..damped.nrows() {
            damped[(k, k)] += damping * damped[(k, k)].max(1e-6);
        }
        let Some(cholesky) = damped.cholesky() else {
            damping = (damping * 100.0).max(1e-3);
            continue;
        };
        let step = -cholesky.solve(&linear.gradient);
        if !step.iter().all(|v| v.is_finite()) {
            break;
        }
        latest = Some(linear.information);
        let mut moved = window.clone();
        apply(&mut moved, &step, &linear.landmark_blocks);
        let landmarks: Vec<&Landmark> = moved.landmarks.values().collect();
        let after = cost(&moved, &landmarks);
        if after <= now * (1.0 + 1e-9) {
            let gained = now - after;
            *window = moved;
            before = Some(after);
            solved.cost[1] = after;
            damping = (damping * 0.1).max(1e-7);
            if gained < window.config.convergence_ratio * now.max(1.0) || step.amax() < 1e-6 {
                break;
            }
        } else {
            before = Some(now);
            solved.cost[1] = now;
            damping = (damping * 30.0).max(1e-3);
        }
    }
    // Damping would add information: it is omitted here, except for what rounding requires.
    let covariance = latest.and_then(|mut information: DMatrix<f64>| {
        for k in 0..information.nrows() {
            information[(k, k)] *= 1.0 + 1e-12;
        }
        information.cholesky().map(|c| c.inverse_corner())
    });
    (solved, covariance)
}

/// Lower right block of an inverse.
trait Corner {
    fn inverse_corner(&self) -> SMatrix<f64, STATE_DIM, STATE_DIM>;
}

impl Corner for nalgebra::Cholesky<f64, nalgebra::Dyn> {
    fn inverse_corner(&self) -> SMatrix<f64, STATE_DIM, STATE_DIM> {
        // With `A = L Lᵀ` the lower right block of the inverse depends on that of `L` only.
        let l = self.l_dirty();
        let at = l.nrows() - STATE_DIM;
        let corner = SMatrix::<f64, STATE_DIM, STATE_DIM>::from_fn(|i, j| {
            if i >= j { l[(at + i, at + j)] } else { 0.0 }
        });
        let inverse = corner
            .solve_lower_triangular(&SMatrix::<f64, STATE_DIM, STATE_DIM>::identity())
            .expect("the diagonal of a Cholesky factor is not zero");
        inverse.transpose() * inverse
    }
}

/// Applies a step to the states, and to the landmarks by back substitution.
pub(crate) fn apply<'a>(
    window: &mut Window,
    step: &DVector<f64>,
    landmark_blocks: impl IntoIterator<Item = &'a LandmarkBlock>,
) {
    let rows: Vec<usize> = (0..window.blocks()).map(|k| window.row_of(k)).collect();
    for (frame, row) in window.frames.iter_mut().zip(&rows) {
        let error: Error = step.fixed_rows::<STATE_DIM>(*row).into_owned();
        frame.state = frame.state.plus(&error);
    }
    if !window.extrinsics.is_empty() {
        let rows = &rows[window.frames.len()..];
        for (camera, row) in window.cameras.iter_mut().zip(rows) {
            apply_error(camera, &step.fixed_rows::<POSE_DIM>(*row).into_owned());
        }
    }
    for (landmark, own) in window.landmarks.values_mut().zip(landmark_blocks) {
        if own.information <= 0.0 {
            continue;
        }
        let mut right = own.gradient;
        for (block, by) in &own.by {
            right += by.dot(&step.fixed_rows::<POSE_DIM>(rows[*block]));
        }
        landmark.rho = (landmark.rho - right / own.information).max(MIN_INVERSE_RANGE_PER_M);
    }
}

#[cfg(test)]
pub(crate) mod tests;
