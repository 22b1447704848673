//! Result of a calibration.

use cad_transforms::RigidTransform;
use camera_models::CameraModel;
use nalgebra::Matrix6;

use super::config::Config;
use super::coverage::Coverage;
use super::finding::{Finding, Severity};
use super::input::Input;
use super::model_selection::Choice;
use crate::adjust::{AdjustError, Covariance, Parameter, Solution, pose_jacobian};

/// Result of a calibration.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// Configuration of the calibration.
    pub config: Config,
    /// The input.
    pub input: Input,
    /// Instants used: indices into the input's, ascending.
    pub used: Vec<usize>,
    /// Lens model selection, per camera.
    pub choices: Vec<Choice>,
    /// The solved problem: its lenses are the eyes in order; [`RigPoses`] maps its poses.
    pub solution: Solution,
    /// Indices of the poses in the problem.
    pub poses: RigPoses,
    /// Image coverage of each eye.
    pub coverage: Vec<Coverage>,
    /// Sagitta of each target, m: z of its middle minus z of its rim, positive if the middle is
    /// under the rim; 0 for targets that are flat within the measurement.
    pub sagitta_m: Vec<f64>,
    /// Objections to the result, worst first.
    pub findings: Vec<Finding>,
}

/// Indices into [`Problem::poses`](crate::adjust::Problem::poses).
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RigPoses {
    /// `rig_from_left` by camera; `None` for cameras that could not be connected.
    pub cameras: Vec<Option<usize>>,
    /// `left_from_right` by camera.
    pub pairs: Vec<Option<usize>>,
    /// `world_from_target` by target; `None` for the world target and for targets that were not
    /// observed.
    pub targets: Vec<Option<usize>>,
}

/// Reasons for a failed calibration.
#[derive(Debug, thiserror::Error)]
pub enum CamerasError {
    /// Too few detections in one eye: record more, or check the target description.
    #[error(
        "calibrating {eye}: a target was detected in {found} images, expected at least {expected}: {hint}"
    )]
    TooFew {
        /// Name of the eye.
        eye: String,
        /// Number of images with a detection.
        found: usize,
        /// Number required.
        expected: usize,
        /// Possible reason.
        hint: String,
    },
    /// No lens model explains the detections: the target differs from its description, or the ids
    /// are wrong.
    #[error(
        "calibrating {eye}: no lens explains the detections; the best has an RMS residual of {rms_px:.1} px, expected below {limit_px} px: is the target what its file says?"
    )]
    NoLens {
        /// Name of the eye.
        eye: String,
        /// RMS residual of the best model, px.
        rms_px: f64,
        /// Largest RMS residual allowed, px.
        limit_px: f64,
    },
    /// Bundle adjustment failed.
    #[error("calibrating the rig")]
    Adjust(#[from] AdjustError),
}

impl Calibration {
    /// Estimated model of an eye.
    pub fn lens(&self, eye: usize) -> &CameraModel {
        &self.solution.problem.lenses[eye].model
    }

    /// Standard deviations of an eye's parameters, in their order.
    pub fn lens_sigmas(&self, eye: usize) -> Vec<f64> {
        let count = self.lens(eye).parameters().len();
        (0..count)
            .map(|k| self.covariance().sigma(Parameter::Lens(eye, k)))
            .collect()
    }

    /// A pose and its covariance, `[v, ω]` in the parent's axes; zero for a fixed pose.
    pub fn pose(&self, number: usize) -> (RigidTransform, Matrix6<f64>) {
        let pose = &self.solution.problem.poses[number];
        let sigma = self.covariance().of_pose(number);
        (pose.parent_from_child, sigma)
    }

    /// `a_from_b` between the left eyes of two cameras with its covariance, `[v, ω]` in the axes of
    /// `a`; independent of the pose of the rig frame. `None` for cameras that are not connected.
    pub fn left_from_left(&self, a: usize, b: usize) -> Option<(RigidTransform, Matrix6<f64>)> {
        let (pa, pb) = (self.poses.cameras[a]?, self.poses.cameras[b]?);
        let poses = &self.solution.problem.poses;
        let (rig_from_a, rig_from_b) = (poses[pa].parent_from_child, poses[pb].parent_from_child);
        let a_from_rig = *rig_from_a
            .inverse()
            .rotation()
            .to_rotation_matrix()
            .matrix();
        // A change of `a` by [v, ω] in the rig's axes changes a_from_b by minus that, with the
        // lever arm's rotation.
        let arm = rig_from_b.translation() - rig_from_a.translation();
        let (mut by_a, mut by_b) = (Matrix6::zeros(), Matrix6::zeros());
        by_b.fixed_view_mut::<3, 3>(0, 0).copy_from(&a_from_rig);
        by_b.fixed_view_mut::<3, 3>(3, 3).copy_from(&a_from_rig);
        by_a.fixed_view_mut::<3, 3>(0, 0).copy_from(&-a_from_rig);
        by_a.fixed_view_mut::<3, 3>(3, 3).copy_from(&-a_from_rig);
        by_a.fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&(a_from_rig * arm.cross_matrix()));
        let by = [pose_jacobian(pa, &by_a), pose_jacobian(pb, &by_b)].concat();
        let covariance = self.covariance().of(&by);
        Some((rig_from_a.inverse() * rig_from_b, covariance))
    }

    /// Index of the input's instant, from the problem's.
    pub fn instant_of(&self, instant: usize) -> usize {
        self.used[instant]
    }

    /// Severity of the worst finding.
    pub fn severity(&self) -> Option<Severity> {
        self.findings.iter().map(|f| f.severity).max()
    }

    pub(super) fn covariance(&self) -> &Covariance {
        self.solution
            .covariance
            .as_ref()
            .expect("covariances are computed")
    }
}
