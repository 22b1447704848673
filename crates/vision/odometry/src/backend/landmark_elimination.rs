//! Normal equations of landmarks, and their elimination.
//!
//! A landmark has one parameter, its inverse range, which is eliminated immediately after
//! linearization (Schur complement). What remains couples poses of frames, extrinsics and stereo
//! calibrations, in the order of [`Window::blocks`].

use nalgebra::{SMatrix, SVector, Vector3};

use crate::backend::extrinsics::jacobians_by_extrinsics;
use crate::backend::observation::{BearingObservation, Camera, CameraPose, transfer};
use crate::backend::reprojection::{Residual, residuals};
use crate::backend::state::POSE_DIM;
use crate::backend::stereo::{STEREO_DIM, StereoVector};
use crate::backend::window::{Landmark, Window};

pub(crate) type PoseVector = SVector<f64, POSE_DIM>;
pub(crate) type PoseMatrix = SMatrix<f64, POSE_DIM, POSE_DIM>;

/// Normal equation of one landmark.
#[derive(Clone, Debug, Default)]
pub(crate) struct LandmarkBlock {
    pub(crate) information: f64,
    pub(crate) gradient: f64,
    /// Coupling to poses of frames and extrinsics of cameras, in the order of [`Window::blocks`].
    pub(crate) by: Vec<(usize, PoseVector)>,
    /// Coupling to stereo calibrations.
    pub(crate) by_stereo: Vec<(usize, StereoVector)>,
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

/// Accumulated landmarks of one piece.
pub(crate) struct LandmarkSums<S> {
    pub(crate) sums: S,
    pub(crate) cost: f64,
    pub(crate) landmark_blocks: Vec<LandmarkBlock>,
}

/// Terms of one landmark, before elimination.
struct Part {
    own: LandmarkBlock,
    cost: f64,
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
        if window.estimates_calibrations() {
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
    if window.estimates_calibrations() && observation.right.is_some() {
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
) -> LandmarkSums<S> {
    let mut accumulated = LandmarkSums {
        sums: empty,
        cost: 0.0,
        landmark_blocks: Vec::with_capacity(landmarks.len()),
    };
    for landmark in landmarks {
        let part = add(window, landmark, &mut accumulated.sums);
        accumulated.cost += part.cost;
        let mut own = part.own;
        own.information *= 1.0 + damping;
        if own.information > 0.0 {
            let inverse = 1.0 / own.information;
            for (i, (a, by_a)) in own.by.iter().enumerate() {
                let scaled = by_a * inverse;
                for (b, by_b) in &own.by[i..] {
                    accumulated.sums.add(*a, *b, &-(scaled * by_b.transpose()));
                }
                for (b, by_b) in &own.by_stereo {
                    accumulated.sums.add(*a, *b, &-(scaled * by_b.transpose()));
                }
                accumulated.sums.add_gradient(*a, &(-scaled * own.gradient));
            }
            for (i, (a, by_a)) in own.by_stereo.iter().enumerate() {
                let scaled = by_a * inverse;
                for (b, by_b) in &own.by_stereo[i..] {
                    accumulated.sums.add(*a, *b, &-(scaled * by_b.transpose()));
                }
                accumulated.sums.add_gradient(*a, &(-scaled * own.gradient));
            }
        }
        accumulated.landmark_blocks.push(own);
    }
    accumulated
}
