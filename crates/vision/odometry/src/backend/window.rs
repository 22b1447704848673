//! The frames and landmarks that are being estimated together, and all that is known of them.
//!
//! Frames are in order of time. Between neighbours lies what the IMU felt; where it felt nothing, that a body does not leap.
//! What was known of frames that have left is in the prior.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, SMatrix};

use crate::backend::extrinsics::ExtrinsicsPrior;
use crate::backend::observation::{BearingObservation, Camera};
use crate::backend::state::{POSE_DIM, STATE_DIM, State};
use crate::inertial::imu_buffer::Preintegrated;

/// One frame.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    /// Counts all frame sets.
    pub(crate) number: u64,
    pub(crate) state: State,
    /// From the frame before it in the window; none for the first.
    pub(crate) motion: Option<MotionFactor>,
}

/// What is known of the way from one frame to the next.
#[derive(Clone, Debug)]
pub(crate) struct MotionFactor {
    pub(crate) preintegrated: Preintegrated,
    /// 1 where specific force was felt, 0 where only that bodies do not leap is known.
    pub(crate) has_gravity: bool,
    /// Densities of the biases' walks, rad/s²/√Hz and m/s³/√Hz.
    pub(crate) bias_walk: [f64; 2],
}

/// A landmark. The first of its sights is the host's.
#[derive(Clone, Debug)]
pub(crate) struct Landmark {
    /// Inverse range from the host's left eye, 1/m.
    pub(crate) rho: f64,
    /// By frame number, rising; several of one frame are of several cameras.
    pub(crate) observations: Vec<(u64, BearingObservation)>,
}

/// What is known of frames through those that have left: a quadratic in the errors against where it was made.
#[derive(Clone, Debug)]
pub(crate) struct Prior {
    /// Frames by number, rising, with the states at which the prior was made.
    pub(crate) at: Vec<(u64, State)>,
    pub(crate) information: DMatrix<f64>,
    /// Gradient there.
    pub(crate) gradient: DVector<f64>,
}

/// See the module.
#[derive(Clone, Debug)]
pub(crate) struct Window {
    pub(crate) cameras: Vec<Camera>,
    /// Of each camera, where mounts are estimated too; else empty.
    pub(crate) extrinsics: Vec<ExtrinsicsPrior>,
    pub(crate) frames: Vec<Frame>,
    pub(crate) landmarks: BTreeMap<u64, Landmark>,
    pub(crate) prior: Prior,
    /// Standard deviation of a sight, px.
    pub(crate) observation_sigma_px: f64,
}

impl Prior {
    /// Independent standard deviations of one state.
    pub(crate) fn of(number: u64, state: State, sigmas: &[f64; STATE_DIM]) -> Self {
        let diagonal = DVector::from_iterator(STATE_DIM, sigmas.iter().map(|s| 1.0 / (s * s)));
        Self {
            at: vec![(number, state)],
            information: DMatrix::from_diagonal(&diagonal),
            gradient: DVector::zeros(STATE_DIM),
        }
    }

    /// Of its first frame, once it is of one alone; wide where it has none.
    pub(crate) fn covariance(&self) -> SMatrix<f64, STATE_DIM, STATE_DIM> {
        let inverse = self.information.clone().try_inverse();
        inverse.map_or(SMatrix::identity(), |inverse| {
            inverse
                .fixed_view::<STATE_DIM, STATE_DIM>(0, 0)
                .into_owned()
        })
    }
}

impl Landmark {
    /// Place of the first of its sights in a frame and later ones, but for the host's.
    pub(crate) fn since(&self, number: u64) -> usize {
        self.observations
            .partition_point(|(n, _)| *n < number)
            .max(1)
    }

    /// Takes back sights that were wrong, by place and eye (1 the right one), in rising order.
    pub(crate) fn drop_observations(&mut self, entries: &[(usize, usize)]) {
        for (observation, side) in entries.iter().rev() {
            if *side == 0 {
                self.observations.remove(*observation);
            } else if let Some((_, observation)) = self.observations.get_mut(*observation) {
                observation.right = None;
            }
        }
    }
}

impl Window {
    /// Where a frame is in the window.
    pub(crate) fn position(&self, number: u64) -> Option<usize> {
        self.frames.binary_search_by_key(&number, |f| f.number).ok()
    }

    /// Blocks of unknowns that sights depend on: poses of frames, and behind them mounts of cameras.
    pub(crate) fn blocks(&self) -> usize {
        self.frames.len() + self.extrinsics.len()
    }

    /// Where a block begins in a step of the whole window, in which frames have all their numbers.
    pub(crate) fn row_of(&self, block: usize) -> usize {
        let frames = self.frames.len();
        block.min(frames) * STATE_DIM + block.saturating_sub(frames) * POSE_DIM
    }

    /// The newest frame.
    pub(crate) fn newest(&self) -> &Frame {
        &self.frames[self.frames.len() - 1]
    }

    /// Takes the newest frame away, with all that it saw.
    pub(crate) fn drop_newest(&mut self) {
        let Some(frame) = self.frames.pop() else {
            return;
        };
        self.landmarks.retain(|_, landmark| {
            landmark
                .observations
                .retain(|(number, _)| *number != frame.number);
            !landmark.observations.is_empty()
        });
    }
}
