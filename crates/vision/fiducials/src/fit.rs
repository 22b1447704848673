//! Fit of a tag's pose to the gray values of one or more eyes.
//!
//! Unknown are the pose, common to all eyes; the blur of lens and sensor; the exponent of the tone
//! curve; and gray levels of black and white of each eye. Damped Gauss-Newton with robust weights;
//! blur by motion follows from the motion of the tag. The tone curve matters: without it, edges
//! between blurred cells move into the black (a fifth of a pixel for sRGB), and the tag is too
//! small.

use cad_transforms::RigidTransform;
use nalgebra::Matrix6;

use crate::align::Aligner;
use crate::cells::Cells;
use crate::config::Config;
use crate::linearization::{Linearization, Patterns, Problem, State};
use crate::moments::Moments;
use crate::patch::{Patch, Selection, Window};
use crate::planar_pose::mirrored;
use crate::residuals::Evaluation;
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
    let mut start = *start;
    let mut problem = fitter.problem(&start, &all)?;
    let mut patterns = problem.patterns(&start, 0.0)?;
    if let Some(aligned) = fitter.align(&start, &problem, &patterns) {
        start = aligned;
        if !fitter.windows.iter().all(|own| own.covers(tag, &aligned)) {
            drop(problem);
            fitter.windows = windows(views, tag, &aligned);
        }
        problem = fitter.problem(&start, &all)?;
        patterns = problem.patterns(&start, 0.0)?;
    }
    let state = problem.start(&start, 0.0, &patterns)?;
    // Pixels are selected by the pose, the blur and what hides the tag: again once these are known.
    let first = fitter.solve(&problem, state, config.first_convergence_cells, None)?;
    let shown = fitter.shown(&problem, &first.state)?;
    let patches = match fitter.keeps_pixels(&start, &first.state, &shown) {
        true => problem
            .patches
            .iter()
            .map(|own| own.patch.clone())
            .collect(),
        false => fitter.patches(&first.state.pose, &shown.selections),
    };
    let state = problem.state_with(&first.state, &patches);
    let at = (&first.state.pose, first.state.log_blur);
    let problem = problem.with_patches(patches, at)?;
    let second = fitter.solve(&problem, state?, config.convergence_cells, None)?;
    let other = fitter.other(&problem, &second);
    let (best, other) = match other {
        Some((other, excess)) if excess < 0.0 => (other, Some((second, -excess))),
        other => (second, other),
    };
    let shown = fitter.shown(&problem, &best.state)?;
    let is_blurred = best.at.motion_cells > config.blurred_cells;
    let least_share = config.min_agreeing_share[usize::from(is_blurred)];
    if shown.wrong_bits > config.max_wrong_bits || shown.agreeing_share < least_share {
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
        visible_share: shown.visible_share,
        wrong_bits: shown.wrong_bits,
        agreeing_share: shown.agreeing_share,
        other: other
            .filter(|(_, excess)| *excess < config.max_excess_cost)
            .and_then(minimum),
    })
}

/// The pose of a tag that is known to a tenth of a cell, and of which these eyes show the whole:
/// without a check of its code, and without a second pose.
pub fn refine(
    views: &[View<'_>],
    tag: &Tag,
    pose: &RigidTransform,
    motion: &Motion,
    config: &Config,
) -> Option<RigidTransform> {
    let fitter = Fitter {
        views: views.len(),
        windows: windows(views, tag, pose),
        tag,
        motion,
        config,
    };
    let all = vec![Selection::all(tag, config); views.len()];
    let problem = fitter.problem(pose, &all)?;
    let state = problem.start(pose, 0.0, &problem.patterns(pose, 0.0)?)?;
    let solution = fitter.solve(&problem, state, config.convergence_cells, None)?;
    Some(solution.state.pose)
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

/// A converged fit.
struct Solution {
    state: State,
    evaluation: Evaluation,
    /// Of a pixel, levels.
    noise: f64,
    at: Linearization,
}

/// What the eyes show of a tag.
struct Visibility {
    /// What counts, by view.
    selections: Vec<Selection>,
    visible_share: Vec<f64>,
    wrong_bits: u32,
    agreeing_share: f64,
}

/// Above which cost, for pixels with a noise, the fit of a second pose is given up.
struct Limit {
    cost: f64,
    noise: f64,
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
    fn problem(&self, start: &RigidTransform, selections: &[Selection]) -> Option<Problem<'a>> {
        let patches = self.patches(start, selections);
        Problem::new(patches, self.tag, self.motion, self.config, (start, 0.0))
    }

    /// A start from which the fit converges, if this one is not.
    fn align(
        &self,
        start: &RigidTransform,
        problem: &Problem<'_>,
        patterns: &[Patterns],
    ) -> Option<RigidTransform> {
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

    /// Whether the pixels that were selected at a start would hardly differ after the fit.
    fn keeps_pixels(&self, start: &RigidTransform, state: &State, shown: &Visibility) -> bool {
        let moved = start.inverse() * state.pose;
        let ([a, b, c], [x, y, z]) = (moved.rotation_vector(), moved.translation_m());
        let is_hidden = |own: &Selection| own.is_hidden.contains(&true);
        self.corner_motion([a, b, c, x, y, z]) < self.config.kept_cells
            && state.log_blur.abs() < self.config.kept_log_blur
            && !shown.selections.iter().any(is_hidden)
    }

    /// The pose near a state: converged when the corners move by less than some cells.
    fn solve(
        &self,
        problem: &Problem<'_>,
        mut state: State,
        converged: f64,
        limit: Option<Limit>,
    ) -> Option<Solution> {
        let mut evaluation = problem.evaluate(&state)?;
        let mut noise = problem.noise(&evaluation);
        let mut at = problem.linearize(&state, &evaluation, noise);
        let mut damping = 1e-3;
        for _ in 0..self.config.max_iterations {
            let step = at.step(damping)?;
            if let Some(limit) = &limit {
                let scale = (noise / limit.noise).powi(2);
                let lower = self.config.give_up_ratio * scale * at.decrease(&step);
                if problem.cost(&evaluation, limit.noise) - lower > limit.cost {
                    return None;
                }
            }
            let motion = self.corner_motion(std::array::from_fn(|k| step[k]));
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
        Some(Solution {
            state,
            evaluation,
            noise,
            at,
        })
    }

    /// The solution with the tag tilted the other way, by the same pixels, and its cost above that
    /// of the first one with the same noise; `None` if there is no second minimum, or if its cost
    /// is too high.
    fn other(&self, problem: &Problem<'_>, first: &Solution) -> Option<(Solution, f64)> {
        let eye_from_reference = problem.patches.first()?.patch.view.eye_from_reference;
        let start = mirrored(&(eye_from_reference * first.state.pose), [0.0; 3])?;
        let start = eye_from_reference.inverse() * start;
        let cost = |evaluation: &Evaluation| problem.cost(evaluation, first.noise);
        let least = cost(&first.evaluation);
        let at_start = State {
            pose: start,
            ..first.state.clone()
        };
        let most = self.config.max_excess_cost;
        if cost(&problem.evaluate(&at_start)?) - least > START_EXCESS * most {
            return None;
        }
        let limit = Limit {
            cost: least + most,
            noise: first.noise,
        };
        let converged = self.config.convergence_cells;
        let other = self.solve(problem, at_start, converged, Some(limit))?;
        let between = first.state.pose.inverse() * other.state.pose;
        if between.angle_rad() < self.config.min_other_rad {
            return None;
        }
        let excess = cost(&other.evaluation) - least;
        Some((other, excess))
    }

    /// What each eye shows of the tag at a state.
    fn shown(&self, problem: &Problem<'_>, state: &State) -> Option<Visibility> {
        let (tag, motion) = (self.tag, self.motion);
        let mut shown = Visibility {
            selections: vec![Selection::all(tag, self.config); self.views],
            visible_share: vec![0.0; self.views],
            wrong_bits: u32::MAX,
            agreeing_share: 0.0,
        };
        for (own, levels) in problem.patches.iter().zip(&state.levels) {
            let eye = own.patch.eye;
            let window = self.windows.iter().find(|own| own.eye == eye)?;
            let fitted = (state, levels);
            let cells = Cells::new(window, own, tag, fitted, motion, self.config.blurred_cells);
            shown.visible_share[eye] = cells.visible_share();
            shown.wrong_bits = shown.wrong_bits.min(cells.wrong_bits(tag));
            shown.agreeing_share = cells.agreeing_share().max(shown.agreeing_share);
            shown.selections[eye] = Selection {
                blur_px: self.config.blur_px * libm::exp(state.log_blur),
                is_hidden: cells.is_hidden(),
            };
        }
        Some(shown)
    }

    /// Motion of the corners by a step, cells.
    fn corner_motion(&self, step: [f64; 6]) -> f64 {
        let tilt = libm::hypot(step[0], step[1]);
        let turn = (TILT_SHARE * tilt + step[2].abs()) * self.tag.half_square_cells();
        let along = TILT_SHARE * step[5].abs();
        turn + (libm::hypot(step[3], step[4]) + along) / self.tag.cell_m()
    }
}

#[cfg(test)]
mod tests;
