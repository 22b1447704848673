//! Camera calibration from images of calibration targets: lenses, then each stereo camera, then the
//! whole rig.
//!
//! Contract: [`calibrate`] takes target detections ([`TargetDetection`]) and the nominal values of
//! factory files and the rig file as priors. It returns values with covariances, the lens model
//! that the data support, and [`Finding`]s: everything that makes the result questionable. A result
//! with a finding of severity [`Severity::Fail`] must not be used. Parameters that the views do not
//! constrain keep their prior, with the sigma of the prior; a parameter with neither prior nor
//! observation is an error that names it. The same input gives the same bytes.
//!
//! Steps: selection of static, informative views (`view_selection`); initial lenses
//! (`initialization`); one lens model per stereo camera ([`model_selection`]); initial poses
//! (`pose_graph`); bundle adjustment ([`crate::adjust`]); board shape (`board_shape`); and gates
//! ([`diagnostics`]).
//!
//! Frames: the world frame is the target observed most often. A nominal `rig_from_left` is a prior,
//! so that the rig frame moves as little as possible; one without a tolerance is fixed. Without any
//! nominal pose the first camera is the origin: `rig` is at its left lens, x along the view, y to
//! the left, z up in its image ([`Input::origin`]).

use cad_transforms::RigidTransform;
use nalgebra::Matrix6;

use crate::adjust::{self, AdjustError, Covariance, Parameter, Problem, Solution, pose_jacobian};
use crate::camera::CameraModel;
use crate::target::{DetectedCorner, Target};

pub mod coverage;
pub mod diagnostics;
pub mod model_selection;

mod board_shape;
mod initialization;
mod pipeline;
mod pose_graph;
#[cfg(test)]
mod tests;
mod view_clusters;
mod view_selection;

pub use coverage::Coverage;
pub use diagnostics::{Finding, Severity};
pub use model_selection::{Candidate, Choice};
pub use pipeline::calibrate;

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

/// Calibration settings.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Maximum number of instants for the lenses of one camera, and again for the extrinsics.
    pub max_views: usize,
    /// Whether all lens models are tried; otherwise only the factory's.
    pub choose_lens: bool,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            max_views: 40,
            choose_lens: true,
        }
    }
}

/// Result of a calibration.
#[derive(Clone, Debug)]
pub struct Calibration {
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

/// Indices into [`Problem::poses`].
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

    /// Severity of the worst finding.
    pub fn severity(&self) -> Option<Severity> {
        self.findings.iter().map(|f| f.severity).max()
    }

    fn covariance(&self) -> &Covariance {
        self.solution
            .covariance
            .as_ref()
            .expect("covariances are computed")
    }
}

/// Points of a detection, for a view of the problem.
fn points(target: &Target, corners: &[DetectedCorner]) -> Vec<adjust::Point> {
    let known = target.corners();
    corners
        .iter()
        .filter_map(|seen| {
            let at = known.binary_search_by_key(&seen.id, |c| c.id).ok()?;
            let [x, y] = known[at].at_m;
            Some(adjust::Point {
                x_in_target: [x, y, 0.0],
                pixel: seen.pixel,
                sigma_px: seen.sigma_px.max(MIN_SIGMA_PX),
            })
        })
        .collect()
}

/// Sigma floor of a corner, px: residual errors of paper, print and lens.
const MIN_SIGMA_PX: f64 = 0.02;

/// A problem with one lens and an independent pose per view.
fn single_lens_problem(
    lens: adjust::LensBlock,
    views: &[(RigidTransform, Vec<adjust::Point>)],
) -> Problem {
    Problem {
        lenses: vec![lens],
        poses: Vec::new(),
        instants: views.iter().map(|(pose, _)| *pose).collect(),
        clusters: Vec::new(),
        views: views
            .iter()
            .enumerate()
            .map(|(instant, (_, points))| adjust::View {
                instant,
                lens: 0,
                path: Vec::new(),
                target: None,
                points: points.clone(),
            })
            .collect(),
    }
}
