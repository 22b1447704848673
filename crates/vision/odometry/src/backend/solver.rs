//! Nonlinear least squares solver of a window, with elimination of landmarks.
//!
//! Levenberg–Marquardt on manifolds. Observations have a Huber loss.
//! Landmarks are accumulated in pieces of a fixed size, sequentially within a piece and pieces in
//! order, so that sums are the same on any number of threads.

use nalgebra::{DMatrix, DVector, SMatrix, SVector, Vector3};
use rayon::prelude::*;

use crate::backend::covariance::{CALIBRATION_DIM, NewestCovariance};
use crate::backend::extrinsics;
use crate::backend::gyro_scale::{Border, BorderedStep};
use crate::backend::landmark_elimination::{
    LandmarkBlock, LandmarkSums, NormalEquations, accumulate,
};
use crate::backend::motion_factor;
use crate::backend::observation::{CameraPose, transfer};
use crate::backend::reprojection::huber;
use crate::backend::state::{Error, POSE_DIM, STATE_DIM};
use crate::backend::stereo::{self, STEREO_DIM};
use crate::backend::window::{Landmark, Window, compact_row};

/// Number of landmarks per piece.
const LANDMARKS_PER_PIECE: usize = 48;
/// Minimum inverse range, 1/m: more distant points are treated as infinitely far.
pub(crate) const MIN_INVERSE_RANGE_PER_M: f64 = 1e-4;

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
    let pieces: Vec<LandmarkSums<Dense>> = landmarks
        .par_chunks(LANDMARKS_PER_PIECE)
        .map(|landmarks| accumulate(window, landmarks, damping, empty()))
        .collect();
    let mut compact = empty();
    for piece in pieces {
        compact.information += piece.sums.information;
        compact.gradient += piece.sums.gradient;
        cost += piece.cost;
        landmark_blocks.extend(piece.landmark_blocks);
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
    for (k, (at, camera)) in prior.extrinsics.iter().zip(&window.cameras).enumerate() {
        error
            .fixed_rows_mut::<POSE_DIM>(prior.extrinsics_row(k))
            .copy_from(&extrinsics::error(at, &camera.body_from_left));
    }
    for (k, (at, camera)) in prior.stereo.iter().zip(&window.cameras).enumerate() {
        error
            .fixed_rows_mut::<STEREO_DIM>(prior.stereo_row(k))
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

/// Damping of the steps of a window, relative to the diagonal.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Damping {
    initial: f64,
    min: f64,
}

impl Damping {
    /// Landmarks determine relative poses a hundred thousand times better than the IMU does the
    /// whole window after a time without images, so that a damping of 1e-5 would hold it where it
    /// is.
    pub(crate) const SETTLED: Self = Self {
        initial: 1e-8,
        min: 1e-10,
    };
    /// Until the tilt is known: at rest nothing separates it from the accelerometer biases, and
    /// steps along both grow from frame to frame.
    pub(crate) const UNSETTLED: Self = Self {
        initial: 1e-5,
        min: 1e-7,
    };
}

/// Damping up to which a linear system gives the covariance.
const MAX_COVARIANCE_DAMPING: f64 = 1e-4;

/// Result of an optimization.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Solution {
    /// Number of iterations.
    pub(crate) rounds: usize,
    /// Cost before and after, in standard deviations squared.
    pub(crate) cost: [f64; 2],
}

/// Optimizes a window in at most `rounds` iterations. Also returns the covariance of the error of
/// the newest state and the calibrations, if it exists.
pub(crate) fn optimize_window(
    window: &mut Window,
    rounds: usize,
    bounds: Damping,
) -> (Solution, Option<NewestCovariance>) {
    let mut solved = Solution {
        rounds: 0,
        cost: [0.0; 2],
    };
    let mut damping = bounds.initial;
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
            damping = (damping * 0.1).max(bounds.min);
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
        let corner = STATE_DIM + window.prior.stereo.len() * CALIBRATION_DIM;
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
    let (extrinsics, stereo) = calibrations.split_at(window.prior.extrinsics.len());
    for (camera, row) in window.cameras.iter_mut().zip(extrinsics) {
        extrinsics::apply_error(
            &mut camera.body_from_left,
            &step.fixed_rows::<POSE_DIM>(*row).into_owned(),
        );
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
