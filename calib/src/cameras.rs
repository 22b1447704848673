//! Cameras from pictures of calibration targets: lenses, then each stereo camera, then the whole rig.
//!
//! Contract: [`calibrate`] takes what detection saw ([`TargetDetection`]) and what is told by factory files and the
//! rig file, and gives values with covariances, the lens model that the data support, and [`Finding`]s:
//! everything that makes the result doubtful. A result with a finding of severity [`Severity::Fail`] must not
//! be used. What the views do not determine stays where it was told, with the sigma that says so; what is
//! neither told nor seen is an error that names it. The same input gives the same bytes.
//!
//! The way there: views that are still and tell much are chosen (`select`); a lens to start from
//! (`start`); a lens model per stereo camera ([`choose`]); where everything is, roughly (`connect`);
//! everything at once ([`crate::adjust`]); the shape of the targets (`shape`); and what speaks against the
//! result ([`check`]).
//!
//! Frames: the world is the target that was seen most. What is told of a camera's place on the rig is a
//! prior, so the rig's own frame moves as little as it can; what is told without any tolerance is held. Where nothing is
//! told the first camera is the origin:
//! `rig` is at its left lens, x along the view, y to the left, z up in its image ([`Input::origin`]).

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

/// What is calibrated and from what.
#[derive(Clone, Debug, Default)]
pub struct Input {
    /// Every eye.
    pub eyes: Vec<Eye>,
    /// Which eyes form a camera, and where cameras sit.
    pub cameras: Vec<Camera>,
    /// The targets.
    pub targets: Vec<Target>,
    /// When pictures were taken, ns, ascending; all eyes at once.
    pub times_ns: Vec<i64>,
    /// What was seen.
    pub detections: Vec<TargetDetection>,
}

/// One eye.
#[derive(Clone, Debug)]
pub struct Eye {
    /// Name of its frame, for messages and files.
    pub name: String,
    /// Width and height of its pictures, pixels.
    pub size: (u32, u32),
    /// What the factory says.
    pub factory: Option<CameraModel>,
}

/// A camera of one or two eyes.
#[derive(Clone, Debug)]
pub struct Camera {
    /// Its name.
    pub name: String,
    /// Number of the left eye, its reference.
    pub left: usize,
    /// Number of the right eye.
    pub right: Option<usize>,
    /// What the factory says of `left_from_right`.
    pub left_from_right: Option<ExtrinsicsPrior>,
    /// What the rig file says of `rig_from_left`; with a covariance of 0 it is held.
    pub rig_from_left: Option<ExtrinsicsPrior>,
}

/// A place as a file tells it.
#[derive(Clone, Debug, PartialEq)]
pub struct ExtrinsicsPrior {
    /// `parent_from_child`.
    pub transform: RigidTransform,
    /// How far it may be off: `[v, ω]` as in [`crate::adjust`], in the parent's axes, m and rad.
    pub covariance: Matrix6<f64>,
}

/// One target in one picture.
#[derive(Clone, Debug, PartialEq)]
pub struct TargetDetection {
    /// Number of the instant.
    pub instant: usize,
    /// Number of the eye.
    pub eye: usize,
    /// Number of the target.
    pub target: usize,
    /// Its corners.
    pub corners: Vec<DetectedCorner>,
}

/// How to calibrate.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Most instants that are used for one camera's lenses, and again for how cameras sit.
    pub max_views: usize,
    /// Which lens models are tried; none for the factory's alone.
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

/// What came out.
#[derive(Clone, Debug)]
pub struct Calibration {
    /// What it was made from.
    pub input: Input,
    /// Instants that were used, ascending numbers of the input's.
    pub used: Vec<usize>,
    /// How the lens model was chosen, per camera.
    pub choices: Vec<Choice>,
    /// The adjusted problem: lenses are the eyes in order; see [`RigPoses`] for its places.
    pub solution: Solution,
    /// Which place of the problem is which.
    pub poses: RigPoses,
    /// What of each eye's picture was seen.
    pub coverage: Vec<Coverage>,
    /// Height of the middle of each target over its rim, m: 0 for those that are flat as far as can be told.
    pub sagitta_m: Vec<f64>,
    /// What speaks against the result, worst first.
    pub findings: Vec<Finding>,
}

/// Numbers of the problem's places.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RigPoses {
    /// `rig_from_left` by camera; none for cameras that could not be connected.
    pub cameras: Vec<Option<usize>>,
    /// `left_from_right` by camera.
    pub pairs: Vec<Option<usize>>,
    /// `world_from_target` by target; none for the one that is the world and those that were not seen.
    pub targets: Vec<Option<usize>>,
}

/// Why there is no calibration.
#[derive(Debug, thiserror::Error)]
pub enum CamerasError {
    /// Too little was seen of targets by an eye: record more, or check the target's description.
    #[error(
        "calibrating {eye}: a target was seen in {found} pictures, expected at least {expected}: {hint}"
    )]
    TooFew {
        /// Which eye.
        eye: String,
        /// In how many pictures.
        found: usize,
        /// How many are needed.
        expected: usize,
        /// What may be the reason.
        hint: String,
    },
    /// No lens explains the pictures: the target is not what was said, or the ids are wrong.
    #[error(
        "calibrating {eye}: no lens explains what was seen; the best misses by {rms_px:.1} px, expected below {limit_px} px: is the target what its file says?"
    )]
    NoLens {
        /// Which eye.
        eye: String,
        /// What the best one reached.
        rms_px: f64,
        /// What is expected.
        limit_px: f64,
    },
    /// The adjustment failed.
    #[error("calibrating the rig")]
    Adjust(#[from] AdjustError),
}

impl Calibration {
    /// The lens of an eye.
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

    /// A place and its covariance, `[v, ω]` in the parent's axes; zero for one that was held.
    pub fn pose(&self, number: usize) -> (RigidTransform, Matrix6<f64>) {
        let pose = &self.solution.problem.poses[number];
        let sigma = self.covariance().of_pose(number);
        (pose.parent_from_child, sigma)
    }

    /// `a_from_b` of the left eyes of two cameras with its covariance, `[v, ω]` in the axes of `a`: free of
    /// where the rig's own frame is. None for cameras that are not connected.
    pub fn left_from_left(&self, a: usize, b: usize) -> Option<(RigidTransform, Matrix6<f64>)> {
        let (pa, pb) = (self.poses.cameras[a]?, self.poses.cameras[b]?);
        let poses = &self.solution.problem.poses;
        let (rig_from_a, rig_from_b) = (poses[pa].parent_from_child, poses[pb].parent_from_child);
        let a_from_rig = *rig_from_a
            .inverse()
            .rotation()
            .to_rotation_matrix()
            .matrix();
        // Moving a by [v, ω] in the rig's axes moves b, as a sees it, by minus that and the arm's turn.
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

    /// The worst finding's severity.
    pub fn severity(&self) -> Option<Severity> {
        self.findings.iter().map(|f| f.severity).max()
    }

    fn covariance(&self) -> &Covariance {
        self.solution.covariance.as_ref().expect("it was asked for")
    }
}

/// The views of a problem for some sightings; places are filled in by whoever knows them.
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

/// No corner is surer than this, px: what paper, print and lens leave.
const MIN_SIGMA_PX: f64 = 0.02;

/// A problem with one lens that sees targets from places of its own.
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
