//! From sightings to a calibration: the order in which things are done.

use std::collections::BTreeMap;

use cad_transforms::RigidTransform;
use nalgebra::{DMatrix, Matrix6};

use super::check::{self, Finding, Severity};
use super::choose::{self, Chosen, EyeViews};
use super::connect::{Known, Posed, connect};
use super::coverage::Coverage;
use super::start::{factory_priors, guess, poses, weak_priors};
use super::{Calibration, CamerasError, Input, Places, Settings, points, select, shape, stays};
use crate::adjust::{
    LensBlock, PlaceBlock, PlacePrior, Point, Prior, Problem, Solution, View, median_scale, solve,
};
use crate::camera::{CameraModel, Distortion};

/// A picture with fewer corners takes no part.
const LEAST_CORNERS: usize = 8;
/// An eye needs at least so many pictures of targets.
const LEAST_PICTURES: usize = 5;
/// Worst median residual that a lens to start from may have, px.
const START_PX: f64 = 8.0;
/// A view whose residuals are this many times the median's is of something else.
const WRONG_VIEW: f64 = 6.0;
/// Where the mirrored pose misses by less than this many times the best one's, either may be right.
const AMBIGUOUS: f64 = 1.5;
/// Movements are told as pixels in this time, ns.
const MOVING_NS: f64 = 1e8;
/// Corners that move by less in that time count as still, px.
const STILL_PX: f64 = 0.25;
/// Pictures whose corners move more than that take no part if others of their eye do not.
const LARGEST_MOVEMENT_PX: f64 = 1.0;
/// This share of that movement is added to the sigma of corners: rows of a rolling shutter, and eyes, are not
/// exposed at one instant.
const BLURRED_SHARE: f64 = 0.25;
/// Pictures farther apart in time than this say nothing of movement, ns.
const NEXT_NS: i64 = 250_000_000;
/// At least this share of pictures is used, the stillest, whether or not they are still.
const STILLEST_SHARE: f64 = 0.2;
/// How far a factory's `left_from_right` may be off, beyond what it says itself: m and rad.
const PAIR_PRIOR: (f64, f64) = (2e-3, 0.01);
/// How large tangential coefficients of lenses are: those of the makers' files that we have.
const TANGENTIAL: f64 = 3e-4;
/// What is thought of corners' sigmas before counts as much as so many corners.
const SURE_OF_SIGMA: f64 = 20.0;
/// Where nothing is told of a place, it is within this: m and rad.
const ANYWHERE: (f64, f64) = (3.0, 3.0);

/// A sighting with its points and its pose.
pub(super) struct Picture {
    pub(super) posed: Posed,
    pub(super) points: Vec<Point>,
    /// Whether the pose may be the mirrored one.
    ambiguous: bool,
    /// Movement of corners to the next or from the last picture, px in [`MOVING_NS`]; none where it is not known.
    movement_px: Option<f64>,
}

impl Picture {
    /// Movement; none if it is not known.
    pub(super) fn movement(&self) -> f64 {
        self.movement_px.unwrap_or(0.0)
    }
}

/// Calibrates. `progress` is told what is being done and how much of it, from 0 to 1.
///
/// # Errors
/// [`CamerasError`].
pub fn calibrate(
    input: Input,
    settings: &Settings,
    progress: &mut dyn FnMut(&str, f64),
) -> Result<Calibration, CamerasError> {
    let mut findings = Vec::new();
    progress("looking for lenses to start from", 0.0);
    let mut starts = Vec::new();
    let mut pictures: Vec<Picture> = Vec::new();
    for eye in 0..input.eyes.len() {
        let (start, own) = eye_pictures(&input, eye, &mut findings)?;
        starts.push(start);
        pictures.extend(own);
    }
    findings.extend(of_unknown_movement(&pictures));
    let mut chosen: Vec<Option<Chosen>> = vec![None; input.eyes.len()];
    let mut choices = Vec::new();
    let mut used: Vec<usize> = Vec::new();
    for (number, camera) in input.cameras.iter().enumerate() {
        let share = number as f64 / input.cameras.len() as f64;
        progress(
            &format!("choosing the lens model of {}", camera.name),
            0.1 + 0.5 * share,
        );
        let eyes: Vec<usize> = std::iter::once(camera.left).chain(camera.right).collect();
        let instants = telling(&input, &eyes, &starts, &pictures, settings.most_views);
        let views: Vec<EyeViews<'_>> = eyes
            .iter()
            .map(|&eye| EyeViews {
                start: starts[eye],
                factory: input.eyes[eye].factory.as_ref(),
                views: of_instants(&pictures, eye, &instants),
            })
            .collect();
        let name = || input.eyes[camera.left].name.clone();
        let (choice, lenses) =
            choose::choose(&views, settings.choose_lens).ok_or_else(|| CamerasError::NoLens {
                eye: name(),
                rms_px: f64::INFINITY,
                limit_px: START_PX,
            })?;
        choices.push(choice);
        for (eye, lens) in eyes.into_iter().zip(lenses) {
            chosen[eye] = Some(lens);
        }
        used.extend(instants);
    }
    progress("connecting cameras", 0.6);
    let chosen: Vec<Chosen> = chosen.into_iter().zip(&starts).map(known_lens).collect();
    let posed: Vec<Posed> = pictures.iter().map(|p| p.posed).collect();
    let known = connect(&input, &posed);
    used.extend(bridges(&input, &pictures, settings.most_views));
    used.sort_unstable();
    used.dedup();
    progress("adjusting everything", 0.65);
    let mut build = assemble(&input, &pictures, &known, &chosen, &used);
    let stays = stays::numbers(&pictures);
    build.problem.stays = build.used.iter().map(|instant| stays[instant]).collect();
    let quick = crate::adjust::Settings {
        covariance: false,
        tolerance: 1e-6,
        ..crate::adjust::Settings::default()
    };
    let first = solve(&build.problem, &quick)?;
    build.problem = first.problem.clone();
    weigh_views(&mut build.problem, &first);
    let mut solution = solve(&build.problem, &crate::adjust::Settings::default())?;
    // A camera that is clearly not where it was told must not pull the others along.
    while let Some(camera) = check::disbelieved(&input, &build.places, &solution) {
        let place = build.places.cameras[camera].expect("only placed cameras are disbelieved");
        let told = input.cameras[camera]
            .rig_from_left
            .as_ref()
            .expect("it was told");
        let near = PlacePrior::near(told.transform, ANYWHERE.0, ANYWHERE.1);
        build.problem.places[place].prior = near.clone();
        solution.problem.places[place].prior = near;
        solution = solve(&solution.problem, &crate::adjust::Settings::default())?;
    }
    progress("looking at the targets' shape", 0.85);
    let (solution, sagitta_m) = shape::refine(solution, &input.targets, &build.targets)?;
    progress("checking", 0.95);
    let coverage = coverage(&input, &solution);
    let mut calibration = Calibration {
        used: build.used,
        choices,
        solution,
        places: build.places,
        coverage,
        sagitta_m,
        findings: Vec::new(),
        input,
    };
    findings.extend(check::findings(&calibration));
    findings.sort_by_key(|f| std::cmp::Reverse(f.severity));
    calibration.findings = findings;
    progress("checking", 1.0);
    Ok(calibration)
}

/// Pictures too far apart in time do not tell whether the rig was still when they were taken.
fn of_unknown_movement(pictures: &[Picture]) -> Option<Finding> {
    let unknown = pictures.iter().filter(|p| p.movement_px.is_none()).count();
    (2 * unknown > pictures.len()).then(|| {
        Finding::new(
            Severity::Warn,
            format!(
                "whether the rig was still is not known of {unknown} of {} pictures, which follow no other within \
                 {} s: the result is as good as they were still",
                pictures.len(),
                1e-9 * NEXT_NS as f64
            ),
        )
    })
}

/// A lens that was chosen; an eye of no camera keeps what it started from. A lens without tangential terms
/// gets them back with how large they are in lenses: one eye alone does not see them, but principal points
/// and the turn between eyes are only as sure as they are.
fn known_lens((chosen, start): (Option<Chosen>, &CameraModel)) -> Chosen {
    let mut lens = chosen.unwrap_or_else(|| Chosen {
        model: *start,
        priors: weak_priors(start),
    });
    if let Distortion::Radial2 { k1, k2 } = lens.model.distortion {
        let (p1, p2) = (0.0, 0.0);
        lens.model.distortion = Distortion::RadTan4 { k1, k2, p1, p2 };
        let small = Prior::Near {
            mean: 0.0,
            sigma: TANGENTIAL,
        };
        lens.priors.extend([small; 2]);
    }
    lens
}

/// Pictures of one eye with poses by a lens to start from.
fn eye_pictures(
    input: &Input,
    eye: usize,
    findings: &mut Vec<Finding>,
) -> Result<(CameraModel, Vec<Picture>), CamerasError> {
    let description = &input.eyes[eye];
    let all: Vec<_> = input.sightings.iter().filter(|s| s.eye == eye).collect();
    let seen: Vec<_> = all
        .iter()
        .map(|s| (*s, points(&input.targets[s.target], &s.corners)))
        .filter(|(_, points)| points.len() >= LEAST_CORNERS)
        .collect();
    if seen.len() < LEAST_PICTURES {
        return Err(CamerasError::TooFew {
            eye: description.name.clone(),
            found: seen.len(),
            expected: LEAST_PICTURES,
            hint: match all.len() {
                0 => "none at all: is the target's description that of the board?".to_owned(),
                n => format!(
                    "in {n} pictures something of it was seen, with at least {LEAST_CORNERS} corners in so many"
                ),
            },
        });
    }
    let each: Vec<Vec<Point>> = seen.iter().map(|(_, points)| points.clone()).collect();
    let no_lens = |rms_px: f64| CamerasError::NoLens {
        eye: description.name.clone(),
        rms_px,
        limit_px: START_PX,
    };
    let by_factory = description
        .factory
        .map(|model| (model, poses(&model, &each)));
    let good = |found: &[Option<crate::pnp::Placed>]| median_px(found) < START_PX;
    let (model, found) = match by_factory {
        Some((model, found)) if good(&found) => (model, found),
        other => {
            let (model, rms) =
                guess(description.size, &each).ok_or_else(|| no_lens(f64::INFINITY))?;
            if rms > START_PX {
                return Err(no_lens(rms));
            }
            if other.is_some() {
                findings.push(Finding::new(
                    Severity::Fail,
                    format!(
                        "{}: the factory's lens misses what was seen by far: the file of another camera, or of another \
                         resolution?",
                        description.name
                    ),
                ));
            }
            let found = poses(&model, &each);
            (model, found)
        }
    };
    let median = median_px(&found);
    let mut pictures: Vec<Picture> = seen
        .into_iter()
        .zip(found)
        .filter_map(|((sighting, points), placed)| {
            let placed = placed.filter(|p| p.rms_px < WRONG_VIEW * median.max(0.05))?;
            Some(Picture {
                posed: Posed {
                    instant: sighting.instant,
                    eye,
                    target: sighting.target,
                    eye_from_target: placed.eye_from_target,
                    trust: match placed.ambiguity < AMBIGUOUS {
                        true => 0,
                        false => points.len(),
                    },
                },
                ambiguous: placed.ambiguity < AMBIGUOUS,
                points,
                movement_px: None,
            })
        })
        .collect();
    movements(input, &mut pictures);
    for picture in &mut pictures {
        let blurred = BLURRED_SHARE * picture.movement();
        for point in &mut picture.points {
            point.sigma_px = point.sigma_px.hypot(blurred);
        }
    }
    Ok((model, pictures))
}

fn median_px(found: &[Option<crate::pnp::Placed>]) -> f64 {
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

/// How far corners move between pictures that follow each other; one eye's pictures.
fn movements(input: &Input, pictures: &mut [Picture]) {
    let mut order: Vec<usize> = (0..pictures.len()).collect();
    order.sort_by_key(|&i| (pictures[i].posed.target, pictures[i].posed.instant));
    for pair in order.windows(2) {
        let (a, b) = (&pictures[pair[0]], &pictures[pair[1]]);
        let apart = input.times_ns[b.posed.instant] - input.times_ns[a.posed.instant];
        if a.posed.target != b.posed.target || apart > NEXT_NS {
            continue;
        }
        let Some(median) = moved_px(a, b) else {
            continue;
        };
        let median = median * MOVING_NS / apart.max(1) as f64;
        for &i in pair {
            let least = pictures[i].movement_px.map_or(median, |m| m.max(median));
            pictures[i].movement_px = Some(least);
        }
    }
}

/// How far the corners that two pictures of one target share have moved, px: the median.
pub(super) fn moved_px(a: &Picture, b: &Picture) -> Option<f64> {
    let moves = a.points.iter().filter_map(|p| {
        let q = b.points.iter().find(|q| q.x_in_target == p.x_in_target)?;
        Some((p.pixel[0] - q.pixel[0]).hypot(p.pixel[1] - q.pixel[1]))
    });
    let mut moves: Vec<f64> = moves.collect();
    moves.sort_by(f64::total_cmp);
    moves.get(moves.len() / 2).copied()
}

/// Pictures that are still, or the stillest there are; those of which it is not known count as still.
fn still<'a>(pictures: impl Iterator<Item = &'a Picture> + Clone) -> Vec<&'a Picture> {
    let limit = movement_limit(pictures.clone()).max(STILL_PX);
    pictures.filter(|p| p.movement() <= limit).collect()
}

/// The movement that [`STILLEST_SHARE`] of some pictures stay below.
fn movement_limit<'a>(pictures: impl Iterator<Item = &'a Picture>) -> f64 {
    let mut all: Vec<f64> = pictures.map(Picture::movement).collect();
    all.sort_by(f64::total_cmp);
    let least = (STILLEST_SHARE * all.len() as f64).ceil() as usize;
    all.get(least.saturating_sub(1)).copied().unwrap_or(0.0)
}

/// Instants that tell most of the lenses of a camera's eyes.
fn telling(
    input: &Input,
    eyes: &[usize],
    starts: &[CameraModel],
    pictures: &[Picture],
    most: usize,
) -> Vec<usize> {
    let mut instants: Vec<usize> = Vec::new();
    for &eye in eyes {
        instants.extend(
            still(pictures.iter().filter(|p| p.posed.eye == eye))
                .iter()
                .map(|p| p.posed.instant),
        );
    }
    instants.sort_unstable();
    instants.dedup();
    // Each view has a pose of its own here: what two eyes tell of each other is for later.
    let mut keys: Vec<usize> = Vec::new();
    let mut problem = Problem::default();
    for (lens, &eye) in eyes.iter().enumerate() {
        let model = starts[eye];
        problem.lenses.push(LensBlock::free("", model));
        for picture in pictures
            .iter()
            .filter(|p| p.posed.eye == eye && !p.ambiguous)
        {
            if instants.binary_search(&picture.posed.instant).is_err() {
                continue;
            }
            problem.views.push(View {
                instant: problem.instants.len(),
                lens,
                path: Vec::new(),
                target: None,
                points: picture.points.clone(),
            });
            problem.instants.push(picture.posed.eye_from_target);
            keys.push(picture.posed.instant);
        }
    }
    let priors: Vec<f64> = eyes
        .iter()
        .flat_map(|&eye| match &input.eyes[eye].factory {
            Some(factory) => factory_priors(factory),
            None => weak_priors(&starts[eye]),
        })
        .map(|prior| match prior {
            Prior::Near { sigma, .. } => 1.0 / (sigma * sigma),
            Prior::Free | Prior::Fixed => 0.0,
        })
        .collect();
    let count: usize = problem.lenses.iter().map(|l| l.priors.len()).sum();
    // Where the start is of another model than the factory's file, what is there before matters little.
    let prior = DMatrix::from_fn(count, count, |i, j| match i == j {
        true => priors.get(i).copied().unwrap_or(1.0),
        false => 0.0,
    });
    // Both eyes' views of one instant come together: the order is that of the first of them.
    let order = select::best(&problem, &prior, most * eyes.len());
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
    pictures: &[Picture],
    eye: usize,
    instants: &[usize],
) -> Vec<(RigidTransform, Vec<Point>)> {
    instants
        .iter()
        .flat_map(|&i| {
            pictures
                .iter()
                .filter(move |p| p.posed.eye == eye && p.posed.instant == i)
        })
        .map(|p| (p.posed.eye_from_target, p.points.clone()))
        .collect()
}

/// Still instants at which two cameras see targets, or one eye sees two: spread evenly over all that there
/// are of each combination.
fn bridges(input: &Input, pictures: &[Picture], most: usize) -> Vec<usize> {
    let mut by_instant: BTreeMap<usize, (Vec<usize>, f64)> = BTreeMap::new();
    for picture in pictures {
        let Some(camera) = input.camera_of(picture.posed.eye) else {
            continue;
        };
        let key = camera * input.targets.len() + picture.posed.target;
        let entry = by_instant.entry(picture.posed.instant).or_default();
        entry.0.push(key);
        entry.1 = entry.1.max(picture.movement());
    }
    // What was seen together, and when: (movement, instant).
    let mut groups: BTreeMap<Vec<usize>, Vec<(f64, usize)>> = BTreeMap::new();
    for (instant, (mut keys, movement)) in by_instant {
        keys.sort_unstable();
        keys.dedup();
        if keys.len() > 1 {
            groups.entry(keys).or_default().push((movement, instant));
        }
    }
    let each = most.div_ceil(groups.len().max(1)).max(4);
    let mut taken = Vec::new();
    for group in groups.values() {
        let mut stillest = group.clone();
        stillest.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let still = stillest.partition_point(|(movement, _)| *movement <= STILL_PX);
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

/// The problem with what belongs to what.
struct Built {
    problem: Problem,
    places: Places,
    /// Number of the input's instant, by the problem's.
    used: Vec<usize>,
    /// Number of the target, by view.
    targets: Vec<usize>,
}

/// Puts everything into one problem. What is not connected with the rest gets instants of its own.
fn assemble(
    input: &Input,
    pictures: &[Picture],
    known: &Known,
    lenses: &[Chosen],
    used: &[usize],
) -> Built {
    let mut problem = Problem::default();
    for (eye, lens) in input.eyes.iter().zip(lenses) {
        problem.lenses.push(LensBlock {
            name: eye.name.clone(),
            model: lens.model,
            priors: lens.priors.clone(),
        });
    }
    let mut places = Places {
        cameras: vec![None; input.cameras.len()],
        pairs: vec![None; input.cameras.len()],
        targets: vec![None; input.targets.len()],
    };
    let mut add = |name: String, at: RigidTransform, prior: PlacePrior| {
        problem.places.push(PlaceBlock {
            name,
            parent_from_child: at,
            prior,
        });
        problem.places.len() - 1
    };
    let origin = input.origin();
    for (number, camera) in input.cameras.iter().enumerate() {
        if let Some(at) = known.cameras[number] {
            let prior = match &camera.rig_from_left {
                Some(told) if told.covariance == Matrix6::zeros() => PlacePrior::Fixed,
                Some(told) => PlacePrior::Near {
                    mean: told.transform,
                    covariance: Box::new(told.covariance),
                },
                None if origin == Some(number) => PlacePrior::Fixed,
                None => PlacePrior::near(at, ANYWHERE.0, ANYWHERE.1),
            };
            places.cameras[number] = Some(add(camera.name.clone(), at, prior));
        }
        if let Some(at) = known.pairs[number] {
            let prior = match &camera.left_from_right {
                None => PlacePrior::near(at, ANYWHERE.0, ANYWHERE.1),
                Some(told) => {
                    let (v, w) = (PAIR_PRIOR.0.powi(2), PAIR_PRIOR.1.powi(2));
                    let doubt = Matrix6::from_diagonal(&[v, v, v, w, w, w].into());
                    PlacePrior::Near {
                        mean: told.transform,
                        covariance: Box::new(told.covariance + doubt),
                    }
                }
            };
            places.pairs[number] =
                Some(add(format!("the right eye of {}", camera.name), at, prior));
        }
    }
    for (target, at) in known.targets.iter().enumerate() {
        if let (Some(at), true) = (at, target != known.world) {
            let prior = PlacePrior::near(*at, 10.0 * ANYWHERE.0, ANYWHERE.1);
            places.targets[target] = Some(add(format!("target {target}"), *at, prior));
        }
    }
    let mut built = Built {
        problem,
        places,
        used: Vec::new(),
        targets: Vec::new(),
    };
    let limit = |eye: usize| movement_limit(pictures.iter().filter(|p| p.posed.eye == eye));
    let limits: Vec<f64> = (0..input.eyes.len()).map(limit).collect();
    let mut instants: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    for picture in pictures {
        let Posed {
            instant,
            eye,
            target,
            eye_from_target,
            ..
        } = picture.posed;
        let is_blurred = picture.movement() > limits[eye].max(LARGEST_MOVEMENT_PX);
        if used.binary_search(&instant).is_err() || is_blurred {
            continue;
        }
        let Some(number) = input.camera_of(eye) else {
            continue;
        };
        let camera = &input.cameras[number];
        let right = eye != camera.left;
        if right && built.places.pairs[number].is_none() {
            continue;
        }
        let connected = known.cameras[number].is_some() && known.targets[target].is_some();
        let mut path: Vec<usize> = Vec::new();
        if connected {
            path.extend(built.places.cameras[number]);
        }
        if right {
            path.extend(built.places.pairs[number]);
        }
        // 0 is what is connected; the others are apart by camera and target.
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
            built.problem.instants.push(rig_from_world);
            built.used.push(instant);
            built.problem.instants.len() - 1
        });
        built.problem.views.push(View {
            instant: at,
            lens: eye,
            path,
            target: if connected {
                built.places.targets[target]
            } else {
                None
            },
            points: picture.points.clone(),
        });
        built.targets.push(target);
    }
    in_order_of_time(built)
}

/// Instants in the order of time, which is what later checks go by.
fn in_order_of_time(mut built: Built) -> Built {
    let mut order: Vec<usize> = (0..built.used.len()).collect();
    order.sort_by_key(|&i| built.used[i]);
    let mut now = vec![0; order.len()];
    for (new, &old) in order.iter().enumerate() {
        now[old] = new;
    }
    built.problem.instants = order.iter().map(|&i| built.problem.instants[i]).collect();
    built.used = order.iter().map(|&i| built.used[i]).collect();
    for view in &mut built.problem.views {
        view.instant = now[view.instant];
    }
    built
}

/// Gives the corners of each view the sigma that they turned out to have: pictures are blurred, dim and far in ways that
/// nobody knows beforehand, and sigmas of results are only as right as those of corners.
fn weigh_views(problem: &mut Problem, solution: &Solution) {
    for (view, residuals) in problem.views.iter_mut().zip(&solution.residuals) {
        let lengths: Vec<f64> = view
            .points
            .iter()
            .zip(residuals)
            .filter_map(|(point, r)| r.map(|[x, y]| x.hypot(y) / point.sigma_px))
            .collect();
        let count = lengths.len() as f64;
        // Its pose took its share of them.
        let left = (2.0 * count - 6.0).max(1.0);
        let own = median_scale(lengths).powi(2) * 2.0 * count / left;
        let all = solution.scale * solution.scale;
        let expected = (SURE_OF_SIGMA * all + count * own) / (SURE_OF_SIGMA + count);
        let factor = (expected / all).sqrt();
        for point in &mut view.points {
            point.sigma_px *= factor;
        }
    }
}

fn coverage(input: &Input, solution: &Solution) -> Vec<Coverage> {
    let problem = &solution.problem;
    let of = |eye: usize| {
        let views = problem.views.iter().filter(move |v| v.lens == eye);
        let posed = views.map(|view| (eye_from_target(problem, view), view.points.as_slice()));
        Coverage::of(input.eyes[eye].size, posed)
    };
    (0..input.eyes.len()).map(of).collect()
}

/// Where a target is from the eye of a view.
pub(super) fn eye_from_target(problem: &Problem, view: &View) -> RigidTransform {
    let place = |i: usize| problem.places[i].parent_from_child;
    let eye_from_rig = view
        .path
        .iter()
        .fold(RigidTransform::identity(), |at, &p| place(p).inverse() * at);
    let rig_from_world = problem.instants[view.instant];
    let world_from_target = view.target.map_or(RigidTransform::identity(), place);
    eye_from_rig * rig_from_world * world_from_target
}

impl Calibration {
    /// The input's instant behind the problem's.
    pub fn instant_of(&self, instant: usize) -> usize {
        self.used[instant]
    }
}
