//! Sliding window: frames and landmarks that are estimated jointly, with their factors.
//!
//! Frames are in order of time. Adjacent frames are connected by a preintegrated IMU factor, or by
//! a constant-velocity factor without IMU samples. The information of marginalized frames is in the
//! prior.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, SMatrix};

use crate::backend::extrinsics::ExtrinsicsPrior;
use crate::backend::observation::{BearingObservation, Camera};
use crate::backend::state::{POSE_DIM, STATE_DIM, State};
use crate::config::BackendConfig;
use crate::inertial::imu_buffer::Preintegrated;

/// A frame of the window.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    /// Number of the frame set.
    pub(crate) number: u64,
    pub(crate) state: State,
    /// Motion factor from the previous frame of the window; `None` for the first one.
    pub(crate) motion: Option<MotionFactor>,
}

/// Motion factor between adjacent frames.
#[derive(Clone, Debug)]
pub(crate) struct MotionFactor {
    pub(crate) preintegrated: Preintegrated,
    /// Whether the factor contains measured specific force; false for a constant-velocity factor.
    pub(crate) has_gravity: bool,
    /// Bias random walk densities, rad/s²/√Hz and m/s³/√Hz.
    pub(crate) bias_walk: [f64; 2],
}

/// A landmark. The first of its observations is that of the host.
#[derive(Clone, Debug)]
pub(crate) struct Landmark {
    /// Inverse range from the left camera of the host, 1/m.
    pub(crate) rho: f64,
    /// By frame number, ascending; several of one frame belong to different cameras.
    pub(crate) observations: Vec<(u64, BearingObservation)>,
}

/// Marginalization prior: a quadratic in the errors relative to its linearization point.
#[derive(Clone, Debug)]
pub(crate) struct Prior {
    /// Frames by number, ascending, with their states at the linearization point.
    pub(crate) at: Vec<(u64, State)>,
    pub(crate) information: DMatrix<f64>,
    /// Gradient at the linearization point.
    pub(crate) gradient: DVector<f64>,
}

/// Sliding window.
#[derive(Clone, Debug)]
pub(crate) struct Window {
    pub(crate) cameras: Vec<Camera>,
    /// Extrinsics priors, one per camera, if extrinsics are estimated; else empty.
    pub(crate) extrinsics: Vec<ExtrinsicsPrior>,
    pub(crate) frames: Vec<Frame>,
    pub(crate) landmarks: BTreeMap<u64, Landmark>,
    pub(crate) prior: Prior,
    pub(crate) config: BackendConfig,
}

impl Prior {
    /// Prior of one state with independent standard deviations.
    pub(crate) fn of(number: u64, state: State, sigmas: &[f64; STATE_DIM]) -> Self {
        let diagonal = DVector::from_iterator(STATE_DIM, sigmas.iter().map(|s| 1.0 / (s * s)));
        Self {
            at: vec![(number, state)],
            information: DMatrix::from_diagonal(&diagonal),
            gradient: DVector::zeros(STATE_DIM),
        }
    }

    /// Covariance of its first frame, if it has only one; wide if it has none.
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
    /// Index of the first observation in this frame or a later one, the host excluded.
    pub(crate) fn since(&self, number: u64) -> usize {
        self.observations
            .partition_point(|(n, _)| *n < number)
            .max(1)
    }

    /// Removes outliers by index and side (0 left, 1 right), in ascending order.
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
    /// Index of a frame in the window.
    pub(crate) fn position(&self, number: u64) -> Option<usize> {
        self.frames.binary_search_by_key(&number, |f| f.number).ok()
    }

    /// Number of parameter blocks that observations depend on: poses of frames, followed by
    /// extrinsics of cameras.
    pub(crate) fn blocks(&self) -> usize {
        self.frames.len() + self.extrinsics.len()
    }

    /// Offset of a block in a step of the whole window, in which frames have full states.
    pub(crate) fn row_of(&self, block: usize) -> usize {
        let frames = self.frames.len();
        block.min(frames) * STATE_DIM + block.saturating_sub(frames) * POSE_DIM
    }

    /// Newest frame.
    pub(crate) fn newest(&self) -> &Frame {
        &self.frames[self.frames.len() - 1]
    }

    /// Removes the newest frame and its observations.
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
