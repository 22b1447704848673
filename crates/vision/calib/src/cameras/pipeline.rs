//! The calibration pipeline: from target detections to a calibration.

use std::collections::BTreeMap;

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};
use nalgebra::{DMatrix, Matrix6};

use super::config::{Config, MotionConfig, PriorConfig};
use super::coverage::Coverage;
use super::finding::{Finding, Severity};
use super::initialization::{factory_priors, initial_lens, poses, weak_priors};
use super::input::Input;
use super::model_selection::{self, EyeViews, SelectedLens};
use super::points::points;
use super::pose_graph::{InitialPoses, PosedView, connect};
use super::result::{Calibration, CamerasError, RigPoses};
use super::target_view::{TargetView, median_displacement_px};
use super::{board_shape, diagnostics, view_clusters, view_selection};
use crate::adjust::{
    LensBlock, Point, PoseBlock, PosePrior, Prior, Problem, Solution, View, median_scale, solve,
};

/// Interval to which image motion is normalized, ns.
const MOTION_INTERVAL_NS: f64 = 1e8;

/// Runs the calibration. `progress` receives the current step and the completed fraction, from 0 to
/// 1.
///
/// # Errors
/// [`CamerasError`].
pub fn calibrate(
    input: Input,
    config: &Config,
    progress: &mut dyn FnMut(&str, f64),
) -> Result<Calibration, CamerasError> {
    let mut findings = Vec::new();
    progress("initializing lenses", 0.0);
    let mut starts = Vec::new();
    let mut target_views: Vec<TargetView> = Vec::new();
    for eye in 0..input.eyes.len() {
        let (start, own) = eye_views(&input, eye, config, &mut findings)?;
        starts.push(start);
        target_views.extend(own);
    }
    findings.extend(unknown_motion(&target_views, &config.motion));
    let mut chosen: Vec<Option<SelectedLens>> = vec![None; input.eyes.len()];
    let mut choices = Vec::new();
    let mut used: Vec<usize> = Vec::new();
    for (number, camera) in input.cameras.iter().enumerate() {
        let share = number as f64 / input.cameras.len() as f64;
        progress(
            &format!("selecting the lens model of {}", camera.name),
            0.1 + 0.5 * share,
        );
        let eyes: Vec<usize> = std::iter::once(camera.left).chain(camera.right).collect();
        let instants = most_informative(&input, &eyes, &starts, &target_views, config);
        let views: Vec<EyeViews<'_>> = eyes
            .iter()
            .map(|&eye| EyeViews {
                start: starts[eye],
                factory: input.eyes[eye].factory.as_ref(),
                views: of_instants(&target_views, eye, &instants),
            })
            .collect();
        let name = || input.eyes[camera.left].name.clone();
        let (choice, lenses) =
            model_selection::select_model(&views, config).ok_or_else(|| CamerasError::NoLens {
                eye: name(),
                rms_px: f64::INFINITY,
                limit_px: config.views.max_initial_rms_px,
            })?;
        choices.push(choice);
        for (eye, lens) in eyes.into_iter().zip(lenses) {
            chosen[eye] = Some(lens);
        }
        used.extend(instants);
    }
    progress("connecting cameras", 0.6);
    let chosen: Vec<SelectedLens> = chosen
        .into_iter()
        .zip(&starts)
        .map(|lens| selected_lens(lens, &config.priors))
        .collect();
    let posed: Vec<PosedView> = target_views.iter().map(|p| p.posed).collect();
    let known = connect(&input, &posed, &config.pose_graph);
    used.extend(bridges(&input, &target_views, config));
    used.sort_unstable();
    used.dedup();
    progress("bundle adjustment", 0.65);
    let mut build = assemble(&input, &target_views, &known, &chosen, &used, config);
    let clusters = view_clusters::assign_clusters(&target_views, config.views.cluster_px);
    build.problem.clusters = build.used.iter().map(|instant| clusters[instant]).collect();
    let first = solve(&build.problem, &config.solver.approximate())?;
    build.problem = first.problem.clone();
    reweight_views(&mut build.problem, &first, config.views.sigma_prior_corners);
    let mut solution = solve(&build.problem, &config.solver)?;
    // A camera that clearly contradicts its nominal pose must not bias the others.
    while let Some(camera) =
        diagnostics::inconsistent_prior(&input, &build.poses, &solution, &config.checks)
    {
        let pose = build.poses.cameras[camera].expect("only connected cameras are tested");
        let prior = input.cameras[camera]
            .rig_from_left
            .as_ref()
            .expect("its nominal pose is known");
        let near = weak_prior(prior.transform, &config.priors);
        build.problem.poses[pose].prior = near.clone();
        solution.problem.poses[pose].prior = near;
        solution = solve(&solution.problem, &config.solver)?;
    }
    progress("estimating the shape of the targets", 0.85);
    let (solution, sagitta_m) =
        board_shape::refine(solution, &input.targets, &build.targets, config)?;
    progress("checking", 0.95);
    let coverage = coverage(&input, &solution, config);
    let mut calibration = Calibration {
        config: *config,
        used: build.used,
        choices,
        solution,
        poses: build.poses,
        coverage,
        sagitta_m,
        findings: Vec::new(),
        input,
    };
    findings.extend(diagnostics::findings(&calibration));
    findings.sort_by_key(|f| std::cmp::Reverse(f.severity));
    calibration.findings = findings;
    progress("checking", 1.0);
    Ok(calibration)
}

/// Prior of extrinsics without a nominal value.
fn weak_prior(at: RigidTransform, config: &PriorConfig) -> PosePrior {
    let [sigma_m, sigma_rad] = config.extrinsics_sigma;
    PosePrior::near(at, sigma_m, sigma_rad)
}

/// Finding on frames too far apart in time to measure whether the rig was static.
fn unknown_motion(target_views: &[TargetView], config: &MotionConfig) -> Option<Finding> {
    let unknown = target_views
        .iter()
        .filter(|p| p.motion_px.is_none())
        .count();
    (2 * unknown > target_views.len()).then(|| {
        Finding::new(
            Severity::Warn,
            format!(
                "whether the rig was static is unknown for {unknown} of {} views, which follow no other within \
                 {} s: the result assumes that it was",
                target_views.len(),
                1e-9 * config.max_frame_interval_ns as f64
            ),
        )
    })
}

/// The selected lens; an eye without a camera keeps its initial lens. A lens without tangential
/// terms gets them back with a prior of their usual size: a single eye does not observe them, but
/// they bound the accuracy of the principal points and of the rotation between the eyes.
fn selected_lens(
    (chosen, start): (Option<SelectedLens>, &CameraModel),
    config: &PriorConfig,
) -> SelectedLens {
    let mut lens = chosen.unwrap_or_else(|| SelectedLens {
        model: *start,
        priors: weak_priors(start, &config.any_lens),
    });
    if let Distortion::Radial2 { k1, k2 } = lens.model.distortion {
        let (p1, p2) = (0.0, 0.0);
        lens.model.distortion = Distortion::RadTan4 { k1, k2, p1, p2 };
        let small = Prior::Near {
            mean: 0.0,
            sigma: config.tangential_sigma,
        };
        lens.priors.extend([small; 2]);
    }
    lens
}

/// Views of one eye with poses from an initial lens.
fn eye_views(
    input: &Input,
    eye: usize,
    config: &Config,
    findings: &mut Vec<Finding>,
) -> Result<(CameraModel, Vec<TargetView>), CamerasError> {
    let description = &input.eyes[eye];
    let min_corners = config.views.min_corners;
    let all: Vec<_> = input.detections.iter().filter(|s| s.eye == eye).collect();
    let seen: Vec<_> = all
        .iter()
        .map(|s| {
            (
                *s,
                points(
                    &input.targets[s.target],
                    &s.corners,
                    config.views.min_sigma_px,
                ),
            )
        })
        .filter(|(_, points)| points.len() >= min_corners)
        .collect();
    if seen.len() < config.views.min_views {
        return Err(CamerasError::TooFew {
            eye: description.name.clone(),
            found: seen.len(),
            expected: config.views.min_views,
            hint: match all.len() {
                0 => "none at all: is the target's description that of the board?".to_owned(),
                n => format!(
                    "a part of it was detected in {n} images; those with at least {min_corners} corners count"
                ),
            },
        });
    }
    let each: Vec<Vec<Point>> = seen.iter().map(|(_, points)| points.clone()).collect();
    let no_lens = |rms_px: f64| CamerasError::NoLens {
        eye: description.name.clone(),
        rms_px,
        limit_px: config.views.max_initial_rms_px,
    };
    let by_factory = description
        .factory
        .map(|model| (model, poses(&model, &each, &config.poses)));
    let good = |found: &[Option<crate::pnp::PlanarPose>]| {
        median_rms_px(found) < config.views.max_initial_rms_px
    };
    let (model, found) = match by_factory {
        Some((model, found)) if good(&found) => (model, found),
        other => {
            let (model, rms) = initial_lens(description.size, &each, config)
                .ok_or_else(|| no_lens(f64::INFINITY))?;
            if rms > config.views.max_initial_rms_px {
                return Err(no_lens(rms));
            }
            if other.is_some() {
                findings.push(Finding::new(
                    Severity::Fail,
                    format!(
                        "{}: the factory lens contradicts the detections: the file of another camera, or of another \
                         resolution?",
                        description.name
                    ),
                ));
            }
            let found = poses(&model, &each, &config.poses);
            (model, found)
        }
    };
    let median = median_rms_px(&found);
    let mut target_views: Vec<TargetView> = seen
        .into_iter()
        .zip(found)
        .filter_map(|((detection, points), placed)| {
            let placed = placed.filter(|p| {
                p.rms_px < config.views.outlier_ratio * median.max(config.views.min_median_rms_px)
            })?;
            Some(TargetView {
                posed: PosedView {
                    instant: detection.instant,
                    eye,
                    target: detection.target,
                    eye_from_target: placed.eye_from_target,
                    trust: match placed.ambiguity < config.views.max_ambiguity_ratio {
                        true => 0,
                        false => points.len(),
                    },
                },
                ambiguous: placed.ambiguity < config.views.max_ambiguity_ratio,
                points,
                motion_px: None,
            })
        })
        .collect();
    measure_motion(input, &mut target_views, &config.motion);
    for target_view in &mut target_views {
        let blurred = config.motion.sigma_ratio * target_view.motion_or_zero_px();
        for point in &mut target_view.points {
            point.sigma_px = point.sigma_px.hypot(blurred);
        }
    }
    Ok((model, target_views))
}

fn median_rms_px(found: &[Option<crate::pnp::PlanarPose>]) -> f64 {
    let mut misses: Vec<f64> = found
        .iter()
        .map(|p| p.map_or(f64::INFINITY, |p| p.rms_px))
        .collect();
    misses.sort_by(f64::total_cmp);
    misses
        .get(misses.len() / 2)
        .copied()
        .unwrap_or(f64::INFINITY)
}

/// Measures image motion between consecutive views of one eye.
fn measure_motion(input: &Input, target_views: &mut [TargetView], config: &MotionConfig) {
    let mut order: Vec<usize> = (0..target_views.len()).collect();
    order.sort_by_key(|&i| (target_views[i].posed.target, target_views[i].posed.instant));
    for pair in order.windows(2) {
        let (a, b) = (&target_views[pair[0]], &target_views[pair[1]]);
        let apart = input.times_ns[b.posed.instant] - input.times_ns[a.posed.instant];
        if a.posed.target != b.posed.target || apart > config.max_frame_interval_ns {
            continue;
        }
        let Some(median) = median_displacement_px(a, b) else {
            continue;
        };
        let median = median * MOTION_INTERVAL_NS / apart.max(1) as f64;
        for &i in pair {
            let least = target_views[i].motion_px.map_or(median, |m| m.max(median));
            target_views[i].motion_px = Some(least);
        }
    }
}

/// Static views, or those with the least motion; unknown motion counts as static.
fn static_views<'a>(
    target_views: impl Iterator<Item = &'a TargetView> + Clone,
    config: &MotionConfig,
) -> Vec<&'a TargetView> {
    let limit = motion_limit_px(target_views.clone(), config).max(config.max_static_px);
    target_views
        .filter(|p| p.motion_or_zero_px() <= limit)
        .collect()
}

/// The motion that [`MotionConfig::min_used_ratio`] of the views do not exceed.
fn motion_limit_px<'a>(
    target_views: impl Iterator<Item = &'a TargetView>,
    config: &MotionConfig,
) -> f64 {
    let mut all: Vec<f64> = target_views.map(TargetView::motion_or_zero_px).collect();
    all.sort_by(f64::total_cmp);
    let least = (config.min_used_ratio * all.len() as f64).ceil() as usize;
    all.get(least.saturating_sub(1)).copied().unwrap_or(0.0)
}

/// The instants with most information on the lenses of a camera.
fn most_informative(
    input: &Input,
    eyes: &[usize],
    starts: &[CameraModel],
    target_views: &[TargetView],
    config: &Config,
) -> Vec<usize> {
    let most = config.max_views;
    let mut instants: Vec<usize> = Vec::new();
    for &eye in eyes {
        instants.extend(
            static_views(
                target_views.iter().filter(|p| p.posed.eye == eye),
                &config.motion,
            )
            .iter()
            .map(|p| p.posed.instant),
        );
    }
    instants.sort_unstable();
    instants.dedup();
    // Each view has its own pose here: the constraint between the eyes is used later.
    let mut keys: Vec<usize> = Vec::new();
    let mut problem = Problem::default();
    for (lens, &eye) in eyes.iter().enumerate() {
        let model = starts[eye];
        problem.lenses.push(LensBlock::free("", model));
        for target_view in target_views
            .iter()
            .filter(|p| p.posed.eye == eye && !p.ambiguous)
        {
            if instants.binary_search(&target_view.posed.instant).is_err() {
                continue;
            }
            problem.views.push(View {
                instant: problem.instants.len(),
                lens,
                path: Vec::new(),
                target: None,
                points: target_view.points.clone(),
            });
            problem.instants.push(target_view.posed.eye_from_target);
            keys.push(target_view.posed.instant);
        }
    }
    let priors: Vec<f64> = eyes
        .iter()
        .flat_map(|&eye| match &input.eyes[eye].factory {
            Some(factory) => factory_priors(factory, &config.priors.factory_lens),
            None => weak_priors(&starts[eye], &config.priors.any_lens),
        })
        .map(|prior| match prior {
            Prior::Near { sigma, .. } => 1.0 / (sigma * sigma),
            Prior::Free | Prior::Fixed => 0.0,
        })
        .collect();
    let count: usize = problem.lenses.iter().map(|l| l.priors.len()).sum();
    // If the initial lens is of another model than the factory file, the prior matters little.
    let prior = DMatrix::from_fn(count, count, |i, j| match i == j {
        true => priors.get(i).copied().unwrap_or(1.0),
        false => 0.0,
    });
    // Both eyes' views of one instant are taken together, at the position of the first of them.
    let order = view_selection::select_greedy(&problem, &prior, most * eyes.len(), &config.solver);
    let mut taken: Vec<usize> = Vec::new();
    for view in order {
        if !taken.contains(&keys[view]) && taken.len() < most {
            taken.push(keys[view]);
        }
    }
    taken
}

/// Views of an eye at these instants, in their order.
fn of_instants(
    target_views: &[TargetView],
    eye: usize,
    instants: &[usize],
) -> Vec<(RigidTransform, Vec<Point>)> {
    instants
        .iter()
        .flat_map(|&i| {
            target_views
                .iter()
                .filter(move |p| p.posed.eye == eye && p.posed.instant == i)
        })
        .map(|p| (p.posed.eye_from_target, p.points.clone()))
        .collect()
}

/// Static instants at which two cameras observe targets, or one eye observes two: spread evenly
/// over all instants of each combination.
fn bridges(input: &Input, target_views: &[TargetView], config: &Config) -> Vec<usize> {
    let mut by_instant: BTreeMap<usize, (Vec<usize>, f64)> = BTreeMap::new();
    for target_view in target_views {
        let Some(camera) = input.camera_of(target_view.posed.eye) else {
            continue;
        };
        let key = camera * input.targets.len() + target_view.posed.target;
        let entry = by_instant.entry(target_view.posed.instant).or_default();
        entry.0.push(key);
        entry.1 = entry.1.max(target_view.motion_or_zero_px());
    }
    // Instants by observed combination: (motion, instant).
    let mut groups: BTreeMap<Vec<usize>, Vec<(f64, usize)>> = BTreeMap::new();
    for (instant, (mut keys, motion_px)) in by_instant {
        keys.sort_unstable();
        keys.dedup();
        if keys.len() > 1 {
            groups.entry(keys).or_default().push((motion_px, instant));
        }
    }
    let each = config.max_views.div_ceil(groups.len().max(1)).max(4);
    let mut taken = Vec::new();
    for group in groups.values() {
        let mut stillest = group.clone();
        stillest.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let still =
            stillest.partition_point(|(motion_px, _)| *motion_px <= config.motion.max_static_px);
        stillest.truncate(still.max(each).min(stillest.len()));
        stillest.sort_by_key(|(_, instant)| *instant);
        let step = stillest.len() as f64 / each as f64;
        let count = each.min(stillest.len());
        taken
            .extend((0..count).map(|k| {
                stillest[((k as f64 * step.max(1.0)) as usize).min(stillest.len() - 1)].1
            }));
    }
    taken
}

/// The bundle adjustment problem with its indices.
struct AssembledProblem {
    problem: Problem,
    poses: RigPoses,
    /// Index of the input's instant, by the problem's.
    used: Vec<usize>,
    /// Index of the target, by view.
    targets: Vec<usize>,
}

/// Assembles the problem. Views that are not connected with the rest get instants of their own.
fn assemble(
    input: &Input,
    target_views: &[TargetView],
    known: &InitialPoses,
    lenses: &[SelectedLens],
    used: &[usize],
    config: &Config,
) -> AssembledProblem {
    let priors = &config.priors;
    let mut problem = Problem::default();
    for (eye, lens) in input.eyes.iter().zip(lenses) {
        problem.lenses.push(LensBlock {
            name: eye.name.clone(),
            model: lens.model,
            priors: lens.priors.clone(),
        });
    }
    let mut poses = RigPoses {
        cameras: vec![None; input.cameras.len()],
        pairs: vec![None; input.cameras.len()],
        targets: vec![None; input.targets.len()],
    };
    let mut add = |name: String, at: RigidTransform, prior: PosePrior| {
        problem.poses.push(PoseBlock {
            name,
            parent_from_child: at,
            prior,
        });
        problem.poses.len() - 1
    };
    let origin = input.origin();
    for (number, camera) in input.cameras.iter().enumerate() {
        if let Some(at) = known.cameras[number] {
            let prior = match &camera.rig_from_left {
                Some(prior) if prior.covariance == Matrix6::zeros() => PosePrior::Fixed,
                Some(prior) => PosePrior::Near {
                    mean: prior.transform,
                    covariance: Box::new(prior.covariance),
                },
                None if origin == Some(number) => PosePrior::Fixed,
                None => weak_prior(at, priors),
            };
            poses.cameras[number] = Some(add(camera.name.clone(), at, prior));
        }
        if let Some(at) = known.pairs[number] {
            let prior = match &camera.left_from_right {
                None => weak_prior(at, priors),
                Some(prior) => {
                    let [v, w] = priors.factory_stereo_sigma.map(|sigma| sigma.powi(2));
                    let added = Matrix6::from_diagonal(&[v, v, v, w, w, w].into());
                    PosePrior::Near {
                        mean: prior.transform,
                        covariance: Box::new(prior.covariance + added),
                    }
                }
            };
            poses.pairs[number] = Some(add(format!("the right eye of {}", camera.name), at, prior));
        }
    }
    for (target, at) in known.targets.iter().enumerate() {
        if let (Some(at), true) = (at, target != known.world) {
            let prior = PosePrior::near(
                *at,
                priors.target_ratio * priors.extrinsics_sigma[0],
                priors.extrinsics_sigma[1],
            );
            poses.targets[target] = Some(add(format!("target {target}"), *at, prior));
        }
    }
    let mut assembled = AssembledProblem {
        problem,
        poses,
        used: Vec::new(),
        targets: Vec::new(),
    };
    let limit = |eye: usize| {
        let own = target_views.iter().filter(|p| p.posed.eye == eye);
        motion_limit_px(own, &config.motion)
    };
    let limits: Vec<f64> = (0..input.eyes.len()).map(limit).collect();
    let mut instants: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for target_view in target_views {
        let PosedView {
            instant,
            eye,
            target,
            eye_from_target,
            ..
        } = target_view.posed;
        let is_blurred = target_view.motion_or_zero_px() > limits[eye].max(config.motion.max_px);
        if used.binary_search(&instant).is_err() || is_blurred {
            continue;
        }
        let Some(number) = input.camera_of(eye) else {
            continue;
        };
        let camera = &input.cameras[number];
        let right = eye != camera.left;
        if right && assembled.poses.pairs[number].is_none() {
            continue;
        }
        let connected = known.cameras[number].is_some() && known.targets[target].is_some();
        let mut path: Vec<usize> = Vec::new();
        if connected {
            path.extend(assembled.poses.cameras[number]);
        }
        if right {
            path.extend(assembled.poses.pairs[number]);
        }
        // Group 0 is connected; the others are separate by camera and target.
        let group = match connected {
            true => 0,
            false => 1 + number * input.targets.len() + target,
        };
        let at = *instants.entry((instant, group)).or_insert_with(|| {
            let rig_from_eye = match (connected, right) {
                (true, _) => known.eye(input, eye),
                (false, true) => known.pairs[number],
                (false, false) => None,
            };
            let rig_from_eye = rig_from_eye.unwrap_or(RigidTransform::identity());
            let world_from_target = match connected {
                true => known.targets[target].unwrap_or(RigidTransform::identity()),
                false => RigidTransform::identity(),
            };
            let by_this = rig_from_eye * eye_from_target * world_from_target.inverse();
            let rig_from_world = match connected {
                true => known.instants[instant].unwrap_or(by_this),
                false => by_this,
            };
            assembled.problem.instants.push(rig_from_world);
            assembled.used.push(instant);
            assembled.problem.instants.len() - 1
        });
        assembled.problem.views.push(View {
            instant: at,
            lens: eye,
            path,
            target: if connected {
                assembled.poses.targets[target]
            } else {
                None
            },
            points: target_view.points.clone(),
        });
        assembled.targets.push(target);
    }
    sort_by_time(assembled)
}

/// Sorts instants by time, which later checks rely on.
fn sort_by_time(mut assembled: AssembledProblem) -> AssembledProblem {
    let mut order: Vec<usize> = (0..assembled.used.len()).collect();
    order.sort_by_key(|&i| assembled.used[i]);
    let mut now = vec![0; order.len()];
    for (new, &old) in order.iter().enumerate() {
        now[old] = new;
    }
    assembled.problem.instants = order
        .iter()
        .map(|&i| assembled.problem.instants[i])
        .collect();
    assembled.used = order.iter().map(|&i| assembled.used[i]).collect();
    for view in &mut assembled.problem.views {
        view.instant = now[view.instant];
    }
    assembled
}

/// Estimates the corner sigma of each view from its residuals: blur, light and distance differ
/// between views, and the sigmas of the result are only as good as those of the corners.
fn reweight_views(problem: &mut Problem, solution: &Solution, prior_corners: f64) {
    for (view, residuals) in problem.views.iter_mut().zip(&solution.residuals) {
        let lengths: Vec<f64> = view
            .points
            .iter()
            .zip(residuals)
            .filter_map(|(point, r)| r.map(|[x, y]| x.hypot(y) / point.sigma_px))
            .collect();
        let count = lengths.len() as f64;
        // Degrees of freedom left by the view's pose.
        let left = (2.0 * count - 6.0).max(1.0);
        let own = median_scale(lengths).powi(2) * 2.0 * count / left;
        let all = solution.scale * solution.scale;
        let expected = (prior_corners * all + count * own) / (prior_corners + count);
        let factor = (expected / all).sqrt();
        for point in &mut view.points {
            point.sigma_px *= factor;
        }
    }
}

fn coverage(input: &Input, solution: &Solution, config: &Config) -> Vec<Coverage> {
    let problem = &solution.problem;
    let of = |eye: usize| {
        let views = problem.views.iter().filter(move |v| v.lens == eye);
        let posed = views.map(|view| (eye_from_target(problem, view), view.points.as_slice()));
        Coverage::of(input.eyes[eye].size, posed, &config.coverage)
    };
    (0..input.eyes.len()).map(of).collect()
}

/// `eye_from_target` of a view.
pub(super) fn eye_from_target(problem: &Problem, view: &View) -> RigidTransform {
    let pose = |i: usize| problem.poses[i].parent_from_child;
    let eye_from_rig = view
        .path
        .iter()
        .fold(RigidTransform::identity(), |at, &p| pose(p).inverse() * at);
    let rig_from_world = problem.instants[view.instant];
    let world_from_target = view.target.map_or(RigidTransform::identity(), pose);
    eye_from_rig * rig_from_world * world_from_target
}
