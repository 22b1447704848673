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
use crate::moments::Moments;
use crate::patch::{Patch, Selection, Window};
use crate::planar_pose::mirrored;
use crate::tag::Tag;
use crate::view::{Motion, PlanePoint, View};

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
    /// Share of the cells that agree with the code, relative to what blur leaves of them, in the
    /// eye in which most do. Bits that are blurred into each other do not contradict a code, but
    /// cells of another one do not agree with it either.
    pub agreeing_share: f64,
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
/// Convergence before pixels are selected again, as a multiple of that after it.
const FIRST_CONVERGENCE: f64 = 10.0;
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
    let mut fitter = Fitter {
        views: views.len(),
        windows: windows(views, tag, start),
        tag,
        motion,
        config,
    };
    let all = vec![Selection::all(tag, config); views.len()];
    let mut start = Start::at(*start);
    let mut problem = fitter.problem(&start, &all)?;
    if let Some(aligned) = fitter.align(&start.pose, &problem) {
        start = Start::at(aligned);
        if !fitter.windows.iter().all(|own| own.covers(tag, &aligned)) {
            drop(problem);
            fitter.windows = windows(views, tag, &aligned);
        }
        problem = fitter.problem(&start, &all)?;
    }
    // Pixels are selected by the pose, the blur and what hides the tag: again once these are known.
    let first = fitter.solve(&problem, &start, FIRST_CONVERGENCE)?;
    let start = first.as_start();
    let patches = fitter.patches(&start.pose, &first.selections);
    let problem = problem.with_patches(patches, (&start.pose, start.log_blur))?;
    let second = fitter.solve(&problem, &start, 1.0)?;
    let other = fitter.other(&problem, &second);
    let (best, other) = match other {
        Some((other, excess)) if excess < 0.0 => (other, Some((second, -excess))),
        other => (second, other),
    };
    let is_blurred = best.at.motion_cells > config.blurred_cells;
    let least_share = config.min_agreeing_share[usize::from(is_blurred)];
    if best.wrong_bits > config.max_wrong_bits || best.agreeing_share < least_share {
        return None;
    }
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
        agreeing_share: best.agreeing_share,
        other: other
            .filter(|(_, excess)| *excess < config.max_excess_cost)
            .and_then(minimum),
    })
}

/// Pixels around a tag, of the eyes that see it.
fn windows<'a>(views: &[View<'a>], tag: &Tag, pose: &RigidTransform) -> Vec<Window<'a>> {
    let views = views.iter().enumerate();
    views
        .filter_map(|view| Window::new(view, tag, pose))
        .collect()
}

struct Fitter<'a> {
    /// Number of views.
    views: usize,
    /// Of those that see the tag.
    windows: Vec<Window<'a>>,
    tag: &'a Tag,
    motion: &'a Motion,
    config: &'a Config,
}

/// Where a fit starts.
struct Start {
    pose: RigidTransform,
    log_blur: f64,
    tone: Option<f64>,
}

impl Start {
    fn at(pose: RigidTransform) -> Self {
        Self {
            pose,
            log_blur: 0.0,
            tone: None,
        }
    }
}

/// A converged fit.
struct Solution {
    state: State,
    at: Linearization,
    /// What counts after it, by view.
    selections: Vec<Selection>,
    visible_share: Vec<f64>,
    wrong_bits: u32,
    agreeing_share: f64,
}

impl Solution {
    fn as_start(&self) -> Start {
        Start {
            pose: self.state.pose,
            log_blur: self.state.log_blur,
            tone: Some(self.state.tone),
        }
    }
}

impl<'a> Fitter<'a> {
    /// Selected pixels near a pose, of the eyes that show enough of the tag.
    fn patches(&self, pose: &RigidTransform, selections: &[Selection]) -> Vec<Patch<'a>> {
        let (tag, motion, config) = (self.tag, self.motion, self.config);
        let windows = self.windows.iter();
        windows
            .filter_map(|own| Patch::new(own, tag, pose, motion, &selections[own.eye], config))
            .collect()
    }

    /// Selected pixels near a start, and the pattern there; `None` if no eye shows enough.
    fn problem(&self, start: &Start, selections: &[Selection]) -> Option<Problem<'a>> {
        let patches = self.patches(&start.pose, selections);
        let (tag, motion, config) = (self.tag, self.motion, self.config);
        let at = (&start.pose, start.log_blur);
        Problem::new(patches, tag, motion, config, at)
    }

    /// A start from which the fit converges, if this one is not.
    fn align(&self, start: &RigidTransform, problem: &Problem<'_>) -> Option<RigidTransform> {
        let patterns = problem.patterns(start, 0.0)?;
        let correlations = patterns.iter().map(|of_patch| {
            let mut moments = Moments::default();
            for [pattern, level] in of_patch {
                moments.add(f64::from(*pattern), f64::from(*level));
            }
            moments.correlation()
        });
        if correlations.fold(1.0, f64::min) > self.config.min_start_correlation {
            return None;
        }
        let patches: Vec<&Patch<'_>> = problem.patches.iter().map(|own| &own.patch).collect();
        let aligner = Aligner {
            patches: &patches,
            tag: self.tag,
            motion: self.motion,
        };
        Some(aligner.align(start))
    }

    /// The pose near a start; `convergence` as a multiple of the configured one.
    fn solve(&self, problem: &Problem<'_>, start: &Start, convergence: f64) -> Option<Solution> {
        let patterns = problem.patterns(&start.pose, start.log_blur)?;
        let mut state = problem.start(&start.pose, start.log_blur, &patterns)?;
        state.tone = start.tone.unwrap_or(state.tone);
        let mut evaluation = problem.evaluate(&state)?;
        let mut noise = problem.noise(&evaluation);
        let mut at = problem.linearize(&state, &evaluation, noise);
        let mut damping = 1e-3;
        let converged = convergence * self.config.convergence_cells;
        for _ in 0..self.config.max_iterations {
            let step = at.step(damping)?;
            let motion = self.corner_motion(&step);
            let moved = state.after(&step)?;
            let least = problem.cost(&evaluation, noise);
            let next = problem.evaluate(&moved);
            let Some(next) = next.filter(|next| problem.cost(next, noise) <= least) else {
                // Values and gradients of a table agree to so much.
                if motion < converged.max(self.config.rejected_cells) {
                    break;
                }
                damping *= 8.0;
                continue;
            };
            (state, evaluation) = (moved, next);
            damping *= 0.2;
            // Noise is overestimated before convergence.
            let lower = problem.noise(&evaluation);
            let is_settled = lower > 0.9 * noise;
            noise = lower;
            at = problem.linearize(&state, &evaluation, noise);
            if motion < converged && is_settled {
                break;
            }
        }
        self.solution(problem, state, at)
    }

    /// The solution with the tag tilted the other way, by the same pixels, and its cost above that
    /// of the first one with the same noise; `None` if there is no second minimum.
    fn other(&self, problem: &Problem<'_>, first: &Solution) -> Option<(Solution, f64)> {
        let eye_from_reference = problem.patches.first()?.patch.view.eye_from_reference;
        let start = mirrored(&(eye_from_reference * first.state.pose), [0.0; 3])?;
        let start = eye_from_reference.inverse() * start;
        let evaluation = problem.evaluate(&first.state)?;
        let noise = problem.noise(&evaluation);
        let cost = |state: &State| Some(problem.cost(&problem.evaluate(state)?, noise));
        let least = problem.cost(&evaluation, noise);
        let at_start = State {
            pose: start,
            ..first.state.clone()
        };
        if cost(&at_start)? - least > START_EXCESS * self.config.max_excess_cost {
            return None;
        }
        let from = Start {
            pose: start,
            ..first.as_start()
        };
        let other = self.solve(problem, &from, 1.0)?;
        let between = first.state.pose.inverse() * other.state.pose;
        if between.angle_rad() < self.config.min_other_rad {
            return None;
        }
        let excess = cost(&other.state)? - least;
        Some((other, excess))
    }

    /// The solution with what each eye sees of the tag.
    fn solution(&self, problem: &Problem<'_>, state: State, at: Linearization) -> Option<Solution> {
        let (tag, motion, pose) = (self.tag, self.motion, &state.pose);
        let mut selections = vec![Selection::all(tag, self.config); self.views];
        let mut visible_share = vec![0.0; self.views];
        let (mut wrong_bits, mut agreeing_share) = (u32::MAX, 0.0);
        for (own, levels) in problem.patches.iter().zip(&state.levels) {
            let eye = own.patch.eye;
            let window = self.windows.iter().find(|own| own.eye == eye)?;
            let tone = levels.tone(state.tone);
            let light = |point: &PlanePoint| own.pattern(tag, point.at, state.log_blur).value;
            let is_moving = own.blur.motion_cells() > self.config.blurred_cells;
            let light = (light, (own.blur.own_share(), is_moving));
            let cells = Cells::new(window, tag, pose, motion, (levels, &tone), light);
            visible_share[eye] = cells.visible_share();
            wrong_bits = wrong_bits.min(cells.wrong_bits(tag));
            agreeing_share = cells.agreeing_share().max(agreeing_share);
            selections[eye] = Selection {
                blur_px: self.config.blur_px * libm::exp(state.log_blur),
                is_hidden: cells.is_hidden(),
            };
        }
        Some(Solution {
            state,
            at,
            selections,
            visible_share,
            wrong_bits,
            agreeing_share,
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
