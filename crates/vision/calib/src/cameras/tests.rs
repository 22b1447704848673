use boards::Target;
use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion, Lens};
use nalgebra::Matrix6;

use super::*;
use crate::adjust::tests::Noise;
use crate::target::DetectedCorner;
use crate::target::{self, ImageView};
use crate::test_data::{grey, shared};

/// Detections of the real infrared pairs: 12 pairs of 640x512, 9 x 6 inner corners.
fn chessboard_pairs() -> Option<Input> {
    let folder = shared("06_calibration/stereo_chessboard_rigB")?;
    let board = Target::Chessboard {
        columns: 9,
        rows: 6,
        square_m: 0.05,
    };
    let mut input = Input {
        eyes: ["left", "right"]
            .map(|name| Eye {
                name: name.to_owned(),
                size: (640, 512),
                factory: None,
            })
            .to_vec(),
        cameras: vec![Camera {
            name: "pair".to_owned(),
            left: 0,
            right: Some(1),
            left_from_right: None,
            rig_from_left: None,
        }],
        targets: vec![board],
        times_ns: (0..12).map(|i| i * 1_000_000_000).collect(),
        detections: Vec::new(),
    };
    for instant in 0..12 {
        for (eye, name) in ["left", "right"].into_iter().enumerate() {
            let path = folder.join(format!("{name}{:02}.jpg", instant + 1));
            let (width, height, pixels) = grey(&path);
            let view = ImageView::new(width, height, width, &pixels).unwrap();
            let found = target::detect(&view, &input.targets[0], &target::Config::default());
            assert_eq!(found.corners.len(), 54, "{}", path.display());
            input.detections.push(TargetDetection {
                instant,
                eye,
                target: 0,
                corners: found.corners,
            });
        }
    }
    Some(input)
}

#[test]
fn real_chessboard_pairs() {
    let Some(input) = chessboard_pairs() else {
        return;
    };
    let found = calibrate(input, &Config::default(), &mut |_, _| {}).unwrap();
    // OpenCV over the full set: 0.23 px; tests/tests/calib_exam.rs has both in one run.
    let rms = found.solution.rms_px(|_| true);
    assert!(rms < 0.15, "{rms}");
    assert!((found.lens(0).fx - found.lens(1).fx).abs() < 8.0);
    // These files have left and right exchanged.
    assert!(failures(&found)[0].contains("left and right are swapped"));
}

/// A rig of three cameras in front of two boards, as [`crate::cameras`] would get it from a
/// recording, and its ground truth.
struct SimulatedRig {
    input: Input,
    /// `rig_from_left` and `left_from_right` by camera.
    cameras: Vec<(RigidTransform, RigidTransform)>,
}

/// Deviations from a good recording.
#[derive(Clone, Copy)]
struct Imperfections {
    noise_px: f64,
    instants: usize,
    /// Scale of the boards relative to their nominal size.
    size: f64,
    /// Sagitta of the first board, m: its middle under its rim.
    sagitta_m: f64,
    /// Rotation of the first camera in the middle of the recording, rad.
    knock_rad: f64,
    /// Without tilt or roll.
    straight: bool,
}

const GOOD: Imperfections = Imperfections {
    noise_px: 0.1,
    instants: 120,
    size: 1.0,
    sagitta_m: 0.0,
    knock_rad: 0.0,
    straight: false,
};

fn transform(rotation: [f64; 3], at: [f64; 3]) -> RigidTransform {
    RigidTransform::from_rotation_vector(rotation, at).unwrap()
}

/// An optical frame (x right, y down) that looks along x of the rig (z up), rotated left by `yaw`
/// and down by `pitch`.
fn looking(yaw: f64, pitch: f64, at: [f64; 3]) -> RigidTransform {
    let forward = RigidTransform::from_wxyz([0.5, -0.5, 0.5, -0.5], [0.0; 3]).unwrap();
    transform([0.0; 3], at)
        * transform([0.0, 0.0, yaw], [0.0; 3])
        * transform([0.0, pitch, 0.0], [0.0; 3])
        * forward
}

fn simulate(seed: u64, trouble: Imperfections) -> SimulatedRig {
    let mut noise = Noise::new(seed);
    let mut lens = || CameraModel {
        width: 672,
        height: 376,
        fx: 340.0 + 3.0 * noise.normal(),
        fy: 340.0 + 3.0 * noise.normal(),
        cx: 335.5 + 3.0 * noise.normal(),
        cy: 187.5 + 3.0 * noise.normal(),
        distortion: Distortion::RadTan5 {
            k1: -0.17 + 0.004 * noise.normal(),
            k2: 0.026 + 0.001 * noise.normal(),
            p1: 3e-4 * noise.normal(),
            p2: 3e-4 * noise.normal(),
            k3: -1e-3,
        },
    };
    let lenses: Vec<CameraModel> = (0..6).map(|_| lens()).collect();
    let nominal = [
        looking(0.5, 0.1, [0.02, 0.15, 0.1]),
        looking(-0.5, 0.1, [0.02, -0.15, 0.1]),
        looking(0.0, 1.2, [0.08, 0.0, -0.12]),
    ];
    let mut shake = |mean: &RigidTransform, m: f64, rad: f64| {
        let by = [0; 6].map(|_| noise.normal());
        let turn = transform([rad * by[3], rad * by[4], rad * by[5]], [0.0; 3]);
        *mean * turn * transform([0.0; 3], [m * by[0], m * by[1], m * by[2]])
    };
    let baselines = [0.05, 0.05, 0.063].map(|b| transform([0.0; 3], [b, 0.0, 0.0]));
    let cameras: Vec<(RigidTransform, RigidTransform)> = nominal
        .iter()
        .zip(&baselines)
        .map(|(rig_from_left, pair)| (shake(rig_from_left, 1e-3, 3e-3), shake(pair, 5e-5, 2e-3)))
        .collect();
    let board = |first_id: u32, tag_m: f64| Target::AprilGrid {
        columns: 6,
        rows: 6,
        tag_m,
        spacing: 0.3,
        first_id,
    };
    let tolerance = |m: f64, rad: f64| {
        Matrix6::from_diagonal(&[m * m, m * m, m * m, rad * rad, rad * rad, rad * rad].into())
    };
    let names = ["left_shoulder", "right_shoulder", "feet"];
    let mut input = Input {
        eyes: (0..6)
            .map(|i| Eye {
                name: format!("{}/{}", names[i / 2], ["left", "right"][i % 2]),
                size: (672, 376),
                factory: Some(CameraModel {
                    fx: 340.0,
                    fy: 340.0,
                    cx: 335.5,
                    cy: 187.5,
                    distortion: Distortion::RadTan5 {
                        k1: -0.17,
                        k2: 0.026,
                        p1: 0.0,
                        p2: 0.0,
                        k3: 0.0,
                    },
                    ..lenses[i]
                }),
            })
            .collect(),
        cameras: (0..3)
            .map(|c| Camera {
                name: names[c].to_owned(),
                left: 2 * c,
                right: Some(2 * c + 1),
                left_from_right: Some(ExtrinsicsPrior {
                    transform: baselines[c],
                    covariance: tolerance(1e-4, 2e-3),
                }),
                rig_from_left: Some(ExtrinsicsPrior {
                    transform: nominal[c],
                    covariance: tolerance(1e-3, 3e-3),
                }),
            })
            .collect(),
        targets: vec![board(0, 0.088), board(36, 0.088)],
        times_ns: (0..trouble.instants as i64)
            .map(|i| i * 500_000_000)
            .collect(),
        detections: Vec::new(),
    };
    // One board ahead, one on the floor; x of the world along the view, z up.
    let world_from_board = [
        looking(0.0, 0.0, [1.1, 0.0, 1.2]) * transform([0.0; 3], [-0.36, -0.36, 0.0]),
        looking(0.0, 1.5, [0.5, 0.0, 0.15]) * transform([0.0; 3], [-0.36, -0.36, 0.0]),
    ];
    for instant in 0..trouble.instants {
        let tilt = if trouble.straight { 0.0 } else { 0.3 };
        let mut about = |sigma: f64| sigma * noise.normal().clamp(-2.0, 2.0);
        let (yaw, pitch, roll) = (about(0.55), about(tilt), about(1.3 * tilt));
        let at = [about(0.15), about(0.15), 1.2 + about(0.12)];
        let world_from_rig = transform([0.0; 3], at)
            * transform([0.0, 0.0, yaw], [0.0; 3])
            * transform([0.0, pitch, 0.0], [0.0; 3])
            * transform([roll, 0.0, 0.0], [0.0; 3]);
        for eye in 0..6 {
            let (mut rig_from_left, left_from_right) = cameras[eye / 2];
            if eye < 2 && instant * 2 > trouble.instants {
                rig_from_left = rig_from_left * transform([0.0, trouble.knock_rad, 0.0], [0.0; 3]);
            }
            let rig_from_eye = match eye % 2 {
                0 => rig_from_left,
                _ => rig_from_left * left_from_right,
            };
            let eye_from_world = (world_from_rig * rig_from_eye).inverse();
            for (target, board) in world_from_board.iter().enumerate() {
                let eye_from_board = eye_from_world * *board;
                let seen = Lens::new(&lenses[eye]);
                let corners: Vec<DetectedCorner> = input.targets[target]
                    .corners()
                    .iter()
                    .filter_map(|corner| {
                        let [x, y] = corner.at_m.map(|v| v * trouble.size);
                        let (u, v) = (x / 0.36 - 1.0, y / 0.36 - 1.0);
                        let bend = if target == 0 { trouble.sagitta_m } else { 0.0 };
                        let z = bend * (1.0 - 0.5 * (u * u + v * v));
                        let [px, py] = seen.project(eye_from_board.apply([x, y, z]))?;
                        let inside = (2.0..669.0).contains(&px) && (2.0..373.0).contains(&py);
                        // The back of a board shows nothing.
                        let normal = eye_from_board.rotate([0.0, 0.0, 1.0]);
                        let at = eye_from_board.apply([x, y, z]);
                        let front: f64 = normal.iter().zip(at).map(|(a, b)| a * b).sum();
                        (inside && front > 0.1).then(|| DetectedCorner {
                            id: corner.id,
                            pixel: [
                                px + trouble.noise_px * noise.normal(),
                                py + trouble.noise_px * noise.normal(),
                            ],
                            sigma_px: 0.05,
                        })
                    })
                    .collect();
                if corners.len() >= 12 {
                    input.detections.push(TargetDetection {
                        instant,
                        eye,
                        target,
                        corners,
                    });
                }
            }
        }
    }
    SimulatedRig { input, cameras }
}

/// Errors of one run: poses of cameras in the first one, `(m, rad, in sigmas)` per coordinate.
fn rig_errors(truth: &SimulatedRig, found: &Calibration) -> Vec<(f64, f64)> {
    let mut errors = Vec::new();
    let mut add = |truth: RigidTransform, found: RigidTransform, covariance: Matrix6<f64>| {
        let off = crate::adjust::step_between(&truth, &found);
        errors.extend((0..6).map(|k| (off[k], covariance[(k, k)].sqrt())));
    };
    for camera in 0..3 {
        let (place, covariance) = found.pose(found.poses.pairs[camera].unwrap());
        add(truth.cameras[camera].1, place, covariance);
    }
    for camera in 1..3 {
        let (place, covariance) = found.left_from_left(0, camera).unwrap();
        add(
            truth.cameras[0].0.inverse() * truth.cameras[camera].0,
            place,
            covariance,
        );
    }
    errors
}

fn quiet(input: &Input) -> Calibration {
    let config = Config {
        choose_lens: false,
        ..Config::default()
    };
    calibrate(input.clone(), &config, &mut |_, _| {}).unwrap()
}

fn failures(found: &Calibration) -> Vec<&str> {
    let bad = found
        .findings
        .iter()
        .filter(|f| f.severity == Severity::Fail);
    bad.map(|f| f.text.as_str()).collect()
}

#[test]
fn good_recording_gives_the_rig_within_its_sigmas() {
    let (mut inside, mut all) = (0, 0);
    for seed in 0..3 {
        let truth = simulate(seed, GOOD);
        let found = quiet(&truth.input);
        assert_eq!(failures(&found), Vec::<&str>::new(), "seed {seed}");
        // 0.1 px in each coordinate are 0.141 px of length.
        let rms = found.solution.rms_px(|_| true);
        assert!((0.135..0.15).contains(&rms), "{rms}");
        for (k, (off, sigma)) in rig_errors(&truth, &found).into_iter().enumerate() {
            inside += usize::from(off.abs() <= 2.0 * sigma);
            all += 1;
            // The first 18 belong to the pairs, whose rotation about their own baseline is
            // correlated with the lenses.
            let limit = if k % 6 < 3 {
                1e-3
            } else {
                0.05f64.to_radians()
            };
            assert!(
                k < 18 || off.abs() < limit,
                "seed {seed}, {k}: {off} of {sigma}"
            );
        }
    }
    // 95.4 % of 90 are expected; 11 or more are outside by chance once in 380 times (binomial).
    assert!(all - inside <= 10, "{inside} of {all}");
}

#[test]
fn simplest_lens_model_that_predicts_is_selected() {
    let truth = simulate(
        1,
        Imperfections {
            instants: 60,
            ..GOOD
        },
    );
    let found = calibrate(truth.input.clone(), &Config::default(), &mut |_, _| {}).unwrap();
    for choice in &found.choices {
        let name = choice.candidates[choice.chosen].model;
        assert!(
            ["rad_tan4", "rad_tan5", "kannala_brandt4"].contains(&name),
            "{choice:?}"
        );
        assert_eq!(choice.candidates[0].model, "none");
        assert!(choice.candidates[0].rms_px > 1.0);
    }
}

#[test]
fn defective_recording_gives_a_finding() {
    let check = |name: &str, trouble: Imperfections, expected: &str| {
        let found = quiet(&simulate(3, trouble).input);
        let all: Vec<&str> = found.findings.iter().map(|f| f.text.as_str()).collect();
        assert!(all.iter().any(|t| t.contains(expected)), "{name}: {all:#?}");
    };
    check(
        "size",
        Imperfections { size: 1.01, ..GOOD },
        "is the target's size what its file says",
    );
    check(
        "not flat",
        Imperfections {
            sagitta_m: 0.003,
            ..GOOD
        },
        "target 0 is not flat",
    );
    check(
        "knocked",
        Imperfections {
            knock_rad: 0.009,
            ..GOOD
        },
        "left_shoulder moved during the recording, about 3",
    );
    check(
        "straight",
        Imperfections {
            straight: true,
            ..GOOD
        },
        "tilted by more than 20 degrees",
    );
}

#[test]
fn too_few_views_are_an_error_that_names_the_eye() {
    let mut input = simulate(
        0,
        Imperfections {
            instants: 30,
            ..GOOD
        },
    )
    .input;
    input.detections.retain(|s| s.eye != 3 || s.instant < 2);
    let error = calibrate(input, &Config::default(), &mut |_, _| {})
        .map(|c| c.used)
        .unwrap_err();
    let text = error.to_string();
    assert!(
        text.starts_with("calibrating right_shoulder/right: a target was detected in"),
        "{text}"
    );
}

#[test]
fn factory_file_of_another_camera_is_detected() {
    let mut truth = simulate(5, GOOD);
    for eye in 0..2 {
        let factory = truth.input.eyes[eye].factory.as_mut().unwrap();
        (factory.fx, factory.fy) = (520.0, 520.0);
    }
    let found = quiet(&truth.input);
    assert!(!failures(&found).is_empty(), "{:?}", found.findings);
}

#[test]
fn nominal_pose_without_tolerance_is_fixed() {
    let mut truth = simulate(3, GOOD);
    let origin = RigidTransform::body_from_optical();
    let rig_from_rig = origin * truth.cameras[0].0.inverse();
    for (camera, (place, _)) in truth.input.cameras.iter_mut().zip(&truth.cameras) {
        camera.rig_from_left.as_mut().unwrap().transform = rig_from_rig * *place;
    }
    truth.input.cameras[0].rig_from_left = Some(ExtrinsicsPrior {
        transform: origin,
        covariance: Matrix6::zeros(),
    });
    let found = quiet(&truth.input);
    let place = found.pose(found.poses.cameras[0].unwrap());
    assert_eq!(place, (origin, Matrix6::zeros()));
    let (_, covariance) = found.pose(found.poses.cameras[1].unwrap());
    assert!(covariance.trace() > 0.0);
}

#[test]
fn camera_not_connected_with_the_origin_gives_a_finding() {
    let mut input = simulate(3, GOOD).input;
    for camera in &mut input.cameras {
        camera.rig_from_left = None;
    }
    // The first camera sees boards when the others see none.
    input
        .detections
        .retain(|s| (s.eye < 2) == (s.instant % 2 == 0));
    let found = quiet(&input);
    let expected = "right_shoulder, feet could not be connected with left_shoulder, the origin";
    let failures = failures(&found);
    assert!(
        failures.iter().any(|f| f.contains(expected)),
        "{failures:?}"
    );
}

/// Boards alone: no lens, no baseline and no camera pose is given.
#[test]
fn without_nominal_poses_the_first_camera_is_the_origin() {
    let mut truth = simulate(2, GOOD);
    for eye in &mut truth.input.eyes {
        eye.factory = None;
    }
    for camera in &mut truth.input.cameras {
        (camera.left_from_right, camera.rig_from_left) = (None, None);
    }
    // The origin is the first of the list, whichever board it observes.
    truth.input.cameras.reverse();
    truth.cameras.reverse();
    assert_eq!(truth.input.origin(), Some(0));
    let found = calibrate(truth.input.clone(), &Config::default(), &mut |_, _| {}).unwrap();
    assert_eq!(failures(&found), Vec::<&str>::new());
    let (origin, covariance) = found.pose(found.poses.cameras[0].unwrap());
    assert_eq!(origin, RigidTransform::body_from_optical());
    assert_eq!(covariance, Matrix6::zeros());
    for camera in 1..3 {
        let (rig_from_left, covariance) = found.pose(found.poses.cameras[camera].unwrap());
        let true_place = RigidTransform::body_from_optical()
            * truth.cameras[0].0.inverse()
            * truth.cameras[camera].0;
        let off = true_place.inverse() * rig_from_left;
        let (mm, degrees) = (1e3 * off.distance_m(), off.angle_rad().to_degrees());
        assert!(
            mm < 2.0 && degrees < 0.1,
            "{camera}: {mm} mm, {degrees} degrees"
        );
        // The stated sigmas are of the size of the errors.
        let sigma_mm = 1e3 * (covariance.trace()).sqrt();
        assert!((0.01..2.0).contains(&sigma_mm), "{camera}: {sigma_mm} mm");
    }
    let mut nominal = simulate(2, GOOD).input;
    assert_eq!(nominal.origin(), None);
    nominal.cameras.truncate(1);
    nominal.cameras[0].rig_from_left = None;
    assert_eq!(nominal.origin(), Some(0));
}
