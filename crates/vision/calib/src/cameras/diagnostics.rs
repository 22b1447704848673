//! Gates of a calibration, applied before anything is written.
//!
//! Contract: a result whose stated sigmas cannot be trusted has a finding. Each check documents its
//! statistic and its significance; the limits are in [`CheckConfig`].

use camera_models::Lens;
use nalgebra::{DVector, Matrix6, Vector2, Vector6};

use super::config::{CheckConfig, Config};
use super::finding::{Finding, Severity};
use super::input::{Camera, Input};
use super::result::{Calibration, RigPoses};
use crate::adjust::{
    self, Parameter, PosePrior, Problem, Solution, View, reduced_equations, solve, step_between,
};

/// Median of chi-squared with six degrees of freedom.
const CHI6_MEDIAN: f64 = 5.348;

/// All findings, worst first.
pub(super) fn findings(calibration: &Calibration) -> Vec<Finding> {
    let mut all = Vec::new();
    let input = &calibration.input;
    for (eye, coverage) in calibration.coverage.iter().enumerate() {
        let name = &input.eyes[eye].name;
        let missing = coverage.missing(&calibration.config.coverage).into_iter();
        all.extend(missing.map(|m| Finding::new(Severity::Warn, format!("{name}: {m}"))));
        lens(calibration, eye, &mut all);
    }
    for (number, camera) in input.cameras.iter().enumerate() {
        pair(calibration, number, camera, &mut all);
    }
    rig(calibration, &mut all);
    for (target, sagitta) in calibration.sagitta_m.iter().enumerate() {
        if *sagitta != 0.0 {
            let severity = match sagitta.abs() > calibration.config.checks.max_sagitta_m {
                true => Severity::Fail,
                false => Severity::Warn,
            };
            all.push(Finding::new(
                severity,
                format!(
                    "target {target} is not flat: its middle is {:.1} mm {} its rim, which was taken into account; \
                     expected a flat board",
                    1e3 * sagitta.abs(),
                    if *sagitta < 0.0 { "over" } else { "under" },
                ),
            ));
        }
    }
    all.extend(motion_during_recording(calibration));
    all.sort_by_key(|f| std::cmp::Reverse(f.severity));
    all
}

/// Finding on intrinsics that differ from the factory file.
fn factory_deviation(calibration: &Calibration, eye: usize) -> Option<Finding> {
    let description = &calibration.input.eyes[eye];
    let factory = description.factory?.parameters();
    let found = calibration.lens(eye).parameters();
    let width = f64::from(description.size.0);
    let share = |k: usize| (found[k] - factory[k]).abs() / if k < 2 { factory[k] } else { width };
    let worst = (0..4).max_by(|&a, &b| share(a).total_cmp(&share(b)))?;
    let [warn, fail] = calibration.config.checks.factory_deviation;
    let severity = match share(worst) {
        s if s > fail => Severity::Fail,
        s if s > warn => Severity::Warn,
        _ => return None,
    };
    let name = ["fx", "fy", "cx", "cy"][worst];
    Some(Finding::new(
        severity,
        format!(
            "{}: {name} is estimated as {:.1} px, the factory file has {:.1} px: is it the file of this camera \
             and this resolution?",
            description.name, found[worst], factory[worst]
        ),
    ))
}

/// Findings on large residuals, and on a lens that is poorly constrained at the image border.
fn lens(calibration: &Calibration, eye: usize, all: &mut Vec<Finding>) {
    all.extend(factory_deviation(calibration, eye));
    let name = &calibration.input.eyes[eye].name;
    let rms = calibration.solution.rms_px(|view| view.lens == eye);
    let [warn, fail] = calibration.config.checks.rms_px;
    if rms > warn {
        let severity = if rms > fail {
            Severity::Fail
        } else {
            Severity::Warn
        };
        all.push(Finding::new(
            severity,
            format!("{name}: residuals of {rms:.2} px RMS, expected below {warn} px"),
        ));
    }
    let (sigma, at) = worst_pixel(calibration, eye);
    let [warn, fail] = calibration.config.checks.pixel_sigma_px;
    if sigma > warn {
        let severity = if sigma > fail {
            Severity::Fail
        } else {
            Severity::Warn
        };
        all.push(Finding::new(
            severity,
            format!(
                "{name}: the lens is known to {sigma:.1} px only at pixel ({:.0}, {:.0}), expected below {warn} px: \
                 more views, nearer to the border and tilted",
                at[0], at[1]
            ),
        ));
    }
}

/// Largest sigma of the pixel of a given direction over the image, and its pixel.
pub(super) fn worst_pixel(calibration: &Calibration, eye: usize) -> (f64, [f64; 2]) {
    let model = calibration.lens(eye);
    let lens = Lens::new(model);
    let count = model.parameters().len();
    let covariance = calibration.covariance();
    let (w, h) = (f64::from(model.width - 1), f64::from(model.height - 1));
    let mut worst = (0.0, [0.0, 0.0]);
    for i in 0..=8 {
        for j in 0..=6 {
            let pixel = [w * f64::from(i) / 8.0, h * f64::from(j) / 6.0];
            let projected = lens
                .unproject(pixel)
                .and_then(|d| lens.project_with_jacobians(d));
            let Some(projected) = projected else {
                return (f64::INFINITY, pixel);
            };
            let by: Vec<(Parameter, Vector2<f64>)> = (0..count)
                .map(|k| {
                    let by = projected.by_parameters.column(k).into_owned();
                    (Parameter::Lens(eye, k), by)
                })
                .collect();
            let variances = covariance.of(&by).diagonal();
            let sigma = variances.max().max(0.0).sqrt();
            if sigma > worst.0 {
                worst = (sigma, pixel);
            }
        }
    }
    worst
}

/// Largest sigma of a pose: m, degrees.
fn sigmas(covariance: &Matrix6<f64>) -> (f64, f64) {
    let sigma = |range: std::ops::Range<usize>| {
        range
            .map(|k| covariance[(k, k)].max(0.0).sqrt())
            .fold(0.0, f64::max)
    };
    (sigma(0..3), sigma(3..6).to_degrees())
}

fn uncertain_pose(
    what: &str,
    covariance: &Matrix6<f64>,
    limits_m: [f64; 2],
    limits_deg: [f64; 2],
) -> Option<Finding> {
    let (metres, degrees) = sigmas(covariance);
    let over = |k: usize| metres > limits_m[k] || degrees > limits_deg[k];
    let severity = match (over(1), over(0)) {
        (true, _) => Severity::Fail,
        (_, true) => Severity::Warn,
        _ => return None,
    };
    Some(Finding::new(
        severity,
        format!(
            "{what} is known to {:.2} mm and {degrees:.3} degrees only, expected {} mm and {} degrees: \
             more views that both see",
            1e3 * metres,
            1e3 * limits_m[0],
            limits_deg[0]
        ),
    ))
}

/// Checks of one stereo camera: swapped eyes, baseline against its nominal value, uncertainty of
/// the extrinsics.
fn pair(calibration: &Calibration, number: usize, camera: &Camera, all: &mut Vec<Finding>) {
    let Some(pose) = calibration.poses.pairs[number] else {
        return;
    };
    let checks = &calibration.config.checks;
    let (left_from_right, covariance) = calibration.pose(pose);
    let name = &camera.name;
    let what = format!("{name}: the pose of the right eye");
    all.extend(uncertain_pose(
        &what,
        &covariance,
        checks.stereo_sigma_m,
        checks.stereo_sigma_deg,
    ));
    let along = left_from_right.translation_m()[0];
    let baseline = left_from_right.distance_m();
    if along < -0.5 * baseline {
        all.push(Finding::new(
            Severity::Fail,
            format!(
                "{name}: the right eye is {:.1} mm to the left of the left one: left and right are swapped",
                -1e3 * along
            ),
        ));
    }
    if let Some(prior) = &camera.left_from_right {
        let expected = prior.transform.distance_m();
        let off = baseline / expected - 1.0;
        let sigma = sigmas(&covariance).0 / expected;
        if off.abs() > checks.max_length_ratio.max(checks.max_length_sigma * sigma) {
            all.push(Finding::new(
                Severity::Fail,
                format!(
                    "{name}: the baseline is estimated as {:.2} mm, the factory file has {:.2} mm ({:+.1} %): \
                     is the target's size what its file says?",
                    1e3 * baseline,
                    1e3 * expected,
                    1e2 * off
                ),
            ));
        }
    }
}

/// Checks of the rig: uncertainty between cameras, and cameras that contradict the rig file.
fn rig(calibration: &Calibration, all: &mut Vec<Finding>) {
    let checks = &calibration.config.checks;
    let cameras = &calibration.input.cameras;
    let names: Vec<&str> = (0..cameras.len())
        .filter(|&c| calibration.poses.cameras[c].is_none())
        .map(|c| cameras[c].name.as_str())
        .collect();
    if !names.is_empty() && cameras.len() > 1 {
        let others = match calibration.input.origin() {
            Some(origin) => format!("{}, the origin", cameras[origin].name),
            None => "the other cameras".to_owned(),
        };
        all.push(Finding::new(
            Severity::Fail,
            format!(
                "{} could not be connected with {others}: never did it and another camera see \
                 targets at the same instant",
                names.join(", ")
            ),
        ));
    }
    let first = (0..cameras.len()).find(|&c| calibration.poses.cameras[c].is_some());
    for (number, camera) in cameras.iter().enumerate() {
        let (Some(first), Some(pose)) = (first, calibration.poses.cameras[number]) else {
            continue;
        };
        if number != first
            && let Some((_, covariance)) = calibration.left_from_left(first, number)
        {
            let what = format!("the pose of {} in {}", camera.name, cameras[first].name);
            all.extend(uncertain_pose(
                &what,
                &covariance,
                checks.rig_sigma_m,
                checks.rig_sigma_deg,
            ));
        }
        let Some(prior) = &camera.rig_from_left else {
            continue;
        };
        let found = calibration.pose(pose).0;
        let off = step_between(&prior.transform, &found);
        let sigmas_off = mahalanobis(&off, &prior.covariance);
        if sigmas_off > checks.prior_sigma {
            let rotation_deg = nalgebra::Vector3::new(off[3], off[4], off[5])
                .norm()
                .to_degrees();
            let translation_mm = 1e3 * nalgebra::Vector3::new(off[0], off[1], off[2]).norm();
            all.push(Finding::new(
                Severity::Warn,
                format!(
                    "{} is not where the rig file has it: rotated by {rotation_deg:.2} degrees and displaced by {translation_mm:.1} mm, \
                     {sigmas_off:.0} times what its tolerance allows",
                    camera.name
                ),
            ));
        }
    }
}

/// Mahalanobis length of a step, per coordinate.
pub(super) fn mahalanobis(step: &Vector6<f64>, covariance: &Matrix6<f64>) -> f64 {
    let Some(cholesky) = covariance.cholesky() else {
        return 0.0;
    };
    (step.dot(&cholesky.solve(step)) / 6.0).max(0.0).sqrt()
}

/// Extrinsics that changed during the recording. With constant extrinsics, the cumulative sum of
/// the scores of the instants is a Brownian bridge over time; a change makes it exceed its limit
/// (CUSUM; Nyblom 1989). The scores are scaled by the median of the instants, so that a change does
/// not hide itself.
fn motion_during_recording(calibration: &Calibration) -> Vec<Finding> {
    let solution = &calibration.solution;
    let problem = &solution.problem;
    let config = &calibration.config;
    let checks = &config.checks;
    let equations = reduced_equations(problem, solution.scale, &config.solver);
    let parameters = problem.parameters();
    let begin = |pose: usize| {
        parameters
            .iter()
            .position(|p| *p == Parameter::Pose(pose, 0))
    };
    let input = &calibration.input;
    let mut named: Vec<(String, usize)> = Vec::new();
    for (number, camera) in input.cameras.iter().enumerate() {
        let poses = &calibration.poses;
        named.extend(poses.pairs[number].map(|p| (format!("the right eye of {}", camera.name), p)));
        named.extend(poses.cameras[number].map(|p| (camera.name.clone(), p)));
    }
    let mut worst: Option<(f64, String, usize, usize)> = None;
    for (name, pose) in named {
        let Some(begin) = begin(pose) else { continue };
        let mut scores: Vec<(usize, Vector6<f64>, Matrix6<f64>)> = Vec::new();
        for (instant, equations) in equations.iter().enumerate() {
            let Ok(at) = equations.columns.binary_search(&begin) else {
                continue;
            };
            scores.push((
                instant,
                equations.score.fixed_rows::<6>(at).into_owned(),
                equations
                    .information
                    .fixed_view::<6, 6>(at, at)
                    .into_owned(),
            ));
        }
        if let Some((excursion, instant)) = bridge_maximum(&scores, checks)
            && excursion > checks.max_bridge
            && worst.as_ref().is_none_or(|w| excursion > w.0)
        {
            worst = Some((excursion, name, pose, instant));
        }
    }
    let Some((_, name, pose, instant)) = worst else {
        return Vec::new();
    };
    let used = calibration.instant_of(instant);
    let seconds = 1e-9 * (input.times_ns[used] - input.times_ns[0]) as f64;
    let Some((metres, degrees)) = jump(solution, pose, instant, config) else {
        return Vec::new();
    };
    if metres < checks.min_motion_m && degrees < checks.min_motion_deg {
        return Vec::new();
    }
    vec![Finding::new(
        Severity::Fail,
        format!(
            "{name} moved during the recording, about {seconds:.0} s after its first frame, by {degrees:.2} degrees \
             and {:.1} mm: tighten it and record again",
            1e3 * metres
        ),
    )]
}

/// Maximum of the bridge, normalized, and its instant.
fn bridge_maximum(
    scores: &[(usize, Vector6<f64>, Matrix6<f64>)],
    checks: &CheckConfig,
) -> Option<(f64, usize)> {
    if scores.len() < checks.min_bridge_instants {
        return None;
    }
    let chi: Vec<f64> = scores
        .iter()
        .filter_map(|(_, score, information)| {
            Some(score.dot(&information.cholesky()?.solve(score)))
        })
        .collect();
    let mut sorted = chi;
    sorted.sort_by(f64::total_cmp);
    let excess = (sorted.get(sorted.len() / 2)? / CHI6_MEDIAN).max(1.0);
    let total: Matrix6<f64> = scores.iter().map(|(_, _, i)| i).sum();
    let mean: Vector6<f64> = scores.iter().map(|(_, s, _)| s).sum();
    let root = total.cholesky()?.l();
    let (mut sum, mut seen) = (Vector6::zeros(), Matrix6::zeros());
    let mut worst = (0.0, 0);
    let whole = total.trace();
    for (instant, score, information) in scores {
        sum += score;
        seen += information;
        // The mean is not 0 if a prior contributes.
        let bridge = sum - mean * (seen.trace() / whole);
        let whitened = root.solve_lower_triangular(&bridge)? / excess.sqrt();
        let excursion = whitened.amax();
        if excursion > worst.0 {
            worst = (excursion, *instant);
        }
    }
    Some(worst)
}

/// Change of a pose from before to after an instant, m and degrees.
fn jump(solution: &Solution, pose: usize, instant: usize, config: &Config) -> Option<(f64, f64)> {
    let mut problem: Problem = solution.problem.clone();
    let before = problem.poses[pose].clone();
    for lens in &mut problem.lenses {
        lens.priors.fill(crate::adjust::Prior::Fixed);
    }
    for other in &mut problem.poses {
        other.prior = PosePrior::Fixed;
    }
    problem.poses[pose].prior = PosePrior::Free;
    let after = problem.poses.len();
    problem.poses.push(crate::adjust::PoseBlock {
        prior: PosePrior::Free,
        ..before
    });
    let later = |view: &&mut View| view.instant > instant;
    for view in problem.views.iter_mut().filter(later) {
        view.path
            .iter_mut()
            .filter(|p| **p == pose)
            .for_each(|p| *p = after);
    }
    let solver = adjust::Config {
        covariance: false,
        ..config.solver
    };
    let found = solve(&problem, &solver).ok()?;
    let poses = &found.problem.poses;
    let step = step_between(
        &poses[pose].parent_from_child,
        &poses[after].parent_from_child,
    );
    let step = DVector::from_column_slice(step.as_slice());
    Some((step.rows(0, 3).norm(), step.rows(3, 3).norm().to_degrees()))
}

/// The camera that contradicts its nominal pose most, beyond a fraction of the limit.
pub(super) fn inconsistent_prior(
    input: &Input,
    poses: &RigPoses,
    solution: &Solution,
    checks: &CheckConfig,
) -> Option<usize> {
    let limit = checks.prior_replacement_ratio * checks.prior_sigma;
    let off = |number: usize| {
        let pose = poses.cameras[number]?;
        let prior = input.cameras[number].rig_from_left.as_ref()?;
        let block = &solution.problem.poses[pose];
        // A prior that was rejected before has been replaced.
        let PosePrior::Near { covariance, .. } = &block.prior else {
            return None;
        };
        (**covariance == prior.covariance).then(|| {
            let step = step_between(&prior.transform, &block.parent_from_child);
            (number, mahalanobis(&step, &prior.covariance))
        })
    };
    (0..input.cameras.len())
        .filter_map(off)
        .filter(|(_, sigmas_off)| *sigmas_off > limit)
        .max_by(|a, b| a.1.total_cmp(&b.1))
        .map(|(number, _)| number)
}
