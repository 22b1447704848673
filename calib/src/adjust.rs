//! Bundle adjustment of cameras that look at known points: lenses, places of cameras on the rig and of
//! targets in the world, and where the rig was at each instant, all at once.
//!
//! Contract: [`solve`] finds the most probable values under the observations and the priors. The
//! derivatives are analytic; poses of instants are eliminated (Schur complement), so that time grows
//! with the number of observations and the cube of the number of lenses and places alone. A number
//! without a prior that the views do not determine makes the result [`AdjustError::Undetermined`],
//! which names it; nothing is invented. The same problem gives the same bits on any number of threads.
//!
//! A point in a target goes to a pixel through
//!
//! ```text
//! x_in_eye = eye_from_rig * rig_from_world(instant) * world_from_target * x_in_target
//! ```
//!
//! where `eye_from_rig` is a chain of places `parent_from_child`, each undone. A pose is changed by
//! `[v, ω]`: its translation by `v`, its rotation by `Exp(ω)` from the left, both in the axes of the frame
//! it leads to. Covariances have that order, translation first (m, rad).
//!
//! Observations carry their own sigma. How much all of them are off is estimated with the rest
//! ([`Solution::scale`]), and what is far off beyond that counts less (Huber 1964).

use cad_transforms::RigidTransform;
use nalgebra::{Matrix6, Vector6};

use crate::camera::CameraModel;

mod covariance;
mod locate;
mod normal;
mod pose;
mod solve;
#[cfg(test)]
pub(crate) mod tests;

pub use covariance::Covariance;
pub(crate) use covariance::pose_jacobian;
pub use locate::locate;
pub(crate) use normal::in_pieces;
pub(crate) use pose::step_between;
pub use solve::{Settings, Solution, solve};
pub(crate) use solve::{by_points, median_scale, reduced_equations};

/// What is to be found, with where to start.
#[derive(Clone, Debug, Default)]
pub struct Problem {
    /// Lenses, one per eye.
    pub lenses: Vec<LensBlock>,
    /// Places that do not change: of eyes on the rig, of targets in the world.
    pub poses: Vec<PoseBlock>,
    /// Where the rig is: `rig_from_world` of every instant.
    pub instants: Vec<RigidTransform>,
    /// Number of the stay that each instant is of; instants of one stay may err together. Empty where each is its own.
    pub clusters: Vec<usize>,
    /// What was seen.
    pub views: Vec<View>,
}

/// A lens and what is known of it beforehand.
#[derive(Clone, Debug)]
pub struct LensBlock {
    /// For messages.
    pub name: String,
    /// Where to start.
    pub model: CameraModel,
    /// One per parameter of the model, in their order.
    pub priors: Vec<Prior>,
}

/// What is known of a number beforehand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Prior {
    /// It is what it is.
    Fixed,
    /// Nothing.
    Free,
    /// Around `mean`, with this standard deviation.
    Near {
        /// Expected value.
        mean: f64,
        /// Standard deviation, above 0.
        sigma: f64,
    },
}

/// A place and what is known of it beforehand.
#[derive(Clone, Debug)]
pub struct PoseBlock {
    /// For messages.
    pub name: String,
    /// Where to start.
    pub parent_from_child: RigidTransform,
    /// What is known.
    pub prior: PosePrior,
}

/// What is known of a place beforehand.
#[derive(Clone, Debug, PartialEq)]
pub enum PosePrior {
    /// It is what it is.
    Fixed,
    /// Nothing.
    Free,
    /// Around `mean`.
    Near {
        /// Expected `parent_from_child`.
        mean: RigidTransform,
        /// Covariance of `[v, ω]`, m and rad.
        covariance: Box<Matrix6<f64>>,
    },
}

/// What one eye saw of one target at one instant.
#[derive(Clone, Debug)]
pub struct View {
    /// Number of the instant.
    pub instant: usize,
    /// Number of the lens.
    pub lens: usize,
    /// Numbers of the places from the rig to the eye, `parent_from_child` each.
    pub path: Vec<usize>,
    /// Number of the target's place in the world; none for the target that is the world.
    pub target: Option<usize>,
    /// Its points.
    pub points: Vec<Point>,
}

/// A point and where it was seen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Where it is, m.
    pub x_in_target: [f64; 3],
    /// Where it was seen.
    pub pixel: [f64; 2],
    /// Standard deviation of each coordinate of the pixel, relative to the others' at least.
    pub sigma_px: f64,
}

/// Why there is no solution.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AdjustError {
    /// A number that nothing says anything about: record other views, or give it a prior.
    #[error(
        "adjusting cameras: {name} is not determined by {views} views, expected views that show it or a prior"
    )]
    Undetermined {
        /// Which.
        name: String,
        /// How many views there are.
        views: usize,
    },
    /// The start is so far off that points have no pixels: start elsewhere.
    #[error(
        "adjusting cameras: {seen} of {all} points can be projected from the start, expected most of them"
    )]
    Start {
        /// How many can be projected.
        seen: usize,
        /// How many there are.
        all: usize,
    },
}

/// One free number of a problem.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Parameter {
    /// A parameter of a lens, by the number of the lens and its own.
    Lens(usize, usize),
    /// A coordinate of `[v, ω]` of a place, by the number of the place and its own.
    Pose(usize, usize),
}

impl Problem {
    /// The numbers that are not fixed, in the order of [`Covariance`]: lenses first.
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

    /// The name of a number, as messages have it.
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
                    "turn about x",
                    "turn about y",
                    "turn about z",
                ][k];
                format!("{what} of {}", self.poses[i].name)
            }
        }
    }

    /// How many points were seen.
    pub fn points(&self) -> usize {
        self.views.iter().map(|view| view.points.len()).sum()
    }
}

impl LensBlock {
    /// A lens of which nothing is known beforehand.
    pub fn free(name: &str, model: CameraModel) -> Self {
        Self {
            name: name.to_owned(),
            model,
            priors: vec![Prior::Free; model.parameters().len()],
        }
    }

    /// A lens that stays what it is.
    pub fn fixed(name: &str, model: CameraModel) -> Self {
        Self {
            priors: vec![Prior::Fixed; model.parameters().len()],
            ..Self::free(name, model)
        }
    }
}

impl PosePrior {
    /// With one sigma for all translations, m, and one for all rotations, rad.
    pub fn near(mean: RigidTransform, sigma_m: f64, sigma_rad: f64) -> Self {
        let (v, w) = (sigma_m * sigma_m, sigma_rad * sigma_rad);
        Self::Near {
            mean,
            covariance: Box::new(Matrix6::from_diagonal(&Vector6::new(v, v, v, w, w, w))),
        }
    }
}
