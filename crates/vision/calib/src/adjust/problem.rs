//! A bundle adjustment problem: lenses, poses, views, and the priors on them.

use cad_transforms::RigidTransform;
use camera_models::CameraModel;
use nalgebra::{Matrix6, Vector6};

/// A bundle adjustment problem: parameters with initial values, priors and observations.
#[derive(Clone, Debug, Default)]
pub struct Problem {
    /// Lenses, one per eye.
    pub lenses: Vec<LensBlock>,
    /// Constant poses: of eyes on the rig, of targets in the world.
    pub poses: Vec<PoseBlock>,
    /// Poses of the rig: `rig_from_world` of every instant.
    pub instants: Vec<RigidTransform>,
    /// View cluster of each instant; instants of one cluster may have common errors. Empty if each
    /// instant is a cluster.
    pub clusters: Vec<usize>,
    /// The observations.
    pub views: Vec<View>,
}

/// A lens and the priors on its parameters.
#[derive(Clone, Debug)]
pub struct LensBlock {
    /// Name for messages.
    pub name: String,
    /// Initial values.
    pub model: CameraModel,
    /// One per parameter of the model, in their order.
    pub priors: Vec<Prior>,
}

/// Prior on a parameter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Prior {
    /// Fixed at its initial value.
    Fixed,
    /// No prior.
    Free,
    /// Normal distribution around `mean`.
    Near {
        /// Expected value.
        mean: f64,
        /// Standard deviation, above 0.
        sigma: f64,
    },
}

/// A pose and its prior.
#[derive(Clone, Debug)]
pub struct PoseBlock {
    /// Name for messages.
    pub name: String,
    /// Initial value.
    pub parent_from_child: RigidTransform,
    /// Prior.
    pub prior: PosePrior,
}

/// Prior on a pose.
#[derive(Clone, Debug, PartialEq)]
pub enum PosePrior {
    /// Fixed at its initial value.
    Fixed,
    /// No prior.
    Free,
    /// Normal distribution around `mean`.
    Near {
        /// Expected `parent_from_child`.
        mean: RigidTransform,
        /// Covariance of `[v, ω]`, m and rad.
        covariance: Box<Matrix6<f64>>,
    },
}

/// Observations of one target by one eye at one instant.
#[derive(Clone, Debug)]
pub struct View {
    /// Index of the instant.
    pub instant: usize,
    /// Index of the lens.
    pub lens: usize,
    /// Indices of the poses from the rig to the eye, `parent_from_child` each.
    pub path: Vec<usize>,
    /// Index of the target's pose in the world; `None` for the target that defines the world.
    pub target: Option<usize>,
    /// The points.
    pub points: Vec<Point>,
}

/// A point and its observation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Position on the target, m.
    pub x_in_target: [f64; 3],
    /// Observed pixel.
    pub pixel: [f64; 2],
    /// Standard deviation of each coordinate of the pixel, at least relative to the others'.
    pub sigma_px: f64,
}

/// Reasons for a missing solution.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AdjustError {
    /// A parameter that is not constrained: record other views, or give it a prior.
    #[error(
        "adjusting cameras: {name} is not determined by {views} views, expected views that show it or a prior"
    )]
    Undetermined {
        /// Name of the parameter.
        name: String,
        /// Number of views.
        views: usize,
    },
    /// The initial values are so wrong that points cannot be projected: start elsewhere.
    #[error(
        "adjusting cameras: {seen} of {all} points can be projected with the initial values, expected most of them"
    )]
    Start {
        /// Number of points that can be projected.
        seen: usize,
        /// Number of points.
        all: usize,
    },
}

/// One free parameter of a problem.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parameter {
    /// A parameter of a lens, by the index of the lens and its own.
    Lens(usize, usize),
    /// A coordinate of `[v, ω]` of a pose, by the index of the pose and its own.
    Pose(usize, usize),
}

impl Problem {
    /// The free parameters, in the order of [`Covariance`](super::Covariance): lenses first.
    pub fn parameters(&self) -> Vec<Parameter> {
        let mut all = Vec::new();
        for (i, lens) in self.lenses.iter().enumerate() {
            let free = lens.priors.iter().enumerate();
            let free = free.filter(|(_, prior)| **prior != Prior::Fixed);
            all.extend(free.map(|(k, _)| Parameter::Lens(i, k)));
        }
        for (i, place) in self.poses.iter().enumerate() {
            if place.prior != PosePrior::Fixed {
                all.extend((0..6).map(|k| Parameter::Pose(i, k)));
            }
        }
        all
    }

    /// Name of a parameter, for messages.
    pub fn name(&self, parameter: Parameter) -> String {
        match parameter {
            Parameter::Lens(i, k) => {
                let lens = &self.lenses[i];
                format!("{} of {}", lens.model.parameter_names()[k], lens.name)
            }
            Parameter::Pose(i, k) => {
                let what = [
                    "x",
                    "y",
                    "z",
                    "rotation about x",
                    "rotation about y",
                    "rotation about z",
                ][k];
                format!("{what} of {}", self.poses[i].name)
            }
        }
    }

    /// Number of points observed.
    pub fn points(&self) -> usize {
        self.views.iter().map(|view| view.points.len()).sum()
    }
}

impl LensBlock {
    /// A lens without priors.
    pub fn free(name: &str, model: CameraModel) -> Self {
        Self {
            name: name.to_owned(),
            model,
            priors: vec![Prior::Free; model.parameters().len()],
        }
    }

    /// A fixed lens.
    pub fn fixed(name: &str, model: CameraModel) -> Self {
        Self {
            priors: vec![Prior::Fixed; model.parameters().len()],
            ..Self::free(name, model)
        }
    }
}

impl PosePrior {
    /// A normal prior with one sigma for all translations, m, and one for all rotations, rad.
    pub fn near(mean: RigidTransform, sigma_m: f64, sigma_rad: f64) -> Self {
        let (v, w) = (sigma_m * sigma_m, sigma_rad * sigma_rad);
        Self::Near {
            mean,
            covariance: Box::new(Matrix6::from_diagonal(&Vector6::new(v, v, v, w, w, w))),
        }
    }
}
