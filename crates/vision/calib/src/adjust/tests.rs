use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion};
use nalgebra::{Vector3, Vector6};
use proptest::prelude::*;

use super::pose::{moved, step_between};
use super::*;

/// Normal numbers with sigma 1 from a seed, by adding uniform ones.
pub(crate) struct Noise(u64);

impl Noise {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) | 1)
    }

    fn uniform(&mut self) -> f64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        (self.0 >> 11) as f64 / (1u64 << 53) as f64
    }

    pub(crate) fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }
}

fn model(distortion: Distortion) -> CameraModel {
    CameraModel {
        width: 672,
        height: 376,
        fx: 350.0,
        fy: 351.0,
        cx: 333.0,
        cy: 190.0,
        distortion,
    }
}

/// A stereo camera with a board of 7 x 5 corners in `instants` poses, with noise of `sigma` px; the
/// values of the problem are the ground truth.
fn stereo(instants: usize, sigma: f64, seed: u64) -> Problem {
    let mut noise = Noise::new(seed);
    let distortion = Distortion::RadTan4 {
        k1: -0.17,
        k2: 0.02,
        p1: 3e-4,
        p2: -2e-4,
    };
    let left_from_right = moved(
        &RigidTransform::from_translation_m([0.063, 0.0, 0.0]).unwrap(),
        &Vector6::new(0.0, 3e-4, -2e-4, 2e-3, -4e-3, 1e-3),
    );
    let mut problem = Problem {
        lenses: vec![
            LensBlock::free("left", model(distortion)),
            LensBlock::free(
                "right",
                CameraModel {
                    cx: 340.0,
                    ..model(distortion)
                },
            ),
        ],
        poses: vec![PoseBlock {
            name: "right".to_owned(),
            parent_from_child: left_from_right,
            prior: PosePrior::Free,
        }],
        instants: Vec::new(),
        clusters: Vec::new(),
        views: Vec::new(),
    };
    for instant in 0..instants {
        let pose = Vector6::new(
            -0.3 + 0.12 * noise.normal(),
            -0.2 + 0.08 * noise.normal(),
            0.75 + 0.1 * noise.normal().clamp(-2.0, 2.0),
            0.35 * noise.normal().clamp(-1.5, 1.5),
            0.35 * noise.normal().clamp(-1.5, 1.5),
            0.5 * noise.normal(),
        );
        problem
            .instants
            .push(moved(&RigidTransform::identity(), &pose));
        for (lens, path) in [(0, vec![]), (1, vec![0])] {
            problem.views.push(View {
                instant,
                lens,
                path,
                target: None,
                points: Vec::new(),
            });
        }
    }
    fill(&mut problem, sigma, &mut noise);
    problem
}

/// Gives every view the points of the board that project into its image.
fn fill(problem: &mut Problem, sigma: f64, noise: &mut Noise) {
    let lenses = super::normal::lenses(problem);
    let snapshot = problem.clone();
    for view in &mut problem.views {
        let chain = super::normal::Chain::new(&snapshot, &lenses, view);
        for i in 0..35 {
            let x_in_target = [0.1 * f64::from(i % 7), 0.1 * f64::from(i / 7), 0.0];
            let Some([x, y]) = chain.pixel(x_in_target) else {
                continue;
            };
            if !(0.0..671.0).contains(&x) || !(0.0..375.0).contains(&y) {
                continue;
            }
            view.points.push(Point {
                x_in_target,
                pixel: [x + sigma * noise.normal(), y + sigma * noise.normal()],
                sigma_px: 1.0,
            });
        }
    }
    problem.views.retain(|view| view.points.len() >= 6);
}

/// The problem with disturbed initial values.
fn disturbed(truth: &Problem, seed: u64) -> Problem {
    let mut noise = Noise::new(seed ^ 0xabcd);
    let mut start = truth.clone();
    for lens in &mut start.lenses {
        let mut p = lens.model.parameters();
        for (i, value) in p.iter_mut().enumerate() {
            *value += noise.normal() * [5.0, 5.0, 4.0, 4.0, 0.02, 0.02, 1e-4, 1e-4][i];
        }
        lens.model = lens.model.with_parameters(&p);
    }
    let mut shake = |pose: &RigidTransform| {
        let step = Vector6::from_fn(|_, _| 0.01 * noise.normal());
        moved(pose, &step)
    };
    for place in &mut start.poses {
        place.parent_from_child = shake(&place.parent_from_child);
    }
    for instant in &mut start.instants {
        *instant = shake(instant);
    }
    start
}

#[test]
fn recovers_ground_truth_without_noise() {
    let truth = stereo(12, 0.0, 1);
    let found = solve(&disturbed(&truth, 1), &Config::default()).unwrap();
    for (a, b) in found.problem.lenses.iter().zip(&truth.lenses) {
        for (x, y) in a.model.parameters().iter().zip(b.model.parameters()) {
            assert!((x - y).abs() < 1e-6 * y.abs().max(1.0), "{x} {y}");
        }
    }
    let off = step_between(
        &truth.poses[0].parent_from_child,
        &found.problem.poses[0].parent_from_child,
    );
    assert!(off.amax() < 1e-9, "{off}");
    assert!(found.rms_px(|_| true) < 1e-8);
}

#[test]
fn ninety_five_percent_of_errors_are_within_two_sigma() {
    let (mut inside, mut all) = (0, 0);
    for seed in 0..20 {
        let truth = stereo(15, 0.15, 100 + seed);
        let found = solve(&disturbed(&truth, seed), &Config::default()).unwrap();
        assert!((found.scale - 0.15).abs() < 0.03, "{}", found.scale);
        let covariance = found.covariance.as_ref().unwrap();
        for parameter in &covariance.parameters {
            let value = |problem: &Problem| match *parameter {
                Parameter::Lens(i, k) => problem.lenses[i].model.parameters()[k],
                Parameter::Pose(i, k) => {
                    let at = &problem.poses[i].parent_from_child;
                    step_between(&truth.poses[i].parent_from_child, at)[k]
                }
            };
            let off = value(&found.problem) - value(&truth);
            inside += usize::from(off.abs() <= 2.0 * covariance.sigma(*parameter));
            all += 1;
        }
    }
    // 440 values, correlated within a run: 95.4 % are expected, 3 % is three of their deviations.
    let share = inside as f64 / all as f64;
    assert!((0.92..=0.995).contains(&share), "{share} of {all}");
}

/// Images of a rig at rest repeat each other with their errors: here six of them in each of twelve
/// clusters. The pose of the rig is known from priors alone, and must not hide the rotation between
/// the eyes.
#[test]
fn view_clusters_count_once() {
    let share_inside = |clustered: bool| {
        let mut inside = 0;
        for seed in 0..30 {
            let mut truth = stereo(12, 0.15, 300 + seed);
            let on_the_rig = |name: &str, at: RigidTransform| PoseBlock {
                name: name.to_owned(),
                parent_from_child: at,
                prior: PosePrior::near(at, 1e-3, 5e-3),
            };
            let right = truth.poses[0].parent_from_child;
            let left = RigidTransform::identity();
            truth.poses = vec![on_the_rig("right", right), on_the_rig("left", left)];
            for view in &mut truth.views {
                view.path = vec![1 - view.lens];
            }
            let once = truth.clone();
            for copy in 1..6 {
                truth.instants.extend(&once.instants);
                truth
                    .views
                    .extend(once.views.iter().cloned().map(|view| View {
                        instant: view.instant + 12 * copy,
                        ..view
                    }));
            }
            if clustered {
                truth.clusters = (0..truth.instants.len()).map(|i| i % 12).collect();
            }
            let found = solve(&disturbed(&truth, seed), &Config::default()).unwrap();
            let rotated = |place: usize| -> Vector3<f64> {
                let at = |problem: &Problem| problem.poses[place].parent_from_child;
                let step = step_between(&at(&truth), &at(&found.problem));
                step.fixed_rows::<3>(3).into()
            };
            let off = rotated(0) - rotated(1);
            let by: Vec<(Parameter, Vector3<f64>)> = [(0, 1.0), (1, -1.0)]
                .into_iter()
                .flat_map(|(place, sign)| {
                    (0..3).map(move |k| (Parameter::Pose(place, 3 + k), Vector3::ith(k, sign)))
                })
                .collect();
            let covariance = found.covariance.as_ref().unwrap().of(&by);
            let is_inside = |k: &usize| off[*k].abs() <= 2.0 * covariance[(*k, *k)].sqrt();
            inside += (0..3).filter(is_inside).count();
        }
        inside as f64 / 90.0
    };
    let (clustered, unclustered) = (share_inside(true), share_inside(false));
    assert!(clustered > 0.9, "{clustered}");
    assert!(unclustered < 0.8, "{unclustered}");
}

#[test]
fn outliers_hardly_change_the_solution() {
    let clean = stereo(15, 0.1, 7);
    let mut spoilt = clean.clone();
    for (i, view) in spoilt.views.iter_mut().enumerate() {
        view.points[i % 5].pixel[0] += 25.0;
    }
    let found = solve(&disturbed(&spoilt, 7), &Config::default()).unwrap();
    let covariance = found.covariance.as_ref().unwrap();
    for k in 0..6 {
        let off = step_between(
            &clean.poses[0].parent_from_child,
            &found.problem.poses[0].parent_from_child,
        )[k];
        let sigma = covariance.sigma(Parameter::Pose(0, k));
        assert!(off.abs() < 4.0 * sigma, "{k}: {off} of {sigma}");
    }
}

#[test]
fn undetermined_parameter_is_named() {
    // One view of a board straight ahead determines neither focal length nor depth.
    let mut problem = stereo(1, 0.1, 3);
    problem.instants[0] = RigidTransform::from_translation_m([-0.3, -0.2, 0.8]).unwrap();
    for view in &mut problem.views {
        view.points.clear();
    }
    let mut again = problem;
    fill(&mut again, 0.1, &mut Noise::new(5));
    let error = solve(&again, &Config::default())
        .map(|s| s.scale)
        .unwrap_err();
    let text = "fx of left is not determined by 2 views";
    assert!(error.to_string().contains(text), "{error}");

    // A prior on each is enough; parameters that are not determined keep their prior.
    let mut with_priors = again.clone();
    for lens in &mut with_priors.lenses {
        let values = lens.model.parameters().into_iter();
        lens.priors = values
            .map(|mean| Prior::Near {
                mean,
                sigma: 0.01 * mean.abs(),
            })
            .collect();
    }
    let place = &mut with_priors.poses[0];
    place.prior = PosePrior::near(place.parent_from_child, 1e-3, 2e-3);
    let found = solve(&with_priors, &Config::default()).unwrap();
    let sigma = found.covariance.unwrap().sigma(Parameter::Lens(0, 0));
    assert!(sigma < 3.6 && sigma > 1.0, "{sigma}");
}

#[test]
fn result_is_bit_identical_for_any_number_of_threads() {
    let start = disturbed(&stereo(9, 0.2, 4), 4);
    let once = solve(&start, &Config::default()).unwrap();
    let again = solve(&start, &Config::default()).unwrap();
    assert_eq!(once.cost.to_bits(), again.cost.to_bits());
    assert_eq!(once.problem.instants, again.problem.instants);
}

proptest! {
    /// The gradient is that of the cost: by differences, over all kinds of parameters.
    #[test]
    fn gradient_agrees_with_differences_of_the_cost(seed in 0u64..1000) {
        let problem = disturbed(&stereo(2, 0.3, seed), seed);
        let layout = super::normal::Layout::new(&problem);
        let loss = super::normal::Loss { scale: 1.0, knee: 1e9, unprojected_sigma: 30.0 };
        // With the poses fixed: the part of the gradient removed by the elimination is added back.
        let normal = super::normal::build(&problem, &layout, &loss, 0.0);
        let mut gradient = normal.gradient.clone();
        for share in &normal.instant_blocks {
            let through = &share.mixed * share.inverse * share.gradient;
            for (row, &c) in share.columns.iter().enumerate() {
                gradient[c] += through[row];
            }
        }
        let h = 1e-6;
        for (c, parameter) in problem.parameters().into_iter().enumerate() {
            let at = |by: f64| {
                let mut moved_problem = problem.clone();
                match parameter {
                    Parameter::Lens(i, k) => {
                        let mut p = problem.lenses[i].model.parameters();
                        p[k] += by;
                        moved_problem.lenses[i].model = problem.lenses[i].model.with_parameters(&p);
                    }
                    Parameter::Pose(i, k) => {
                        let mut step = Vector6::zeros();
                        step[k] = by;
                        let place = &mut moved_problem.poses[i];
                        place.parent_from_child = moved(&place.parent_from_child, &step);
                    }
                }
                super::normal::cost(&moved_problem, &loss)
            };
            let difference = (at(h) - at(-h)) / (2.0 * h);
            let off = (gradient[c] - difference).abs() / (1.0 + difference.abs());
            prop_assert!(off < 1e-4, "{}: {} {difference}", problem.name(parameter), gradient[c]);
        }
    }
}

#[test]
fn pose_of_a_single_view_is_recovered() {
    let truth = stereo(3, 0.1, 9);
    let view = &truth.views[0];
    let start = moved(
        &truth.instants[0],
        &Vector6::new(0.05, 0.05, 0.1, 0.1, 0.1, 0.1),
    );
    let (found, rms) = locate(
        &truth.lenses[0].model,
        &view.points,
        &start,
        &LocateConfig::default(),
    )
    .unwrap();
    assert!(step_between(&truth.instants[0], &found).amax() < 5e-3);
    assert!(rms < 0.2);
}
