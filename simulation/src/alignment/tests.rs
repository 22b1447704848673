use cad_transforms::RigidTransform;
use nalgebra::UnitQuaternion;
use scene_bundle::{Pose, Trajectory};

use super::*;
use crate::scene::rigid;

/// True position of a walk with turns and steps at a time in s, m.
fn position(t: f64) -> Vector3<f64> {
    let turn = 0.25 * t;
    let radius = 6.0 + 2.0 * libm::sin(0.11 * t);
    Vector3::new(
        radius * libm::cos(turn),
        radius * libm::sin(turn),
        0.8 * libm::sin(0.4 * t),
    )
}

fn world_from_body(t: f64) -> RigidTransform {
    let along = position(t + 1e-3) - position(t);
    let yaw = libm::atan2(along.y, along.x);
    rigid(
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw),
        position(t),
    )
}

fn true_transform(scale: f64) -> Similarity {
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::new(0.3, -0.5, 1.9));
    Similarity::from_parts(scale, rotation, Vector3::new(12.0, -40.0, 3.0))
}

/// The walk in both frames: 30 s, the estimate at 10 Hz with noise of a standard deviation in m and
/// a share of outliers, the reference at 25 Hz with another clock.
struct Case {
    sigma_m: f64,
    outliers: f64,
    clock_s: f64,
    truth: Similarity,
    seed: u64,
}

impl Case {
    fn estimate_from_reference_noise(&self, i: u64) -> (Vector3<f64>, bool) {
        let normal = |k: u64| {
            // Box-Muller.
            let u = [0, 1].map(|j| counter_random::uniform(self.seed, 100 + 2 * k + j, i));
            (-2.0 * libm::log(u[0])).sqrt() * libm::cos(std::f64::consts::TAU * u[1])
        };
        let is_outlier = counter_random::uniform(self.seed, 200, i) < self.outliers;
        let sigma = if is_outlier { 2.0 } else { self.sigma_m };
        let noise = Vector3::new(normal(0), normal(1), normal(2)) * sigma;
        (noise, is_outlier)
    }

    /// Both trajectories, and which poses of the estimate are outliers.
    fn trajectories(&self) -> (Trajectory, Trajectory, Vec<bool>) {
        let (mut estimate, mut outliers) = (Vec::new(), Vec::new());
        let inverse = self.truth.inverse();
        for i in 0..300_u64 {
            let t = 0.1 * i as f64;
            let (noise, is_outlier) = self.estimate_from_reference_noise(i);
            let pose = inverse.carry(&world_from_body(t));
            let position = Vector3::from(pose.translation_m()) + noise / self.truth.scale();
            let pose = rigid(*pose.rotation(), position);
            estimate.push(Pose::new(i as i64 * 100_000_000, pose));
            outliers.push(is_outlier);
        }
        let reference = (-20..800).map(|i: i64| {
            let time_ns = i * 40_000_000 + (self.clock_s * 1e9) as i64;
            Pose::new(time_ns, world_from_body(0.04 * i as f64))
        });
        let [estimate, reference] =
            [estimate, reference.collect()].map(|poses| Trajectory::new(poses).unwrap());
        (estimate, reference, outliers)
    }
}

/// Errors in units of the parameters: rotation, translation at the center, log scale, clock.
fn errors(case: &Case, found: &Alignment) -> [f64; 8] {
    let rotation = found.reference_from_estimate.rotation() * case.truth.rotation().inverse();
    let center = case.truth.inverse().apply(found.center_m);
    let moved = Vector3::from(found.reference_from_estimate.apply(center));
    let translation = moved - Vector3::from(found.center_m);
    let scale = libm::log(found.reference_from_estimate.scale() / case.truth.scale());
    let rotation = rotation.scaled_axis();
    let clock = found.clock_offset_ns as f64 * 1e-9 - case.clock_s;
    [
        rotation.x,
        rotation.y,
        rotation.z,
        translation.x,
        translation.y,
        translation.z,
        scale,
        clock,
    ]
}

/// Exam 6.17: root mean square errors over seeds against the Cramér-Rao bound of the inliers that
/// a perfect detector would keep.
#[test]
fn errors_are_within_one_and_a_half_of_the_bound() {
    for (model, scale) in [
        (AlignmentModel::Rigid, 1.0),
        (AlignmentModel::Similarity, 1.7),
    ] {
        let (mut squares, mut bounds, mut stated) = ([0.0; 8], [0.0; 8], [0.0; 8]);
        let seeds = 100;
        for seed in 0..seeds {
            let case = Case {
                sigma_m: 0.02,
                outliers: 0.3,
                clock_s: 0.08,
                truth: true_transform(scale),
                seed,
            };
            let (estimate, reference, outliers) = case.trajectories();
            let config = AlignmentConfig::default();
            let found = align_trajectories(&estimate, &reference, model, &config).unwrap();
            let error = errors(&case, &found);
            // The bound: the covariance of exact residuals with the true noise.
            let inliers: Vec<bool> = outliers.iter().map(|is_outlier| !is_outlier).collect();
            let pairs = associate(&estimate, &reference, case.clock_s, config.max_gap_s);
            let exact = fit::Fit {
                transform: case.truth,
                inliers: inliers[..pairs.all.len()].to_vec(),
            };
            let bound = fit::result(&pairs, &exact, model, true, case.clock_s).unwrap();
            let variance = bound.residual_m * bound.residual_m / 3.0;
            let exactly = case.sigma_m * case.sigma_m / variance;
            for k in 0..8 {
                squares[k] += error[k] * error[k];
                bounds[k] += bound.covariance[(k, k)] * exactly;
                stated[k] += found.covariance[(k, k)];
            }
            assert!(found.residual_m < 0.04, "{}", found.residual_m);
        }
        for k in 0..8 {
            if model == AlignmentModel::Rigid && k == 6 {
                continue;
            }
            let ratio = f64::sqrt(squares[k] / bounds[k]);
            let of_stated = f64::sqrt(stated[k] / bounds[k]);
            println!("{model:?} {k}: {ratio:.2} of the bound, stated {of_stated:.2}");
            assert!(ratio < 1.5, "{model:?} {k}: {ratio}");
            assert!(
                (0.8..1.25).contains(&of_stated),
                "{model:?} {k}: {of_stated}"
            );
        }
    }
}

#[test]
fn exact_poses_align_exactly() {
    for clock_s in [0.0, 0.08, -0.15] {
        let case = Case {
            sigma_m: 0.0,
            outliers: 0.0,
            clock_s,
            truth: true_transform(0.6),
            seed: 1,
        };
        let (estimate, reference, _) = case.trajectories();
        let (model, config) = (AlignmentModel::Similarity, AlignmentConfig::default());
        let found = align_trajectories(&estimate, &reference, model, &config).unwrap();
        let error = errors(&case, &found);
        // What straight lines between poses of the reference cost.
        assert!(error.iter().all(|v| v.abs() < 1e-3), "{error:?}");
        assert!(error[7].abs() < 2e-4, "{error:?}");
    }
}

fn refusal(estimate: &[[f64; 3]], reference: &[[f64; 3]]) -> String {
    let (model, config) = (AlignmentModel::Similarity, AlignmentConfig::default());
    align_points(estimate, reference, model, &config)
        .unwrap_err()
        .to_string()
}

#[test]
fn straight_paths_are_refused() {
    for sigma in [0.0, 0.01, 0.1] {
        let noise = |stream: u64, i: u64| sigma * counter_random::bell(3, stream, i);
        let line = |first: u64| -> Vec<[f64; 3]> {
            let noise = |k: u64, i: u64| noise(first + k, i);
            let at = |i: u64| [0.1 * i as f64 + noise(0, i), noise(1, i), noise(2, i)];
            (0..300).map(at).collect()
        };
        let error = refusal(&line(0), &line(10));
        assert!(error.contains("a straight path"), "{error}");
    }
}

#[test]
fn mirrored_positions_are_refused() {
    let points: Vec<[f64; 3]> = (0..200)
        .map(|i| position(0.15 * f64::from(i)).into())
        .collect();
    let mirrored: Vec<[f64; 3]> = points.iter().map(|[x, y, z]| [*x, -y, *z]).collect();
    let error = refusal(&mirrored, &points);
    assert!(error.contains("mirrored positions"), "{error}");
}

#[test]
fn mirrored_poses_on_level_ground_are_refused() {
    // Positions alone could be upside down.
    let pose = |i: i64, side: f64| {
        let t = 0.1 * i as f64;
        let pose = world_from_body(t);
        let [x, y, _] = pose.translation_m();
        let yaw = side * pose.rotation_vector()[2];
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw);
        Pose::new(
            i * 100_000_000,
            rigid(rotation, Vector3::new(x, side * y, 0.0)),
        )
    };
    let walk = |side: f64| Trajectory::new((0..300).map(|i| pose(i, side)).collect()).unwrap();
    let (model, config) = (AlignmentModel::Rigid, AlignmentConfig::default());
    let error = align_trajectories(&walk(-1.0), &walk(1.0), model, &config).unwrap_err();
    assert!(
        error
            .to_string()
            .contains("a body that is rotated by 180.0 degrees"),
        "{error}"
    );
    // Positions alone were mirrored, as by a swap of axes.
    let (right, left) = (walk(1.0).into_poses(), walk(-1.0).into_poses());
    let mixed = right.into_iter().zip(left).map(|(right, left)| {
        let pose = rigid(
            *right.world_from_rig.rotation(),
            *left.world_from_rig.translation(),
        );
        Pose::new(right.time_ns, pose)
    });
    let mixed = Trajectory::new(mixed.collect()).unwrap();
    let error = align_trajectories(&mixed, &walk(1.0), model, &config).unwrap_err();
    assert!(error.to_string().contains("poses that turn"), "{error}");
    align_trajectories(&walk(1.0), &walk(1.0), model, &config).unwrap();
}

#[test]
fn gaps_of_the_reference_are_not_interpolated() {
    let case = Case {
        sigma_m: 0.0,
        outliers: 0.0,
        clock_s: 0.0,
        truth: true_transform(1.0),
        seed: 1,
    };
    let (estimate, reference, _) = case.trajectories();
    let with_gap = reference.poses().iter().filter(|pose| {
        let t = pose.time_ns as f64 * 1e-9;
        !(5.0..8.0).contains(&t)
    });
    let with_gap = Trajectory::new(with_gap.cloned().collect()).unwrap();
    let pairs = associate(&estimate, &with_gap, 0.0, 0.25);
    assert_eq!(associate(&estimate, &reference, 0.0, 0.25).all.len(), 300);
    assert_eq!(pairs.all.len(), 270);
    // Without any common time.
    let late = reference.poses()[..4].to_vec();
    let config = AlignmentConfig::default();
    let late = Trajectory::new(late).unwrap();
    let error = align_trajectories(&estimate, &late, AlignmentModel::Rigid, &config).unwrap_err();
    assert!(
        error.to_string().contains("0 pairs of positions"),
        "{error}"
    );
}

#[test]
fn damaged_input_is_an_error() {
    let (model, config) = (AlignmentModel::Rigid, AlignmentConfig::default());
    let (points, broken) = ([[0.0; 3]; 20], [[f64::NAN; 3]; 20]);
    for (estimate, reference) in [(&points[..], &points[..10]), (&broken[..], &points[..])] {
        let error = align_points(estimate, reference, model, &config).unwrap_err();
        assert!(matches!(error, SimulationError::Setting { .. }), "{error}");
    }
    // All at one place.
    let error = align_points(&points, &points, model, &config).unwrap_err();
    assert!(matches!(error, SimulationError::Scene { .. }), "{error}");
}
