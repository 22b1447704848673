//! Input of a calibration.

use boards::Target;
use cad_transforms::RigidTransform;
use camera_models::CameraModel;
use nalgebra::Matrix6;

use crate::target::DetectedCorner;

/// Input of a calibration: cameras, targets and detections.
#[derive(Clone, Debug, Default)]
pub struct Input {
    /// All lenses of the rig: left and right eyes of its cameras.
    pub eyes: Vec<Eye>,
    /// Assignment of eyes to cameras, with nominal extrinsics.
    pub cameras: Vec<Camera>,
    /// The targets.
    pub targets: Vec<Target>,
    /// Timestamps of the instants, ns, ascending; all eyes are exposed simultaneously.
    pub times_ns: Vec<i64>,
    /// Target detections.
    pub detections: Vec<TargetDetection>,
}

/// One lens of the rig: the left or right eye of a camera.
#[derive(Clone, Debug)]
pub struct Eye {
    /// Name of its optical frame, for messages and files.
    pub name: String,
    /// Width and height of its images, pixels.
    pub size: (u32, u32),
    /// Factory intrinsics.
    pub factory: Option<CameraModel>,
}

/// A camera of one or two eyes.
#[derive(Clone, Debug)]
pub struct Camera {
    /// Camera name.
    pub name: String,
    /// Index of the left eye, the camera's reference.
    pub left: usize,
    /// Index of the right eye.
    pub right: Option<usize>,
    /// Factory `left_from_right`.
    pub left_from_right: Option<ExtrinsicsPrior>,
    /// Nominal `rig_from_left`; with a covariance of 0 it is fixed.
    pub rig_from_left: Option<ExtrinsicsPrior>,
}

/// Prior on extrinsics.
#[derive(Clone, Debug, PartialEq)]
pub struct ExtrinsicsPrior {
    /// `parent_from_child`.
    pub transform: RigidTransform,
    /// Covariance of `[v, ω]` as in [`crate::adjust`], in the parent's axes, m and rad.
    pub covariance: Matrix6<f64>,
}

/// Detection of one target in one image.
#[derive(Clone, Debug, PartialEq)]
pub struct TargetDetection {
    /// Index of the instant.
    pub instant: usize,
    /// Index of the eye.
    pub eye: usize,
    /// Index of the target.
    pub target: usize,
    /// Detected corners.
    pub corners: Vec<DetectedCorner>,
}

impl Input {
    /// The camera that is the origin of the rig: the first, if no file gives the pose of any. `rig`
    /// is then at its left lens, x along its view, y to the left and z up in its image.
    pub fn origin(&self) -> Option<usize> {
        let has_prior = self.cameras.iter().any(|c| c.rig_from_left.is_some());
        (!has_prior && !self.cameras.is_empty()).then_some(0)
    }

    /// The camera of an eye.
    pub(super) fn camera_of(&self, eye: usize) -> Option<usize> {
        self.cameras
            .iter()
            .position(|c| c.left == eye || c.right == Some(eye))
    }
}
