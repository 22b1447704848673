//! Bundle adjustment of all keyframes: sparse, landmarks eliminated, robust.
//!
//! The same terms as in a window ([`crate::backend::solver`]), accumulated into blocks of a sparse
//! matrix, and loop closures as relative-pose factors. The reduced system is solved by sparse
//! Cholesky decomposition.

use std::collections::BTreeMap;

use faer::linalg::solvers::Solve as _;
use faer::sparse::linalg::solvers::{Llt, SymbolicLlt};
use faer::sparse::{SparseColMat, Triplet};
use faer::{Mat, Side};
use nalgebra::{DMatrix, DVector, Matrix6, SMatrix, SVector};
use rayon::prelude::*;

use super::loop_closure::Closure;
use crate::backend::gyro_scale::{Border, BorderedStep};
use crate::backend::landmark_elimination::{
    LandmarkBlock, LandmarkSums, NormalEquations, accumulate,
};
use crate::backend::motion_factor;
use crate::backend::solver::{
    apply, for_each_residual, landmark_cost, prior_cost, prior_error, prior_gradient,
};
use crate::backend::state::{POSE_DIM, STATE_DIM};
use crate::backend::stereo::{STEREO_DIM, StereoMatrix, StereoVector};
use crate::backend::window::{Landmark, Window};
use crate::config::MappingConfig;

/// Number of landmarks per piece, and number of pieces that are accumulated in parallel, which
/// bounds their memory.
const LANDMARKS_PER_PIECE: usize = 1024;
const PIECES_PER_BATCH: usize = 16;

/// Progress of mapping.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Progress {
    /// An iteration of bundle adjustment was completed.
    Linearized {
        /// Number of iterations of this optimization so far.
        iterations: usize,
        /// Maximum number of iterations.
        max_iterations: usize,
    },
    /// Loop closures are being searched.
    SearchingLoops {
        /// Number of keyframes so far.
        done: usize,
        /// Number of all keyframes.
        all: usize,
    },
}

type Square = SMatrix<f64, STATE_DIM, STATE_DIM>;

/// Sparse normal equations, for many frames of which few observe the same landmarks.
#[derive(Default)]
struct Sparse {
    /// Those of poses use the first [`POSE_DIM`] components only.
    blocks: BTreeMap<(usize, usize), StereoMatrix>,
    gradient: BTreeMap<usize, StereoVector>,
}

impl NormalEquations for Sparse {
    fn add<const R: usize, const C: usize>(
        &mut self,
        row: usize,
        column: usize,
        block: &SMatrix<f64, R, C>,
    ) {
        let entry = self.blocks.entry((row, column));
        let entry = entry.or_insert_with(StereoMatrix::zeros);
        let mut view = entry.fixed_view_mut::<R, C>(0, 0);
        view += block;
    }

    fn add_gradient<const R: usize>(&mut self, row: usize, rows: &SVector<f64, R>) {
        let entry = self.gradient.entry(row);
        let entry = entry.or_insert_with(StereoVector::zeros);
        let mut view = entry.fixed_rows_mut::<R>(0);
        view += rows;
    }
}

/// Linearized problem.
struct LinearSystem {
    /// Blocks on and above the diagonal; those of calibrations use their first components only.
    blocks: BTreeMap<(usize, usize), Square>,
    gradient: DVector<f64>,
    /// Columns of the scale errors of the gyroscope.
    gyro_scale: Border,
    cost: f64,
    landmark_blocks: Vec<Vec<LandmarkBlock>>,
}

fn linearize(window: &Window, loops: &[Closure], damping: f64) -> LinearSystem {
    let landmarks: Vec<&Landmark> = window.landmarks.values().collect();
    let size = window.row_of(window.blocks());
    let scale = &window.prior.gyro_scale;
    let mut linear = LinearSystem {
        blocks: BTreeMap::new(),
        gradient: DVector::zeros(size),
        gyro_scale: Border::zeros(size),
        cost: 0.0,
        landmark_blocks: Vec::with_capacity(landmarks.len().div_ceil(LANDMARKS_PER_PIECE)),
    };
    for some in landmarks.chunks(LANDMARKS_PER_PIECE * PIECES_PER_BATCH) {
        let pieces: Vec<LandmarkSums<Sparse>> = some
            .par_chunks(LANDMARKS_PER_PIECE)
            .map(|landmarks| accumulate(window, landmarks, damping, Sparse::default()))
            .collect();
        for piece in pieces {
            for ((a, b), block) in piece.sums.blocks {
                add_block(&mut linear.blocks, a, b, &block);
            }
            for (k, rows) in piece.sums.gradient {
                let count = window.compact_rows(k);
                let mut view = linear.gradient.rows_mut(window.row_of(k), count);
                view += rows.rows(0, count);
            }
            linear.cost += piece.cost;
            linear.landmark_blocks.push(piece.landmark_blocks);
        }
    }
    for k in 1..window.frames.len() {
        let Some(motion) = &window.frames[k].motion else {
            continue;
        };
        let [from, to] = [k - 1, k].map(|k| &window.frames[k].state);
        let term = motion_factor::linearize(motion, from, to, &scale.error);
        linear.cost += term.cost;
        for (a, b, row, column) in [
            (k - 1, k - 1, 0, 0),
            (k - 1, k, 0, STATE_DIM),
            (k, k, STATE_DIM, STATE_DIM),
        ] {
            let part = term
                .information
                .fixed_view::<STATE_DIM, STATE_DIM>(row, column);
            *linear.blocks.entry((a, b)).or_insert_with(Square::zeros) += part;
        }
        let mut rows = linear.gradient.rows_mut((k - 1) * STATE_DIM, 2 * STATE_DIM);
        rows += term.gradient;
        linear.gyro_scale.add(
            (k - 1) * STATE_DIM,
            &term.by_gyro_scale,
            &term.gyro_scale_information,
            &term.gyro_scale_gradient,
        );
    }
    let error = prior_error(window);
    linear.cost += prior_cost(window, &error);
    let (gradient, scale_gradient) = prior_gradient(window, &error);
    linear.gyro_scale.gradient += scale_gradient;
    linear.gyro_scale.information += scale.border.information;
    let segments = window.prior_segments();
    for (k, a) in segments.iter().enumerate() {
        let mut rows = linear.gradient.rows_mut(a.row, a.count);
        rows += gradient.rows(a.at, a.count);
        let mut rows = linear.gyro_scale.by.rows_mut(a.row, a.count);
        rows += scale.border.by.rows(a.at, a.count);
        for b in &segments[k..] {
            let part = (window.prior.information).view((a.at, b.at), (a.count, b.count));
            let entry = linear.blocks.entry((a.block, b.block));
            let entry = entry.or_insert_with(Square::zeros);
            let mut view = entry.view_mut((0, 0), (a.count, b.count));
            view += part;
        }
    }
    for closure in loops {
        let term = closure.linearize(window);
        linear.cost += term.cost;
        let [a, b] = closure.frames;
        add_block(&mut linear.blocks, a, a, &term.own);
        add_block(&mut linear.blocks, a, b, &term.cross);
        add_block(&mut linear.blocks, b, b, &term.other);
        for (frame, rows_of_pose) in [(a, term.gradient_own), (b, term.gradient_other)] {
            let mut rows = linear
                .gradient
                .fixed_rows_mut::<POSE_DIM>(frame * STATE_DIM);
            rows += rows_of_pose;
        }
    }
    linear
}

fn add_block<const N: usize>(
    blocks: &mut BTreeMap<(usize, usize), Square>,
    a: usize,
    b: usize,
    block: &SMatrix<f64, N, N>,
) {
    let entry = blocks.entry((a, b)).or_insert_with(Square::zeros);
    let mut view = entry.fixed_view_mut::<N, N>(0, 0);
    view += block;
}

fn cost(window: &Window, loops: &[Closure]) -> f64 {
    let landmarks: Vec<&Landmark> = window.landmarks.values().collect();
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
    sum += loops.iter().map(|l| l.cost(window)).sum::<f64>();
    sum + prior_cost(window, &prior_error(window))
}

/// Sparse matrix with a damped diagonal.
fn matrix(
    linear: &LinearSystem,
    damping: f64,
    window: &Window,
) -> Option<SparseColMat<usize, f64>> {
    let mut entries = Vec::with_capacity(linear.blocks.len() * STATE_DIM * STATE_DIM);
    let numbers = |block: usize| window.row_of(block + 1) - window.row_of(block);
    for ((a, b), block) in &linear.blocks {
        for i in 0..numbers(*a) {
            // Diagonal blocks: lower half only. The sparse matrix is lower triangular, blocks are
            // upper.
            for j in 0..numbers(*b) {
                let (row, column) = (window.row_of(*b) + j, window.row_of(*a) + i);
                if row < column {
                    continue;
                }
                let mut value = block[(i, j)];
                if row == column {
                    value += damping * value.max(1e-6);
                } else if value == 0.0 {
                    continue;
                }
                entries.push(Triplet::new(row, column, value));
            }
        }
    }
    let size = linear.gradient.len();
    SparseColMat::try_new_from_triplets(size, size, &entries).ok()
}

fn factor(linear: &LinearSystem, damping: f64, window: &Window) -> Option<Llt<usize, f64>> {
    let matrix = matrix(linear, damping, window)?;
    let symbolic = SymbolicLlt::try_new(matrix.symbolic(), Side::Lower).ok()?;
    Llt::try_new_with_symbolic(symbolic, matrix.as_ref(), Side::Lower).ok()
}

/// Result of an optimization.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outcome {
    /// Number of iterations.
    pub(super) iterations: usize,
    /// Whether the optimization converged.
    pub(super) is_converged: bool,
}

/// Optimizes all states, landmarks, calibrations and scale errors of the gyroscope in at most
/// `max_iterations` iterations.
pub(super) fn optimize(
    config: &MappingConfig,
    window: &mut Window,
    loops: &[Closure],
    max_iterations: usize,
    progress: &mut impl FnMut(Progress),
) -> Outcome {
    let mut damping = 1e-6;
    let mut now = None;
    for round in 0..max_iterations {
        progress(Progress::Linearized {
            iterations: round,
            max_iterations,
        });
        let linear = linearize(window, loops, damping);
        let before = *now.get_or_insert(linear.cost);
        let Some(factor) = factor(&linear, damping, window) else {
            damping = (damping * 100.0).max(1e-4);
            continue;
        };
        let solve = |right: &DMatrix<f64>| solve(&factor, right);
        let bordered = linear.gyro_scale.solve(&linear.gradient, solve);
        let Some(BorderedStep {
            step, scale_step, ..
        }) = bordered.filter(|b| b.step.iter().all(|v| v.is_finite()))
        else {
            damping = (damping * 100.0).max(1e-4);
            continue;
        };
        let states: Vec<_> = window.frames.iter().map(|f| f.state).collect();
        let rhos: Vec<f64> = window.landmarks.values().map(|l| l.rho).collect();
        let cameras = window.cameras.clone();
        window.prior.gyro_scale.error += scale_step;
        apply(window, &step, linear.landmark_blocks.iter().flatten());
        let after = cost(window, loops);
        let is_settled = damping <= config.max_free_damping
            && (before - after).abs() < (config.convergence_ratio * before).max(1.0);
        if after <= before * (1.0 + 1e-12) {
            now = Some(after);
            damping = (damping * 0.1).max(1e-8);
        } else {
            for (frame, state) in window.frames.iter_mut().zip(states) {
                frame.state = state;
            }
            for (landmark, rho) in window.landmarks.values_mut().zip(rhos) {
                landmark.rho = rho;
            }
            window.cameras = cameras;
            window.prior.gyro_scale.error -= scale_step;
            // Small initial damping: the ends of a long path are weakly constrained, and damping
            // would fix them.
            damping *= 30.0;
        }
        if is_settled {
            return Outcome {
                iterations: round + 1,
                is_converged: true,
            };
        }
    }
    Outcome {
        iterations: max_iterations,
        is_converged: false,
    }
}

/// Removes outliers, and landmarks with too few remaining observations.
pub(super) fn filter_landmarks(config: &MappingConfig, window: &mut Window) {
    let landmarks: Vec<(&u64, &Landmark)> = window.landmarks.iter().collect();
    let bad: Vec<(u64, Vec<(usize, usize)>)> = landmarks
        .par_iter()
        .filter_map(|(id, landmark)| {
            let mut entries = Vec::new();
            for_each_residual(window, landmark, |observation, side, squared_residual| {
                if squared_residual > config.outlier_sigma * config.outlier_sigma {
                    entries.push((observation, side));
                }
            });
            (!entries.is_empty()).then_some((**id, entries))
        })
        .collect();
    for (id, entries) in bad {
        let Some(landmark) = window.landmarks.get_mut(&id) else {
            continue;
        };
        landmark.drop_observations(&entries);
        if landmark.observations.len() < config.min_observations
            || landmark.observations[0].1.right.is_none()
        {
            window.landmarks.remove(&id);
        }
    }
}

/// Covariances of the solution.
pub(super) struct Covariances {
    /// Of poses (position in the world, rotation in the body), one per keyframe.
    pub(super) poses: Vec<Matrix6<f64>>,
    /// Of extrinsics, one per camera.
    pub(super) extrinsics: Vec<Matrix6<f64>>,
    /// Of the stereo calibrations, one per camera.
    pub(super) stereo: Vec<StereoMatrix>,
}

/// Frames that neither landmarks nor an IMU connect to earlier ones: of each run without
/// connections the first and the last.
fn tracking_losses(window: &Window) -> impl Iterator<Item = usize> {
    let mut is_connected: Vec<bool> = (window.frames.iter())
        .map(|frame| frame.motion.as_ref().is_none_or(|m| m.has_gravity))
        .collect();
    for landmark in window.landmarks.values() {
        let [first, last] = [landmark.observations.first(), landmark.observations.last()]
            .map(|o| o.and_then(|(number, _)| window.position(*number)));
        if let (Some(first), Some(last)) = (first, last) {
            is_connected[first + 1..=last].fill(true);
        }
    }
    (1..is_connected.len()).filter(move |k| {
        let is_inside = !is_connected[k - 1] && is_connected.get(k + 1) == Some(&false);
        !is_connected[*k] && !is_inside
    })
}

/// Computes the covariances of the solution, those of at most about `max_count` poses exactly.
pub(super) fn covariances(max_count: usize, window: &Window, loops: &[Closure]) -> Covariances {
    let count = window.frames.len();
    let size = window.row_of(window.blocks());
    let linear = linearize(window, loops, 0.0);
    let Some(factor) = factor(&linear, 1e-9, window) else {
        // The covariance is not determined, and is set very large.
        let unknown = Matrix6::identity() * 1e6;
        return Covariances {
            poses: vec![unknown; count],
            extrinsics: vec![unknown; window.prior.extrinsics.len()],
            stereo: vec![StereoMatrix::identity() * 1e6; window.prior.stereo.len()],
        };
    };
    let solve = |right: &DMatrix<f64>| solve(&factor, right);
    let bordered = (linear.gyro_scale).solve(&DVector::zeros(size), solve);
    let bordered = bordered.as_ref();
    let of = |block| covariance_of::<POSE_DIM>(&factor, size, window.row_of(block));
    let step = count.div_ceil(max_count).max(1);
    let mut entries: Vec<usize> = (0..count).step_by(step).collect();
    entries.push(count - 1);
    // At a tracking loss covariances change suddenly.
    entries.extend(tracking_losses(window).flat_map(|k| [k - 1, k]));
    entries.sort_unstable();
    entries.dedup();
    let found: Vec<Matrix6<f64>> = entries.par_iter().map(|entry| of(*entry)).collect();
    let mut out = Vec::with_capacity(count);
    for k in 0..count {
        let next = entries.partition_point(|p| *p < k);
        if entries[next] == k {
            out.push(found[next]);
            continue;
        }
        let (a, b) = (entries[next - 1], entries[next]);
        let share = (k - a) as f64 / (b - a) as f64;
        out.push(found[next - 1] * (1.0 - share) + found[next] * share);
    }
    for (k, covariance) in out.iter_mut().enumerate() {
        *covariance += by_gyro_scale::<POSE_DIM>(bordered, window.row_of(k));
    }
    let stereo = window.stereo_block(0);
    Covariances {
        poses: out,
        extrinsics: (count..stereo)
            .map(|block| of(block) + by_gyro_scale(bordered, window.row_of(block)))
            .collect(),
        stereo: (stereo..window.blocks())
            .map(|block| {
                let row = window.row_of(block);
                covariance_of::<STEREO_DIM>(&factor, size, row) + by_gyro_scale(bordered, row)
            })
            .collect(),
    }
}

/// Covariance of the rows from `row` on that the scale errors of the gyroscope add.
fn by_gyro_scale<const N: usize>(
    bordered: Option<&BorderedStep>,
    row: usize,
) -> SMatrix<f64, N, N> {
    bordered.map_or(SMatrix::zeros(), |bordered| {
        let by = bordered.by_scale.fixed_rows::<N>(row);
        by * bordered.covariance * by.transpose()
    })
}

/// Solves with a factored matrix.
fn solve(factor: &Llt<usize, f64>, right: &DMatrix<f64>) -> DMatrix<f64> {
    let (rows, columns) = right.shape();
    let solved = factor.solve(&Mat::from_fn(rows, columns, |i, j| right[(i, j)]));
    DMatrix::from_fn(rows, columns, |i, j| solved[(i, j)])
}

/// Block of the inverse of a factored matrix of `size` rows, from the row `at` on.
fn covariance_of<const N: usize>(
    factor: &Llt<usize, f64>,
    size: usize,
    at: usize,
) -> SMatrix<f64, N, N> {
    let right = Mat::from_fn(size, N, |i, j| f64::from(u8::from(i == at + j)));
    let solved = factor.solve(&right);
    let block = SMatrix::<f64, N, N>::from_fn(|i, j| solved[(at + i, j)]);
    (block + block.transpose()) * 0.5
}
