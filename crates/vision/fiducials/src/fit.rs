//! Fit of a tag's pose to the gray values of one or more eyes.
//!
//! Unknown are the pose, common to all eyes; the blur of lens and sensor; the exponent of the tone
//! curve; and gray levels of black and white of each eye. Damped Gauss-Newton with robust weights;
//! blur by motion follows from the motion of the tag. The tone curve matters: without it, edges
//! between blurred cells move into the black (a fifth of a pixel for sRGB), and the tag is too
//! small.

use cad_transforms::RigidTransform;
use nalgebra::{DVector, Matrix6};

use crate::align::Aligner;
use crate::cells::Cells;
use crate::config::Config;
use crate::linearization::{Linearization, Problem, State};
use crate::patch::{Patch, Selection};
use crate::planar_pose::mirrored;
use crate::tag::Tag;
use crate::view::{Motion, View};

/// A fitted tag.
#[derive(Clone, Debug)]
pub struct Fit {
    /// Takes points of the tag to the reference frame, at the middle row of the images.
    pub reference_from_tag: RigidTransform,
    /// Covariance of a small motion of the tag in its own frame: rotation, rad, then translation,
    /// m.
    pub covariance: Matrix6<f64>,
    /// Residual of the gray levels, RMS over the pixels that count, levels.
    pub rms_levels: f64,
    /// Share of the tag's cells, with margins, that are visible, by eye; 0 for an eye that was not
    /// used.
    pub visible_share: Vec<f64>,
    /// Bits that contradict the tag's code, in the eye in which fewest do.
    pub wrong_bits: u32,
    /// The tag tilted the other way, if its gray values contradict that hardly more.
    pub other: Option<Minimum>,
}

/// A second pose that explains the gray values of a tag.
#[derive(Clone, Debug)]
pub struct Minimum {
    /// Takes points of the tag to the reference frame, at the middle row of the images.
    pub reference_from_tag: RigidTransform,
    /// Covariance, as of [`Fit`].
    pub covariance: Matrix6<f64>,
    /// Robust cost minus that of the first pose, in units of the noise of pixels.
    pub excess_cost: f64,
}

/// Cost above that of the first pose at which the start of a second one is given up, relative to
/// the maximum after its fit.
const START_EXCESS: f64 = 10.0;
/// Rotation about the axes in the plane that moves a corner, relative to rotation in the plane.
const TILT_SHARE: f64 = 0.2;

/// Fits the pose of a tag that is near a start: within one and a half cells in the images. `None`
/// if too little of it is visible, or its gray values contradict it.
pub fn fit(
    views: &[View<'_>],
    tag: &Tag,
    start: &RigidTransform,
    motion: &Motion,
    config: &Config,
) -> Option<Fit> {
    let fitter = Fitter {
        views,
        tag,
        motion,
        config,
    };
    let all = vec![Selection::all(tag, config); views.len()];
    let aligned = fitter.align(start, &all)?;
    // Pixels are selected by the pose, the blur and what hides the tag: again once these are known.
    let first = fitter.solve(&aligned, &all)?;
    let second = fitter.solve(&first.state.pose, &first.selections)?;
    if second.wrong_bits > config.max_wrong_bits {
        return None;
    }
    let other = fitter.other(&second, &first.selections);
    let (best, other) = match other {
        Some((other, excess)) if excess < 0.0 => (other, Some((second, -excess))),
        other => (second, other),
    };
    let minimum = |(solution, excess_cost): (Solution, f64)| {
        Some(Minimum {
            reference_from_tag: solution.state.pose,
            covariance: solution.at.covariance(tag, config)?,
            excess_cost,
        })
    };
    Some(Fit {
        reference_from_tag: best.state.pose,
        covariance: best.at.covariance(tag, config)?,
        rms_levels: best.at.rms_levels,
        visible_share: best.visible_share,
        wrong_bits: best.wrong_bits,
        other: other
            .filter(|(_, excess)| *excess < config.max_excess_cost)
            .and_then(minimum),
    })
}

struct Fitter<'a> {
    views: &'a [View<'a>],
    tag: &'a Tag,
    motion: &'a Motion,
    config: &'a Config,
}

/// A converged fit.
struct Solution {
    state: State,
    at: Linearization,
    /// What counts after it, by view.
    selections: Vec<Selection>,
    visible_share: Vec<f64>,
    wrong_bits: u32,
    /// The views that were used.
    eyes: Vec<usize>,
}

impl<'a> Fitter<'a> {
    fn patches(&self, pose: &RigidTransform, selections: &[Selection]) -> Vec<Patch<'a>> {
        let views = self.views.iter().enumerate().zip(selections);
        views
            .filter_map(|(view, selection)| {
                Patch::new(view, self.tag, pose, self.motion, selection, self.config)
            })
            .collect()
    }

    /// A start from which the fit converges.
    fn align(&self, start: &RigidTransform, selections: &[Selection]) -> Option<RigidTransform> {
        let patches = self.patches(start, selections);
        let problem = self.problem(&patches);
        let evaluation = problem.evaluate(start, 0.0)?;
        if problem.correlation(&evaluation) > self.config.min_start_correlation {
            return Some(*start);
        }
        let aligner = Aligner {
            patches: &patches,
            tag: self.tag,
            motion: self.motion,
        };
        (!patches.is_empty()).then(|| aligner.align(start))
    }

    /// The pose near a start from the pixels that count.
    fn solve(&self, start: &RigidTransform, selections: &[Selection]) -> Option<Solution> {
        let patches = self.patches(start, selections);
        let problem = self.problem(&patches);
        let mut evaluation = problem.evaluate(start, 0.0)?;
        let mut state = problem.start(start, &evaluation)?;
        let mut noise = problem.noise(&state, &evaluation);
        let mut at = problem.linearize(&state, &evaluation, noise)?;
        let mut damping = 1e-3;
        for _ in 0..self.config.max_iterations {
            let step = at.step(damping)?;
            let moved = state.after(&step)?;
            let patterns = problem.evaluate(&moved.pose, moved.log_blur);
            let next = patterns.and_then(|patterns| {
                let next = problem.linearize(&moved, &patterns, noise)?;
                (next.cost <= at.cost).then_some((patterns, next))
            });
            let Some((patterns, next)) = next else {
                if damping > 1e5 {
                    break;
                }
                damping *= 8.0;
                continue;
            };
            (state, evaluation) = (moved, patterns);
            damping *= 0.2;
            let is_converged = self.corner_motion(&step) < self.config.convergence_cells;
            // Noise is overestimated before convergence.
            let lower = problem.noise(&state, &evaluation);
            let is_settled = lower > 0.9 * noise;
            noise = lower;
            at = match is_settled {
                true => next,
                false => problem.linearize(&state, &evaluation, noise)?,
            };
            if is_converged && is_settled {
                break;
            }
        }
        self.solution(&problem, state, at)
    }

    /// The solution with the tag tilted the other way, and its cost above that of the first one;
    /// `None` if there is no second minimum.
    fn other(&self, first: &Solution, selections: &[Selection]) -> Option<(Solution, f64)> {
        let eye_from_reference = self.views[*first.eyes.first()?].eye_from_reference;
        let start = mirrored(&(eye_from_reference * first.state.pose), [0.0; 3])?;
        let start = eye_from_reference.inverse() * start;
        // By the same pixels and the same noise.
        let patches = self.patches(&first.state.pose, selections);
        if !patches
            .iter()
            .map(|patch| patch.eye)
            .eq(first.eyes.iter().copied())
        {
            return None;
        }
        let problem = self.problem(&patches);
        let evaluation = problem.evaluate(&first.state.pose, first.state.log_blur)?;
        let noise = problem.noise(&first.state, &evaluation);
        let cost = |state: &State| {
            let evaluation = problem.evaluate(&state.pose, state.log_blur)?;
            Some(problem.linearize(state, &evaluation, noise)?.cost)
        };
        let least = cost(&first.state)?;
        let at_start = State {
            pose: start,
            ..first.state.clone()
        };
        if cost(&at_start)? - least > START_EXCESS * self.config.max_excess_cost {
            return None;
        }
        let other = self.solve(&start, selections)?;
        let between = first.state.pose.inverse() * other.state.pose;
        if between.angle_rad() < self.config.min_other_rad || other.eyes != first.eyes {
            return None;
        }
        let excess = cost(&other.state)? - least;
        Some((other, excess))
    }

    fn problem<'p>(&'p self, patches: &'p [Patch<'p>]) -> Problem<'p> {
        Problem {
            patches,
            tag: self.tag,
            motion: self.motion,
            config: self.config,
        }
    }

    /// The solution with what each eye sees of the tag.
    fn solution(&self, problem: &Problem<'_>, state: State, at: Linearization) -> Option<Solution> {
        let all = Selection::all(self.tag, self.config);
        let lens_px = self.config.blur_px * libm::exp(state.log_blur);
        let mut selections = vec![all.clone(); self.views.len()];
        let mut visible_share = vec![0.0; self.views.len()];
        let mut wrong_bits = u32::MAX;
        for (patch, levels) in problem.patches.iter().zip(&state.levels) {
            let view = (patch.eye, &patch.view);
            let (tag, motion) = (self.tag, self.motion);
            let whole = Patch::new(view, tag, &state.pose, motion, &all, self.config)?;
            let blur = problem.blur(patch, &state.pose, state.log_blur)?;
            let tone = levels.tone(state.tone);
            let cells = Cells::new(&whole, tag, &state.pose, motion, (&blur, levels, &tone));
            visible_share[patch.eye] = cells.visible_share();
            wrong_bits = wrong_bits.min(cells.wrong_bits(tag));
            selections[patch.eye] = Selection {
                blur_px: lens_px,
                is_hidden: cells.is_hidden(),
            };
        }
        Some(Solution {
            state,
            at,
            selections,
            visible_share,
            wrong_bits,
            eyes: problem.patches.iter().map(|patch| patch.eye).collect(),
        })
    }

    /// Motion of the corners by a step, cells.
    fn corner_motion(&self, step: &DVector<f64>) -> f64 {
        let tilt = libm::hypot(step[0], step[1]);
        let turn = (TILT_SHARE * tilt + step[2].abs()) * self.tag.half_square_cells();
        let along = TILT_SHARE * step[5].abs();
        turn + (libm::hypot(step[3], step[4]) + along) / self.tag.cell_m()
    }
}

#[cfg(test)]
mod tests;
