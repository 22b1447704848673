//! Analytic Jacobians of the factors against finite differences.

use camera_models::{CameraModel, Distortion};

use super::super::ImuSample;
use super::super::config::{SampleConfig, ViewConfig};
use super::super::simulate::{Random, ZED_NOISE};
use super::*;

fn random_vector(random: &mut Random, size: f64) -> Vector3<f64> {
    Vector3::new(random.normal(), random.normal(), random.normal()) * size
}

/// Two states and all other parameters, far from a solution.
fn example() -> (Vec<State>, Shared, Track) {
    let mut random = Random::new(5);
    let states = (0..2)
        .map(|_| State {
            rotation: so3::exp(&random_vector(&mut random, 0.4)),
            position: random_vector(&mut random, 0.3),
            velocity: random_vector(&mut random, 0.5),
            gyro_bias: random_vector(&mut random, 0.01),
            accel_bias: random_vector(&mut random, 0.1),
        })
        .collect();
    let shared = Shared {
        rotation: so3::exp(&random_vector(&mut random, 1.0)),
        translation: random_vector(&mut random, 0.05),
        offset_s: 0.003,
        drift: 1e-4,
        gravity: random_vector(&mut random, 1.0).normalize() * GRAVITY,
        board_scale: 1.01,
        gyro_shape: Matrix3::identity() + Matrix3::from_fn(|_, _| 0.01 * random.normal()),
        accel_shape: Matrix3::identity() + Matrix3::from_fn(|_, _| 0.01 * random.normal()),
    };
    // Samples so dense that the steps of linear interpolation are negligible.
    let samples: Vec<ImuSample> = (0..8000)
        .map(|k| {
            let t = f64::from(k) * 5e-5;
            ImuSample {
                time_ns: i64::from(k) * 50_000,
                gyro: [(3.0 * t).sin(), (4.0 * t).cos(), 0.7],
                accel: [3.0 * (5.0 * t).cos(), 1.0 + t, 9.0 + (6.0 * t).sin()],
            }
        })
        .collect();
    (
        states,
        shared,
        Track::new(&samples, 0, [f64::INFINITY; 2], &SampleConfig::default()),
    )
}

fn check<const M: usize>(
    name: &str,
    found: &WhitenedFactor<M>,
    of: impl Fn(&[State], &Shared) -> WhitenedFactor<M>,
    (states, shared): (&[State], &Shared),
) {
    let near = |column: usize, what: &str, by: SVector<f64, M>, expected: SVector<f64, M>| {
        let size = expected.amax().max(1.0);
        let error = (by - expected).amax() / size;
        assert!(
            error < 2e-5,
            "{name} by {what} {column}: {error:e}\n{by}{expected}"
        );
    };
    for k in 0..STATE {
        for which in 0..2 {
            let h = 1e-6;
            let moved = |sign: f64| {
                let mut step = SVector::<f64, STATE>::zeros();
                step[k] = sign * h;
                let mut states = states.to_vec();
                states[which] = states[which].moved(&step);
                of(&states, shared).residual
            };
            let by = (moved(1.0) - moved(-1.0)) / (2.0 * h);
            match (which, &found.next) {
                (0, _) => near(k, "first", by, found.own.column(k).into()),
                (_, Some(next)) => near(k, "second", by, next.column(k).into()),
                (_, None) => near(k, "second", by, SVector::zeros()),
            }
        }
    }
    for k in 0..SHARED {
        let h = if k == DRIFT { 1e-5 } else { 1e-6 };
        let moved = |sign: f64| {
            let mut step = SVector::<f64, SHARED>::zeros();
            step[k] = sign * h;
            of(states, &shared.moved(&step)).residual
        };
        let by = (moved(1.0) - moved(-1.0)) / (2.0 * h);
        near(k, "shared", by, found.shared.column(k).into());
    }
}

#[test]
fn jacobians_of_all_factors_agree_with_differences() {
    let (states, shared, track) = example();
    let model = CameraModel {
        width: 640,
        height: 480,
        fx: 500.0,
        fy: 500.0,
        cx: 320.0,
        cy: 240.0,
        distortion: Distortion::None,
    };
    let cameras = Cameras::new(&model, None);
    let view = |time_s: f64| View {
        config: ViewConfig::default(),
        time_s,
        time_ns: 0,
        corners: &[],
        inlier_corners: 0,
        motion: CameraMotion::NONE,
    };
    let views = [view(0.1), view(0.15)];
    let prior = Prior {
        shared: Shared {
            rotation: shared.rotation * so3::exp(&Vector3::new(0.3, -0.2, 0.5)),
            ..shared
        },
        // There is no prior on the direction of gravity.
        sigmas: SVector::from_fn(|k, _| match k {
            DOWN..BOARD => f64::INFINITY,
            _ => 0.1 + 0.01 * k as f64,
        }),
        fixed: FixedDirections {
            rotation: vec![Vector3::new(0.6, 0.0, 0.8)],
            translation: vec![Vector3::y()],
            offset: true,
        },
        biases: [0.05, 0.5],
    };
    let config = SolverConfig::default();
    let problem = Problem {
        config: &config,
        cameras: &cameras,
        views: &views,
        poses: &[],
        track: &track,
        links: &[true],
        noise: ZED_NOISE,
        prior,
        corner_scale: 1.0,
        factors: Factors {
            poses: 1.3,
            gyro: 1e4,
            accel: 1e4,
            gyro_walk: 1e3,
            accel_walk: 1e3,
        },
        robust: true,
        middle_s: 7.0,
    };
    let at = (states.as_slice(), &shared);
    let mut root = SMatrix::<f64, VIEW, VIEW>::identity();
    root[(2, 5)] = 0.3;
    let camera = shared.camera(&states[0]);
    let rooted = WhitenedView {
        pose: Pose {
            rotation: camera.rotation * so3::exp(&Vector3::new(0.1, 0.2, -0.1)),
            position: Vector3::new(0.1, -0.3, 0.2),
        },
        board_scale: 1.0,
        root,
        offset: SVector::repeat(0.2),
        rank: 7,
    };
    let image = |s: &[State], shared: &Shared| problem.view_factor(&rooted, &s[0], shared);
    check("view", &image(at.0, at.1), image, at);
    let inertial = |s: &[State], shared: &Shared| {
        let mut raw = Vec::new();
        problem.inertial_plain(0, s, shared, &mut raw).unwrap().0
    };
    check("inertial", &inertial(at.0, at.1), inertial, at);
    let walk = |s: &[State], _: &Shared| problem.walk(0, s);
    check("walk", &walk(at.0, at.1), walk, at);
    let alone = |s: &[State], _: &Shared| problem.isolated(0, &s[0]);
    check("alone", &alone(at.0, at.1), alone, at);
    let prior = |_: &[State], shared: &Shared| problem.prior.factor(shared, config.fixed_sigma);
    let found = prior(at.0, at.1);
    check("prior", &found, prior, at);
}
