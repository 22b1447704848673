//! Nonlinear least squares solver of a window, with elimination of landmarks.
//!
//! Levenberg–Marquardt on manifolds. A landmark has one parameter, its inverse range, which is
//! eliminated immediately after linearization (Schur complement). Observations have a Huber loss.
//! Landmarks are accumulated in pieces of a fixed size, sequentially within a piece and pieces in
//! order, so that sums are the same on any number of threads.

use nalgebra::{DMatrix, DVector, SMatrix, SVector, Vector2, Vector3};
use rayon::prelude::*;

use crate::backend::covariance::NewestCovariance;
use crate::backend::extrinsics::{self, jacobians_by_extrinsics};
use crate::backend::gyro_scale::{Border, BorderedStep};
use crate::backend::motion_factor;
use crate::backend::observation::{
    BearingMeasurement, BearingObservation, Camera, CameraPose, transfer,
};
use crate::backend::state::{Error, POSE_DIM, STATE_DIM};
use crate::backend::stereo::{self, STEREO_DIM, StereoVector};
use crate::backend::window::{Landmark, Window, compact_row};
use crate::config::BackendConfig;

/// Number of landmarks per piece.
const LANDMARKS_PER_PIECE: usize = 48;
/// Minimum inverse range, 1/m: more distant points are treated as infinitely far.
pub(crate) const MIN_INVERSE_RANGE_PER_M: f64 = 1e-4;

pub(crate) type PoseVector = SVector<f64, POSE_DIM>;
pub(crate) type PoseMatrix = SMatrix<f64, POSE_DIM, POSE_DIM>;
pub(super) type ByPose = SMatrix<f64, 2, POSE_DIM>;
type ByStereo = SMatrix<f64, 2, STEREO_DIM>;

/// Linearized problem: information matrix and gradient of all frames, landmarks eliminated.
pub(crate) struct LinearSystem {
    pub(crate) information: DMatrix<f64>,
    pub(crate) gradient: DVector<f64>,
    /// Columns of the scale errors of the gyroscope.
    pub(crate) gyro_scale: Border,
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
    /// Coupling to stereo calibrations.
    by_stereo: Vec<(usize, StereoVector)>,
}

/// Adds to the coupling to a block.
fn add_coupling<const N: usize>(
    couplings: &mut Vec<(usize, SVector<f64, N>)>,
    block: usize,
    by: &SVector<f64, N>,
) {
    match couplings.iter_mut().find(|(b, _)| *b == block) {
        Some((_, sum)) => *sum += by,
        None => couplings.push((block, *by)),
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
/// extrinsics and of stereo calibrations.
pub(crate) trait NormalEquations {
    /// Adds a block of the information matrix, on or above the diagonal.
    fn add<const R: usize, const C: usize>(
        &mut self,
        row: usize,
        column: usize,
        block: &SMatrix<f64, R, C>,
    );
    /// Adds to the gradient of a block.
    fn add_gradient<const R: usize>(&mut self, row: usize, rows: &SVector<f64, R>);
}

/// Dense normal equations, for few frames that observe mostly the same landmarks.
struct Dense {
    /// Number of blocks before those of stereo calibrations.
    poses: usize,
    information: DMatrix<f64>,
    gradient: DVector<f64>,
}

impl NormalEquations for Dense {
    fn add<const R: usize, const C: usize>(
        &mut self,
        row: usize,
        column: usize,
        block: &SMatrix<f64, R, C>,
    ) {
        let at = [row, column].map(|block| compact_row(self.poses, block));
        let mut view = (self.information).fixed_view_mut::<R, C>(at[0], at[1]);
        view += block;
    }

    fn add_gradient<const R: usize>(&mut self, row: usize, rows: &SVector<f64, R>) {
        let at = compact_row(self.poses, row);
        let mut view = self.gradient.fixed_rows_mut::<R>(at);
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
    pub(super) by_rho: Vector2<f64>,
    /// By the error of the stereo calibration; zero in the left image.
    pub(super) by_stereo: ByStereo,
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
            by_stereo: ByStereo::zeros(),
            weight: weight / (observation_sigma_px * observation_sigma_px),
            cost,
        }
    };
    let saturated = |bearing: &BearingMeasurement| Residual {
        residual: Vector2::zeros(),
        by_x: SMatrix::zeros(),
        by_rho: Vector2::zeros(),
        by_stereo: ByStereo::zeros(),
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
        let point = camera.in_right(x, rho);
        let right = camera.stereo.compensate_lens_error(right);
        // The decentering changes Jacobians by less than a hundredth.
        let Some((residual, by)) = right.residual(&point) else {
            return saturated(&right);
        };
        let by_left = by * rotation;
        Residual {
            by_stereo: by * camera.stereo.jacobian(&right, &point, origin, rho),
            ..weigh(residual, by_left, by_left * by_rho + by * origin)
        }
    });
    [left, right]
}

/// Rows of both residuals of an observation: two of the left image, two of the right one.
const ROWS: usize = 4;
type ByBlock = SMatrix<f64, ROWS, POSE_DIM>;

/// Maximum number of blocks that an observation depends on, besides the stereo calibration of the
/// target: poses of host and target, extrinsics of both cameras.
const MAX_BLOCKS: usize = 4;

/// Linearized residuals of one observation.
struct ObservationTerms {
    residual: SVector<f64, ROWS>,
    weight: SVector<f64, ROWS>,
    by_rho: SVector<f64, ROWS>,
    by_x: SMatrix<f64, ROWS, 3>,
    by_stereo: SMatrix<f64, ROWS, STEREO_DIM>,
    /// Block of the stereo calibration, if the observation depends on it.
    stereo: Option<usize>,
    cost: f64,
    /// Blocks with their Jacobians, the first `count` of them.
    blocks: [(usize, ByBlock); MAX_BLOCKS],
    count: usize,
}

impl ObservationTerms {
    fn new(found: [Option<Residual>; 2]) -> Self {
        let mut terms = Self {
            residual: SVector::zeros(),
            weight: SVector::zeros(),
            by_rho: SVector::zeros(),
            by_x: SMatrix::zeros(),
            by_stereo: SMatrix::zeros(),
            stereo: None,
            cost: 0.0,
            blocks: [(0, ByBlock::zeros()); MAX_BLOCKS],
            count: 0,
        };
        for (row, found) in [0, 2].into_iter().zip(found) {
            let Some(found) = found else { continue };
            (terms.residual.fixed_rows_mut::<2>(row)).copy_from(&found.residual);
            terms.weight.fixed_rows_mut::<2>(row).fill(found.weight);
            (terms.by_rho.fixed_rows_mut::<2>(row)).copy_from(&found.by_rho);
            (terms.by_x.fixed_rows_mut::<2>(row)).copy_from(&found.by_x);
            (terms.by_stereo.fixed_rows_mut::<2>(row)).copy_from(&found.by_stereo);
            terms.cost += found.cost;
        }
        terms
    }

    /// Adds the Jacobian by a block.
    fn push(&mut self, block: usize, by: ByBlock) {
        let earlier = self.blocks[..self.count].iter_mut();
        match earlier.into_iter().find(|(b, _)| *b == block) {
            Some((_, sum)) => *sum += by,
            None => {
                self.blocks[self.count] = (block, by);
                self.count += 1;
            }
        }
    }

    /// Adds its terms to the sums, and those of the inverse range to the landmark.
    fn add_to(&self, sums: &mut impl NormalEquations, own: &mut LandmarkBlock) {
        let weighted_rho = self.by_rho.component_mul(&self.weight);
        own.information += weighted_rho.dot(&self.by_rho);
        own.gradient += weighted_rho.dot(&self.residual);
        let blocks = &self.blocks[..self.count];
        for (k, (a, by_a)) in blocks.iter().enumerate() {
            let weighted = self.weighted(by_a);
            sums.add_gradient(*a, &(weighted * self.residual));
            add_coupling(&mut own.by, *a, &(weighted * self.by_rho));
            for (b, by_b) in &blocks[k..] {
                let block = weighted * by_b;
                // Only the upper triangle is stored.
                if a <= b {
                    sums.add(*a, *b, &block);
                } else {
                    sums.add(*b, *a, &block.transpose());
                }
            }
            if let Some(stereo) = self.stereo {
                sums.add(*a, stereo, &(weighted * self.by_stereo));
            }
        }
        if let Some(stereo) = self.stereo {
            let weighted = self.weighted(&self.by_stereo);
            sums.add_gradient(stereo, &(weighted * self.residual));
            add_coupling(&mut own.by_stereo, stereo, &(weighted * self.by_rho));
            sums.add(stereo, stereo, &(weighted * self.by_stereo));
        }
    }

    /// Transpose of a Jacobian, times the weights.
    fn weighted<const N: usize>(&self, by: &SMatrix<f64, ROWS, N>) -> SMatrix<f64, N, ROWS> {
        let mut weighted = *by;
        for mut column in weighted.column_iter_mut() {
            column.component_mul_assign(&self.weight);
        }
        weighted.transpose()
    }
}

/// Host of a landmark: its frame in the window, camera and pose.
struct Host<'a> {
    frame: usize,
    observation: &'a BearingObservation,
    camera: &'a Camera,
    pose: CameraPose,
}

/// Terms of an observation in a frame of the window; that of the host has a residual in its right
/// image only.
fn observation_terms(
    window: &Window,
    host: &Host<'_>,
    rho: f64,
    (frame, observation): (usize, &BearingObservation),
    is_host: bool,
) -> ObservationTerms {
    let camera = &window.cameras[observation.camera];
    let config = &window.config;
    let ray = &host.observation.left.ray;
    let mut terms = if is_host {
        let zero = Vector3::zeros();
        ObservationTerms::new(residuals(
            camera,
            observation,
            ray,
            &zero,
            rho,
            true,
            config,
        ))
    } else {
        let pose = CameraPose::new(&window.frames[frame].state, observation.exposure_offset_s);
        let to = (camera, &pose);
        let point = transfer(ray, rho, (host.camera, &host.pose), to);
        let (x, by_rho) = (&point.x, &point.by_rho);
        let found = residuals(camera, observation, x, by_rho, rho, false, config);
        let mut terms = ObservationTerms::new(found);
        // Jacobians of the point by the two poses.
        let by_position = point.left_from_world * rho;
        let host_rotation = -(point.left_from_world * host.pose.rotation)
            * point.in_host.cross_matrix()
            * host.pose.then_from_state;
        let target_rotation = camera.body_from_left.0.transpose()
            * point.in_target.cross_matrix()
            * pose.then_from_state;
        for (frame, by_position, by_rotation) in [
            (host.frame, by_position, host_rotation),
            (frame, -by_position, target_rotation),
        ] {
            let mut by = SMatrix::<f64, 3, POSE_DIM>::zeros();
            by.fixed_columns_mut::<3>(0).copy_from(&by_position);
            by.fixed_columns_mut::<3>(3).copy_from(&by_rotation);
            terms.push(frame, terms.by_x * by);
        }
        if !window.extrinsics.is_empty() {
            let now_from_then =
                point.left_from_world * host.pose.rotation * host.camera.body_from_left.0;
            let [own, other] = jacobians_by_extrinsics(ray, rho, &now_from_then, x);
            terms.push(
                window.extrinsics_block(host.observation.camera),
                terms.by_x * own,
            );
            terms.push(
                window.extrinsics_block(observation.camera),
                terms.by_x * other,
            );
        }
        terms
    };
    if window.estimates_stereo() && observation.right.is_some() {
        terms.stereo = Some(window.stereo_block(observation.camera));
    }
    terms
}

/// Adds the terms of one landmark to the sums; blocks are in the order of [`Window::blocks`].
fn add(window: &Window, landmark: &Landmark, sums: &mut impl NormalEquations) -> Part {
    let mut part = Part {
        own: LandmarkBlock::default(),
        cost: 0.0,
    };
    let (host_number, observation) = &landmark.observations[0];
    let Some(frame) = window.position(*host_number) else {
        return part;
    };
    let host = Host {
        frame,
        observation,
        camera: &window.cameras[observation.camera],
        pose: CameraPose::new(&window.frames[frame].state, observation.exposure_offset_s),
    };
    for (k, (number, observation)) in landmark.observations.iter().enumerate() {
        let Some(frame) = window.position(*number) else {
            continue;
        };
        let target = (frame, observation);
        let terms = observation_terms(window, &host, landmark.rho, target, k == 0);
        part.cost += terms.cost;
        terms.add_to(sums, &mut part.own);
    }
    part.own.by.sort_by_key(|(block, _)| *block);
    part.own.by_stereo.sort_by_key(|(block, _)| *block);
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
                for (b, by_b) in &own.by_stereo {
                    accumulate.sums.add(*a, *b, &-(scaled * by_b.transpose()));
                }
                accumulate.sums.add_gradient(*a, &(-scaled * own.gradient));
            }
            for (i, (a, by_a)) in own.by_stereo.iter().enumerate() {
                let scaled = by_a * inverse;
                for (b, by_b) in &own.by_stereo[i..] {
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
    let blocks = window.blocks();
    let size = window.row_of(blocks);
    let mut information = DMatrix::zeros(size, size);
    let mut gradient = DVector::zeros(size);
    let mut gyro_scale = Border::zeros(size);
    let mut cost = 0.0;
    let mut landmark_blocks = Vec::with_capacity(landmarks.len());
    let compact_size = window.compact_row_of(blocks);
    let empty = || Dense {
        poses: window.stereo_block(0),
        information: DMatrix::zeros(compact_size, compact_size),
        gradient: DVector::zeros(compact_size),
    };
    let pieces: Vec<Accumulated<Dense>> = landmarks
        .par_chunks(LANDMARKS_PER_PIECE)
        .map(|landmarks| accumulate(window, landmarks, damping, empty()))
        .collect();
    let mut compact = empty();
    for accumulate in pieces {
        compact.information += accumulate.sums.information;
        compact.gradient += accumulate.sums.gradient;
        cost += accumulate.cost;
        landmark_blocks.extend(accumulate.landmark_blocks);
    }
    // Rows of poses among those of full states.
    let rows: Vec<usize> = (0..blocks)
        .flat_map(|block| (0..window.compact_rows(block)).map(move |k| window.row_of(block) + k))
        .collect();
    for (i, row) in rows.iter().enumerate() {
        gradient[*row] = compact.gradient[i];
        for (j, column) in rows.iter().enumerate().skip(i) {
            let value = compact.information[(i, j)];
            information[(*row, *column)] = value;
            information[(*column, *row)] = value;
        }
    }
    for k in (1..window.frames.len()).filter(|k| keep(*k)) {
        let Some(motion) = &window.frames[k].motion else {
            continue;
        };
        let [from, to] = [k - 1, k].map(|k| &window.frames[k].state);
        let term = motion_factor::linearize(motion, from, to, &window.prior.gyro_scale.error);
        cost += term.cost;
        let at = (k - 1) * STATE_DIM;
        let mut view = information.view_mut((at, at), (2 * STATE_DIM, 2 * STATE_DIM));
        view += term.information;
        let mut rows = gradient.rows_mut(at, 2 * STATE_DIM);
        rows += term.gradient;
        gyro_scale.add(
            at,
            &term.by_gyro_scale,
            &term.gyro_scale_information,
            &term.gyro_scale_gradient,
        );
    }
    let mut linear = LinearSystem {
        information,
        gradient,
        gyro_scale,
        cost,
        landmark_blocks,
    };
    add_prior(window, &mut linear);
    linear
}

/// Errors of the prior relative to its linearization point.
pub(crate) fn prior_error(window: &Window) -> DVector<f64> {
    let prior = &window.prior;
    let mut error = DVector::zeros(prior.gradient.len());
    for (k, (number, at)) in prior.at.iter().enumerate() {
        if let Some(frame) = window.position(*number) {
            let residual: Error = window.frames[frame].state.minus(at);
            error
                .fixed_rows_mut::<STATE_DIM>(k * STATE_DIM)
                .copy_from(&residual);
        }
    }
    let frames = prior.at.len() * STATE_DIM;
    for (k, (at, camera)) in prior.stereo.iter().zip(&window.cameras).enumerate() {
        error
            .fixed_rows_mut::<STEREO_DIM>(frames + k * STEREO_DIM)
            .copy_from(&(camera.stereo.error - at));
    }
    error
}

pub(crate) fn prior_cost(window: &Window, error: &DVector<f64>) -> f64 {
    let prior = &window.prior;
    let (scale, deviation) = (&prior.gyro_scale.border, prior.gyro_scale.deviation());
    let states = error.dot(&(&prior.information * error + &prior.gradient * 2.0));
    let coupled = (scale.by.transpose() * error).dot(&deviation) * 2.0;
    states + coupled + deviation.dot(&(scale.information * deviation + scale.gradient * 2.0))
}

/// Gradient of the prior at these errors: of its rows, and of the scale errors of the gyroscope.
pub(crate) fn prior_gradient(
    window: &Window,
    error: &DVector<f64>,
) -> (DVector<f64>, Vector3<f64>) {
    let prior = &window.prior;
    let (scale, deviation) = (&prior.gyro_scale.border, prior.gyro_scale.deviation());
    let rows = &prior.information * error + &scale.by * deviation + &prior.gradient;
    let coupled = scale.by.transpose() * error;
    let own = coupled + scale.information * deviation + scale.gradient;
    (rows, own)
}

fn add_prior(window: &Window, linear: &mut LinearSystem) {
    let prior = &window.prior;
    let error = prior_error(window);
    let (moved, scale_gradient) = prior_gradient(window, &error);
    let scale = &prior.gyro_scale.border;
    linear.gyro_scale.gradient += scale_gradient;
    linear.gyro_scale.information += scale.information;
    let segments = window.prior_segments();
    for a in &segments {
        let mut rows = linear.gradient.rows_mut(a.row, a.count);
        rows += moved.rows(a.at, a.count);
        let mut rows = linear.gyro_scale.by.rows_mut(a.row, a.count);
        rows += scale.by.rows(a.at, a.count);
        for b in &segments {
            let block = prior.information.view((a.at, b.at), (a.count, b.count));
            let mut view = (linear.information).view_mut((a.row, b.row), (a.count, b.count));
            view += block;
        }
    }
    linear.cost += prior_cost(window, &error);
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
            let scale = &window.prior.gyro_scale.error;
            sum += motion_factor::cost(motion, &pair[0].state, &pair[1].state, scale);
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
            let x = camera.in_right(&x, landmark.rho);
            let right = camera.stereo.compensate_lens_error(right);
            found(k, 1, right.squared_residual(&x) * scale);
        }
    }
}

/// Damping up to which a linear system gives the covariance.
const MAX_COVARIANCE_DAMPING: f64 = 1e-4;

/// Result of an optimization.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Solved {
    /// Number of iterations.
    pub(crate) rounds: usize,
    /// Cost before and after, in standard deviations squared.
    pub(crate) cost: [f64; 2],
}

/// Optimizes a window in at most `rounds` iterations. Also returns the covariance of the error of
/// the newest state and the stereo calibrations, if it exists.
pub(crate) fn optimize_window(
    window: &mut Window,
    rounds: usize,
) -> (Solved, Option<NewestCovariance>) {
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
        let solve = |right: &DMatrix<f64>| cholesky.solve(right);
        let bordered = linear.gyro_scale.solve(&linear.gradient, solve);
        let Some(BorderedStep {
            step, scale_step, ..
        }) = bordered.filter(|b| b.step.iter().all(|v| v.is_finite()))
        else {
            break;
        };
        latest = Some((linear.information, linear.gyro_scale, damping));
        let mut moved = window.clone();
        moved.prior.gyro_scale.error += scale_step;
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
    let covariance = latest.and_then(|(information, gyro_scale, damping)| {
        // Damping adds information to landmarks, and so to what they contribute.
        let (mut information, gyro_scale): (DMatrix<f64>, Border) =
            if damping > MAX_COVARIANCE_DAMPING {
                let landmarks: Vec<&Landmark> = window.landmarks.values().collect();
                let linear = linearize(window, &landmarks, |_| true, 0.0);
                (linear.information, linear.gyro_scale)
            } else {
                (information, gyro_scale)
            };
        // What rounding requires.
        for k in 0..information.nrows() {
            information[(k, k)] *= 1.0 + 1e-12;
        }
        let corner = STATE_DIM + window.prior.stereo.len() * STEREO_DIM;
        let cholesky = information.cholesky()?;
        let rows = gyro_scale.by.nrows();
        let solve = |right: &DMatrix<f64>| cholesky.solve(right);
        let bordered = gyro_scale.solve(&DVector::zeros(rows), solve)?;
        let by_scale = bordered.by_scale.rows(rows - corner, corner);
        let joint = inverse_corner(&cholesky, corner)
            + by_scale * bordered.covariance * by_scale.transpose();
        Some(NewestCovariance {
            joint,
            gyro_scale: bordered.covariance,
        })
    });
    (solved, covariance)
}

/// Lower right block of the inverse of a decomposed matrix.
fn inverse_corner(cholesky: &nalgebra::Cholesky<f64, nalgebra::Dyn>, size: usize) -> DMatrix<f64> {
    // With `A = L Lᵀ` the lower right block of the inverse depends on that of `L` only.
    let l = cholesky.l_dirty();
    let at = l.nrows() - size;
    let inverse = (l.view((at, at), (size, size)))
        .solve_lower_triangular(&DMatrix::identity(size, size))
        .expect("the diagonal of a Cholesky factor is not zero");
    inverse.transpose() * inverse
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
    let calibrations = &rows[window.frames.len()..];
    let (extrinsics, stereo) = calibrations.split_at(window.extrinsics.len());
    for (camera, row) in window.cameras.iter_mut().zip(extrinsics) {
        extrinsics::apply_error(camera, &step.fixed_rows::<POSE_DIM>(*row).into_owned());
    }
    for (camera, row) in window.cameras.iter_mut().zip(stereo) {
        stereo::apply_error(camera, &step.fixed_rows::<STEREO_DIM>(*row).into_owned());
    }
    for (landmark, own) in window.landmarks.values_mut().zip(landmark_blocks) {
        if own.information <= 0.0 {
            continue;
        }
        let mut right = own.gradient;
        for (block, by) in &own.by {
            right += by.dot(&step.fixed_rows::<POSE_DIM>(rows[*block]));
        }
        for (block, by) in &own.by_stereo {
            right += by.dot(&step.fixed_rows::<STEREO_DIM>(rows[*block]));
        }
        landmark.rho = (landmark.rho - right / own.information).max(MIN_INVERSE_RANGE_PER_M);
    }
}

#[cfg(test)]
pub(crate) mod tests;
