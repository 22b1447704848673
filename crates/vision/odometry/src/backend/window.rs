//! Sliding window: frames and landmarks that are estimated jointly, with their factors.
//!
//! Frames are in order of time. Adjacent frames are connected by a preintegrated IMU factor, or by
//! a constant-velocity factor without IMU samples. The information of marginalized frames is in the
//! prior.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use crate::backend::covariance::NewestCovariance;
use crate::backend::extrinsics::Extrinsics;
use crate::backend::gyro_scale::GyroScale;
use crate::backend::observation::{BearingObservation, Camera};
use crate::backend::state::{POSE_DIM, ROTATION, STATE_DIM, State};
use crate::backend::stereo::{STEREO_DIM, StereoVector};
use crate::config::BackendConfig;
use crate::inertial::imu_buffer::Preintegration;

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
    pub(crate) preintegrated: Preintegration,
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
    /// Extrinsics at the linearization point, one per camera if calibrations are estimated; else
    /// empty. Their rows follow those of the frames.
    pub(crate) extrinsics: Vec<Extrinsics>,
    /// Errors of the stereo calibrations at the linearization point, one per camera, or empty.
    /// Their rows follow those of the extrinsics.
    pub(crate) stereo: Vec<StereoVector>,
    pub(crate) information: DMatrix<f64>,
    /// Gradient at the linearization point.
    pub(crate) gradient: DVector<f64>,
    /// Scale errors of the gyroscope: the current estimate and its prior.
    pub(crate) gyro_scale: GyroScale,
}

/// Sliding window.
#[derive(Clone, Debug)]
pub(crate) struct Window {
    pub(crate) cameras: Vec<Camera>,
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
            extrinsics: Vec::new(),
            stereo: Vec::new(),
            information: DMatrix::from_diagonal(&diagonal),
            gradient: DVector::zeros(STATE_DIM),
            gyro_scale: GyroScale::fixed(STATE_DIM),
        }
    }

    /// The prior with calibrations of these cameras as estimated parameters, with this joint
    /// information at their current values: of the extrinsics of all cameras, followed by their
    /// stereo calibrations.
    pub(crate) fn with_calibrations(
        mut self,
        cameras: &[Camera],
        information: &DMatrix<f64>,
    ) -> Self {
        let (frames, more) = (self.gradient.len(), information.nrows());
        self.extrinsics = cameras.iter().map(|camera| camera.body_from_left).collect();
        self.stereo = cameras.iter().map(|camera| camera.stereo.error).collect();
        self.gradient = self.gradient.resize_vertically(frames + more, 0.0);
        let by = &mut self.gyro_scale.border.by;
        *by = std::mem::take(by).resize_vertically(frames + more, 0.0);
        self.information = (self.information).resize(frames + more, frames + more, 0.0);
        let mut view = self.information.view_mut((frames, frames), (more, more));
        view.copy_from(information);
        self
    }

    /// The prior with scale errors of the gyroscope as estimated parameters, with this information
    /// at these errors.
    pub(crate) fn with_gyro_scale(
        mut self,
        error: Vector3<f64>,
        information: Matrix3<f64>,
    ) -> Self {
        self.gyro_scale = GyroScale::estimated(self.gradient.len(), error, information);
        self
    }

    /// First row of the extrinsics of a camera.
    pub(crate) fn extrinsics_row(&self, camera: usize) -> usize {
        self.at.len() * STATE_DIM + camera * POSE_DIM
    }

    /// First row of the stereo calibration of a camera.
    pub(crate) fn stereo_row(&self, camera: usize) -> usize {
        self.extrinsics_row(self.extrinsics.len()) + camera * STEREO_DIM
    }

    /// Adds this variance, rad², to the rotation of the left eye of a camera about each axis. The
    /// estimate remains.
    pub(crate) fn add_rotation_variance(&mut self, camera: usize, variance: f64) {
        let at = self.extrinsics_row(camera) + ROTATION;
        let scale = &mut self.gyro_scale.border;
        // Woodbury identity, of the rows of the prior and the scale errors together.
        let own = self.information.fixed_columns::<3>(at).into_owned();
        let own_scale = scale.by.fixed_rows::<3>(at).into_owned();
        let own_gradient = self.gradient.fixed_rows::<3>(at).into_owned();
        let sum = Matrix3::identity() / variance + own.fixed_rows::<3>(at);
        let Some(inverse) = sum.try_inverse() else {
            return;
        };
        let weighted = &own * inverse;
        self.information -= &weighted * own.transpose();
        self.gradient -= &weighted * own_gradient;
        let weighted_scale = own_scale.transpose() * inverse;
        scale.by -= weighted * own_scale;
        scale.information -= weighted_scale * own_scale;
        scale.gradient -= weighted_scale * own_gradient;
    }

    /// Covariance of its frame and the calibrations; of a prior of a single frame.
    pub(crate) fn covariance(&self) -> NewestCovariance {
        let size = self.information.nrows();
        let inverse = self.information.clone().try_inverse();
        let gyro_scale = self.gyro_scale.border.information.try_inverse();
        NewestCovariance {
            joint: inverse.unwrap_or_else(|| DMatrix::identity(size, size)),
            gyro_scale: gyro_scale.unwrap_or_else(Matrix3::zeros),
        }
    }
}

/// Rows of the prior that belong to one frame, or to the extrinsics or the stereo calibration of
/// one camera.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PriorSegment {
    /// First row in the prior.
    pub(crate) at: usize,
    /// Block of the window.
    pub(crate) block: usize,
    /// First row of that block.
    pub(crate) row: usize,
    /// Number of rows.
    pub(crate) count: usize,
}

/// Offset of a block among poses and extrinsics, of which there are `poses`, and the stereo
/// calibrations that follow them.
pub(crate) fn compact_row(poses: usize, block: usize) -> usize {
    block.min(poses) * POSE_DIM + block.saturating_sub(poses) * STEREO_DIM
}

impl Landmark {
    /// Index of the first observation in this frame or a later one, the host excluded.
    pub(crate) fn since(&self, number: u64) -> usize {
        self.observations
            .partition_point(|(n, _)| *n < number)
            .max(1)
    }

    /// Adds an observation in the newest frame. That of a camera other than the host's is widened
    /// by `cross_camera_ratio`.
    pub(crate) fn observe(
        &mut self,
        number: u64,
        observation: BearingObservation,
        cross_camera_ratio: f64,
    ) {
        let is_host_camera = self.observations[0].1.camera == observation.camera;
        let ratio = if is_host_camera {
            1.0
        } else {
            cross_camera_ratio
        };
        self.observations.push((number, observation.widened(ratio)));
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
    /// extrinsics of cameras and by stereo calibrations of cameras.
    pub(crate) fn blocks(&self) -> usize {
        self.frames.len() + self.prior.extrinsics.len() + self.prior.stereo.len()
    }

    /// Block of the extrinsics of a camera.
    pub(crate) fn extrinsics_block(&self, camera: usize) -> usize {
        self.frames.len() + camera
    }

    /// Whether calibrations are estimated.
    pub(crate) fn estimates_calibrations(&self) -> bool {
        !self.prior.stereo.is_empty()
    }

    /// Block of the stereo calibration of a camera.
    pub(crate) fn stereo_block(&self, camera: usize) -> usize {
        self.frames.len() + self.prior.extrinsics.len() + camera
    }

    /// Offset of a block in a step of the whole window, in which frames have full states.
    pub(crate) fn row_of(&self, block: usize) -> usize {
        let frames = self.frames.len();
        block.min(frames) * (STATE_DIM - POSE_DIM) + self.compact_row_of(block)
    }

    /// Offset of a block where frames have poses only.
    pub(crate) fn compact_row_of(&self, block: usize) -> usize {
        compact_row(self.stereo_block(0), block)
    }

    /// Number of rows of a block where frames have poses only.
    pub(crate) fn compact_rows(&self, block: usize) -> usize {
        self.compact_row_of(block + 1) - self.compact_row_of(block)
    }

    /// Rows of the prior and their places in the window; frames that have left it are omitted.
    pub(crate) fn prior_segments(&self) -> Vec<PriorSegment> {
        let frames = self.prior.at.iter().enumerate().map(|(k, (number, _))| {
            let block = self.position(*number);
            (k * STATE_DIM, block, STATE_DIM)
        });
        let extrinsics = (0..self.prior.extrinsics.len()).map(|camera| {
            let block = Some(self.extrinsics_block(camera));
            (self.prior.extrinsics_row(camera), block, POSE_DIM)
        });
        let stereo = (0..self.prior.stereo.len()).map(|camera| {
            let block = Some(self.stereo_block(camera));
            (self.prior.stereo_row(camera), block, STEREO_DIM)
        });
        (frames.chain(extrinsics).chain(stereo))
            .filter_map(|(at, block, count)| {
                let block = block?;
                let row = self.row_of(block);
                Some(PriorSegment {
                    at,
                    block,
                    row,
                    count,
                })
            })
            .collect()
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::backend::covariance::CALIBRATION_DIM;
    use crate::backend::solver::tests::camera;

    #[test]
    fn rotation_variance_is_added_and_the_estimate_remains() {
        let cameras = [camera(0.1, 0.0), camera(0.4, 0.0)];
        let size = STATE_DIM + cameras.len() * CALIBRATION_DIM;
        let mixed = |rows: usize, columns: usize| {
            DMatrix::from_fn(rows, columns, |i, j| (1.0 + (i * 7 + j * 3) as f64).sin())
        };
        let square = |root: &DMatrix<f64>| root * root.transpose() + DMatrix::identity(size, size);
        let mut prior = Prior::of(1, State::at_rest(0), &[1.0; STATE_DIM]);
        let calibrations = cameras.len() * CALIBRATION_DIM;
        prior = prior.with_calibrations(&cameras, &DMatrix::identity(calibrations, calibrations));
        prior = prior.with_gyro_scale(Vector3::zeros(), Matrix3::identity());
        prior.information = square(&mixed(size, size));
        prior.gradient = mixed(size, 1).column(0).into_owned();
        prior.gyro_scale.border.by = mixed(size, 3).fixed_columns::<3>(0) * 0.1;
        prior.gyro_scale.border.gradient = Vector3::new(0.3, -0.2, 0.1);
        let solved = |prior: &Prior| {
            let scale = &prior.gyro_scale.border;
            let mut all = prior.information.clone().resize(size + 3, size + 3, 0.0);
            all.view_mut((0, size), (size, 3)).copy_from(&scale.by);
            all.view_mut((size, 0), (3, size))
                .copy_from(&scale.by.transpose());
            all.view_mut((size, size), (3, 3))
                .copy_from(&scale.information);
            let mut gradient = prior.gradient.clone().resize_vertically(size + 3, 0.0);
            gradient.rows_mut(size, 3).copy_from(&scale.gradient);
            let covariance = all.try_inverse().expect("positive definite");
            (&covariance * gradient, covariance)
        };
        let (estimate, mut expected) = solved(&prior);
        let rotation_of_second = STATE_DIM + POSE_DIM + ROTATION;
        for k in rotation_of_second..rotation_of_second + 3 {
            expected[(k, k)] += 0.25;
        }
        prior.add_rotation_variance(1, 0.25);
        let (after, covariance) = solved(&prior);
        assert!((covariance - expected).amax() < 1e-9);
        assert!((after - estimate).amax() < 1e-9);
    }
}
