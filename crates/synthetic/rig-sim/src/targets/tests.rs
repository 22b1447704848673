use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

use cad_transforms::rig::Rig;
use calib::target::{self, ImageView, detect_all};

use super::*;
use crate::calibration_error::CalibrationError;
use crate::camera::Quality;
use crate::camera::sensor::Tone;
use crate::faults::{Fault, Faults, Kind as FaultKind};
use crate::imu::{GRAVITY, ImuModel};
use crate::scene::{Kind, Lighting};
use crate::simulation::{Imaging, Settings, Simulation, seconds};
use crate::targets::observations::CornerObservation;

fn settings(length_s: f64) -> Settings {
    Settings {
        kind: Kind::Targets,
        lighting: Lighting::Day,
        seed: 4,
        seconds: length_s,
        rate_hz: 10.0,
        width: 672,
        height: 376,
        quality: Quality::FAST,
    }
}

fn example() -> Rig {
    Rig::parse(include_str!(
        "../../../../../cad-transforms/rigs/example.toml"
    ))
    .unwrap()
}

fn session(length_s: f64, plan: &Plan) -> Simulation {
    Simulation::with_targets(&settings(length_s), &example(), plan, &|n| {
        Some(april_grid(n))
    })
    .unwrap()
}

fn with_motion(motion: Motion) -> Plan {
    Plan {
        motion,
        ..Plan::GOOD
    }
}

#[test]
fn every_camera_has_a_board_clear_of_the_floor() {
    for seed in 0..20 {
        let settings = Settings {
            seed,
            ..settings(1.0)
        };
        let simulation = Simulation::new(&settings, &example()).unwrap();
        assert_eq!(simulation.boards().len(), 3);
        let mut ids = BTreeSet::new();
        for board in simulation.boards() {
            assert!(board.lowest_m() >= MIN_CLEARANCE_M);
            let [width, height] = board.sheet().size_m();
            // On A0.
            assert!(width <= 0.841 + 1e-9 && height <= 1.189, "{width} {height}");
            for corner in board.sheet().corners() {
                assert!(ids.insert(corner.id), "{} is on two boards", corner.id);
            }
        }
    }
}

#[test]
fn rig_motion_is_within_the_limits_of_arms() {
    for (motion, rate, force) in [
        (Motion::Varied, 1.5, 5.0),
        (Motion::Still, 0.45, 1.0),
        (Motion::Parallel, 1e-9, 5.0),
    ] {
        let simulation = session(90.0, &with_motion(motion));
        let (mut most, mut still) = ([0.0_f64; 3], 0);
        let mut max_rate = [0.0_f64; 3];
        for k in 0..9000 {
            let state = simulation.walker().rig(0.01 * f64::from(k));
            let values = [
                state.angular_rate.norm(),
                state.acceleration.norm(),
                (state.position - Vector3::from(HOME)).norm(),
            ];
            for (most, value) in most.iter_mut().zip(values) {
                *most = most.max(value);
            }
            for (axis, max_rate) in max_rate.iter_mut().enumerate() {
                *max_rate = max_rate.max(state.angular_rate[axis].abs());
            }
            let quiet = state.angular_rate.norm() < 0.02 && state.velocity.norm() < 0.01;
            still += i32::from(quiet);
        }
        let name = motion.name();
        assert!(most[0] <= rate, "{name}: {most:?}");
        assert!(most[1] <= force, "{name}: {most:?}");
        assert!(most[2] < 1.0, "{name}: {most:?}");
        // At rest for a part of the time.
        assert!((900..8000).contains(&still), "{name}: {still}");
        if motion == Motion::Varied {
            assert!(max_rate.iter().all(|t| *t > 0.8), "{max_rate:?}");
            assert!(most[1] > 2.0, "{most:?}");
        }
    }
}

/// Boards of which at least a few corners are visible.
fn seen_boards(corners: &[CornerObservation]) -> Vec<usize> {
    let mut count = BTreeMap::new();
    for corner in corners {
        *count.entry(corner.board).or_insert(0) += 1;
    }
    count.retain(|_, n| *n >= 8);
    count.into_keys().collect()
}

#[test]
fn boards_cover_every_image_and_connect_cameras() {
    let simulation = session(75.0, &Plan::GOOD);
    let frames = simulation.settings().frame_count();
    // Cells of 6 x 4 in each of the six images.
    let mut cells = vec![BTreeMap::<(i32, i32), i32>::new(); 6];
    let mut ties = BTreeSet::new();
    let (mut together, mut two_boards) = (0, 0);
    for frame in 0..frames {
        let mut seen = Vec::new();
        for camera in 0..3 {
            let target_observations = simulation.target_observations(camera);
            for eye in 0..2 {
                let corners = target_observations.frame(eye, frame);
                for corner in &corners {
                    let [u, v] = corner.pixel;
                    let cell = ((u / 672.0 * 6.0) as i32, (v / 376.0 * 4.0) as i32);
                    *cells[2 * camera + eye].entry(cell).or_default() += 1;
                }
                if eye == 0 {
                    let boards = seen_boards(&corners);
                    two_boards += i32::from(boards.len() > 1);
                    seen.extend(boards.iter().map(|board| (camera, *board)));
                }
            }
        }
        let cameras: BTreeSet<usize> = seen.iter().map(|(camera, _)| *camera).collect();
        together += i32::from(cameras.len() > 1);
        for (_, one) in &seen {
            let others = seen.iter().filter(|(_, other)| one < other);
            ties.extend(others.map(|(_, other)| (*one, *other)));
        }
    }
    for (eye, cells) in cells.iter().enumerate() {
        let thin = cells.values().filter(|n| **n < 20).count();
        assert!(cells.len() == 24 && thin == 0, "eye {eye}: {cells:?}");
    }
    assert!(together > frames as i32 / 2, "{together} of {frames}");
    assert!(two_boards > 100, "{two_boards}");
    assert_eq!(ties.len(), 3, "{ties:?}");
}

/// Tags are large enough for a detector in images of the smallest mode.
#[test]
fn tags_have_twenty_pixels_in_most_views() {
    let simulation = session(75.0, &Plan::GOOD);
    let mut sides = Vec::new();
    for frame in (0..simulation.settings().frame_count()).step_by(5) {
        for camera in 0..3 {
            let corners = simulation.target_observations(camera).frame(0, frame);
            for pair in corners.windows(2) {
                // Bottom left and bottom right of one tag.
                if pair[0].id % 4 == 0 && pair[1].id == pair[0].id + 1 {
                    let [a, b] = [pair[0].pixel, pair[1].pixel];
                    sides.push((a[0] - b[0]).hypot(a[1] - b[1]));
                }
            }
        }
    }
    sides.sort_by(f64::total_cmp);
    let part = |share: f64| sides[(share * sides.len() as f64) as usize];
    assert!(
        part(0.25) > 18.0 && part(0.5) > 21.0,
        "{} {}",
        part(0.25),
        part(0.5)
    );
}

/// Images agree with [`observations`], by a detector that is independent of both: without tone
/// curve and noise, for a rig that differs from its calibration, at rest and in motion.
#[test]
fn corner_observations_agree_with_detections_in_images() {
    let one = Settings {
        seconds: 40.0,
        quality: Quality {
            samples: 8,
            max_samples: 12,
            noise: false,
        },
        ..settings(40.0)
    };
    let simulation = Simulation::new(&one, &example()).unwrap();
    let linear = Imaging {
        exposure_s: Some(1e-3),
        tone: Tone::Linear,
        ..Imaging::USUAL
    };
    let mut calibration_error = CalibrationError::default();
    calibration_error.of_mut("left_shoulder").rotation = Vector3::new(0.02, -0.03, 0.01);
    calibration_error.of_mut("feet").time_offset_ns = 7_000_000;
    let simulation = simulation
        .with_calibration_error(&example(), &calibration_error)
        .unwrap();
    let simulation = Arc::new(simulation.with_imaging(linear).unwrap());
    let boards = simulation.boards().iter();
    let targets: Vec<Target> = boards.map(|b| b.sheet().target().clone()).collect();
    let (mut off, mut missed) = (Vec::new(), 0);
    for camera in 0..3 {
        let mut images = simulation.frames(camera);
        for number in [31, 163] {
            let frame = images.expose(number, simulation.settings().frame_ns(number));
            for eye in 0..2 {
                let gray = frame.gray(eye);
                let view = ImageView::new(672, 376, 672, &gray).unwrap();
                let found = detect_all(&view, &targets, &target::Config::default());
                let is_there = |board: usize, id: u32| {
                    let corners = &found[board].corners;
                    corners.iter().find(|c| c.id == id).map(|c| c.pixel)
                };
                for seen in simulation.target_observations(camera).frame(eye, number) {
                    match is_there(seen.board, seen.id) {
                        Some([u, v]) => off.push([u - seen.pixel[0], v - seen.pixel[1]]),
                        None => missed += 1,
                    }
                }
            }
        }
    }
    let mean = |axis: usize| off.iter().map(|o: &[f64; 2]| o[axis]).sum::<f64>() / off.len() as f64;
    let mut far: Vec<f64> = off.iter().map(|[x, y]| x.hypot(*y)).collect();
    far.sort_by(f64::total_cmp);
    let (median, most) = (far[far.len() / 2], far[far.len() * 19 / 20]);
    let means = [mean(0), mean(1)];
    let report = format!(
        "{} corners, {missed} missed, mean {means:?}, median {median}, 95% {most}",
        off.len()
    );
    assert!(off.len() > 800 && missed < off.len() / 4, "{report}");
    assert!(means.iter().all(|m| m.abs() < 0.01), "{report}");
    assert!(median < 0.045 && most < 0.12, "{report}");
}

#[test]
fn imu_measures_the_motion_of_the_rig() {
    let simulation = session(30.0, &Plan::GOOD);
    let simulation = simulation.with_imus(ImuModel::PERFECT, &example()).unwrap();
    for (camera, imu) in simulation.cameras().iter().zip(simulation.imus()) {
        let rig_from_imu = imu.imu_from_rig.inverse();
        let place = |t: f64| {
            let rig = simulation.walker().rig(t);
            (
                rig.position + rig.rotation * rig_from_imu.translation(),
                rig.rotation * rig_from_imu.rotation(),
            )
        };
        // Dead reckoning from the samples closes on the pose, with the midpoint rule.
        let (mut position, mut rotation) = place(5.0);
        let h = 1e-6;
        let mut velocity = (place(5.0 + h).0 - place(5.0 - h).0) / (2.0 * h);
        let dt = 1.0 / 400.0;
        for k in 0..2000 {
            let t = 5.0 + dt * (f64::from(k) + 0.5);
            let [gyro, force] = imu.imu.truth(simulation.walker(), t);
            let middle = rotation * so3::exp(gyro * (0.5 * dt));
            let acceleration = middle * force - Vector3::z() * GRAVITY;
            position += velocity * dt + acceleration * (0.5 * dt * dt);
            velocity += acceleration * dt;
            rotation *= so3::exp(gyro * dt);
        }
        let (expected, turn) = place(10.0);
        let (far, rotation_error) = ((position - expected).norm(), rotation.angle_to(&turn));
        assert!(
            far < 2e-3 && rotation_error < 2e-4,
            "{}: {far} {rotation_error}",
            camera.name
        );
    }
}

#[test]
fn bent_board_preserves_lengths_along_the_sheet_and_has_its_sagitta() {
    let pose = (
        Vector3::new(1.0, 2.0, 3.0),
        so3::exp(Vector3::new(0.3, -0.2, 1.0)),
    );
    let board =
        |bow_m, scale_error| Board::new(Sheet::new(april_grid(0)), pose, bow_m, scale_error);
    for bow_m in [0.01, -0.004] {
        let bent = board(bow_m, 0.0);
        let half = 0.5 * bent.sheet().size_m()[0];
        let ends = [-half, half].map(|x| bent.at([x, 0.0], 0.0));
        let middle = bent.at([0.0, 0.0], 0.0);
        let sagitta = (pose.1.inverse() * (middle - (ends[0] + ends[1]) * 0.5)).z;
        assert!((sagitta - bow_m).abs() < 1e-9, "{sagitta}");
        let along = (0..1000).map(|k| {
            let x = |k: i32| half * (f64::from(k) / 500.0 - 1.0);
            (bent.at([x(k + 1), 0.0], 0.0) - bent.at([x(k), 0.0], 0.0)).norm()
        });
        let length: f64 = along.sum();
        assert!((length - 2.0 * half).abs() < 1e-6, "{length} {half}");
    }
    let large = board(0.0, 0.02);
    let far = (large.at([0.3, 0.0], 0.0) - large.at([0.0, 0.0], 0.0)).norm();
    assert!((far - 0.306).abs() < 1e-12, "{far}");
}

#[test]
fn corners_move_after_a_camera_shift() {
    let simulation = session(20.0, &Plan::GOOD);
    let knocked = Faults {
        list: vec![Fault {
            kind: FaultKind::ShiftedCamera,
            strength: 0.5,
            from_s: 10.0,
            to_s: f64::INFINITY,
            camera: Some("left_shoulder".to_owned()),
            foot: None,
        }],
        seed: 1,
    };
    let number = |name: &str| {
        simulation
            .cameras()
            .iter()
            .position(|c| c.name == name)
            .unwrap()
    };
    let moved = |name: &str, frame: u64| {
        let camera = number(name);
        let as_it_was = simulation.target_observations(camera).frame(0, frame);
        let faults = knocked.of(name);
        let now = simulation
            .target_observations(camera)
            .with_faults(faults)
            .frame(0, frame);
        let find = |id: u32| now.iter().find(|c| c.id == id);
        let both = as_it_was.iter().filter_map(|a| Some((a, find(a.id)?)));
        both.map(|(a, b)| (a.pixel[0] - b.pixel[0]).hypot(a.pixel[1] - b.pixel[1]))
            .collect::<Vec<f64>>()
    };
    let mut compared = 0;
    for frame in 0..200 {
        let is_after = seconds(simulation.settings().frame_ns(frame)) >= 10.0;
        for px in moved("left_shoulder", frame) {
            assert_eq!(px > 0.0, is_after, "{frame}: {px}");
            // Half a degree is 2.3 px and more, except on the axis.
            assert!(px < 12.0);
            compared += 1;
        }
        assert!(moved("feet", frame).iter().all(|px| *px == 0.0));
    }
    assert!(compared > 1000, "{compared}");
}

#[test]
fn invalid_target_sessions_are_rejected() {
    let bent = Plan {
        bow_m: f64::NAN,
        ..Plan::GOOD
    };
    let error =
        Simulation::with_targets(&settings(5.0), &example(), &bent, &|n| Some(april_grid(n)));
    let message = error.unwrap_err().to_string();
    assert!(
        message.contains("bow of the boards, m, is NaN"),
        "{message}"
    );
    let walk = Settings {
        kind: Kind::Room,
        ..settings(5.0)
    };
    let error = Simulation::with_targets(&walk, &example(), &Plan::GOOD, &|n| Some(april_grid(n)));
    let message = error.unwrap_err().to_string();
    assert!(message.contains("is room, expected targets"), "{message}");
    let long = Imaging {
        exposure_s: Some(0.2),
        ..Imaging::USUAL
    };
    let message = session(5.0, &Plan::GOOD)
        .with_imaging(long)
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("0.2 s, expected above 0 and at most 0.09 s"),
        "{message}"
    );
}

#[test]
fn cameras_share_boards_if_there_are_too_few() {
    for count in [1, 2] {
        let some = |n| (n < count).then(|| april_grid(n));
        let simulation =
            Simulation::with_targets(&settings(30.0), &example(), &Plan::GOOD, &some).unwrap();
        assert_eq!(simulation.boards().len(), count);
        // The shoulder cameras observe one of the boards occasionally.
        let sees = |camera| {
            (0..300).any(|n| simulation.target_observations(camera).frame(0, n).len() > 20)
        };
        assert!((0..3).filter(|camera| sees(*camera)).count() >= 2);
    }
    let none = Simulation::with_targets(&settings(5.0), &example(), &Plan::GOOD, &|_| None);
    let message = none.unwrap_err().to_string();
    assert!(
        message.contains("number of boards is 0, expected at least 1"),
        "{message}"
    );
}

/// A rolling shutter distorts images only in motion.
#[test]
fn global_shutter_exposes_all_rows_simultaneously() {
    let rolling = session(40.0, &Plan::GOOD);
    let at_once = Imaging {
        global_shutter: true,
        ..Imaging::USUAL
    };
    let global = rolling.clone().with_imaging(at_once).unwrap();
    let feet = rolling
        .cameras()
        .iter()
        .position(|c| c.name == "feet")
        .unwrap();
    let (mut at_rest, mut moving) = (0.0_f64, 0.0_f64);
    for number in 0..400 {
        let rate = rolling
            .walker()
            .rig(seconds(rolling.settings().frame_ns(number)))
            .angular_rate;
        let (a, b) = (
            rolling.target_observations(feet).frame(0, number),
            global.target_observations(feet).frame(0, number),
        );
        for corner in &a {
            let Some(other) = b.iter().find(|other| other.id == corner.id) else {
                continue;
            };
            let [u, v] = [0, 1].map(|k| corner.pixel[k] - other.pixel[k]);
            match rate.norm() {
                r if r < 0.005 => at_rest = at_rest.max(u.hypot(v)),
                r if r > 0.5 => moving = moving.max(u.hypot(v)),
                _ => {}
            }
        }
    }
    assert!(at_rest < 0.05 && moving > 1.0, "{at_rest} {moving}");
}

#[test]
fn number_of_views_is_respected() {
    let few = Plan {
        views: Some(4),
        ..Plan::GOOD
    };
    let simulation = session(40.0, &few);
    let at = |t: f64| simulation.walker().rig(t);
    assert!(at(3.0).angular_rate.norm() > 0.0);
    let (late, later) = (at(20.0), at(39.0));
    assert!((late.position - later.position).norm() < 0.01);
    assert!(late.rotation.angle_to(&later.rotation) < 0.01);
    let rotation = at(1.0).rotation.angle_to(&late.rotation);
    assert!(rotation > 0.05, "{rotation}");
}

#[test]
fn corner_noise_has_the_requested_sigma_and_is_reproducible() {
    let simulation = session(10.0, &Plan::GOOD);
    let mut off = Vec::new();
    for number in 0..100 {
        let target_observations = simulation.target_observations(1);
        let (exact, noisy) = (
            target_observations.frame(0, number),
            target_observations.observed(0, number, 0.3),
        );
        assert_eq!(
            noisy,
            simulation.target_observations(1).observed(0, number, 0.3)
        );
        for (a, b) in exact.iter().zip(&noisy) {
            assert_eq!((a.board, a.id), (b.board, b.id));
            off.extend([0, 1].map(|k| b.pixel[k] - a.pixel[k]));
        }
    }
    let mean = off.iter().sum::<f64>() / off.len() as f64;
    let square = off.iter().map(|v| v * v).sum::<f64>() / off.len() as f64;
    assert!(
        off.len() > 5000 && mean.abs() < 0.02,
        "{} {mean}",
        off.len()
    );
    assert!((square.sqrt() - 0.3).abs() < 0.02, "{}", square.sqrt());
    // Eyes and frames have independent noise.
    let noise = |eye: usize, number: u64| {
        let target_observations = simulation.target_observations(1);
        let (exact, noisy) = (
            target_observations.frame(eye, number),
            target_observations.observed(eye, number, 1.0),
        );
        noisy[0].pixel[0] - exact[0].pixel[0]
    };
    let same = (noise(0, 2) - noise(1, 2)).abs() < 1e-9 || (noise(0, 2) - noise(0, 3)).abs() < 1e-9;
    assert!(!same);
}

/// Landmarks are found at the pixel where they were selected, and the true depths of both eyes
/// agree.
#[test]
fn landmarks_are_found_at_their_pixels() {
    let walk = Settings {
        kind: Kind::Corridor,
        width: 160,
        height: 90,
        ..settings(4.0)
    };
    let simulation = Simulation::new(&walk, &example()).unwrap();
    let mut both = 0;
    for camera in 0..3 {
        let target_observations = simulation.target_observations(camera);
        let time_ns = 2_050_000_000;
        let depth = simulation.ground_truth(camera).render(0, time_ns).depth;
        let landmarks = target_observations.landmarks(0, time_ns, 200, 5);
        assert!(landmarks.len() > 150);
        let mut agree = 0;
        for landmark in &landmarks {
            let [u, v] = target_observations
                .find(0, time_ns, &landmark.point)
                .unwrap();
            let [at_u, at_v] = landmark.pixel;
            assert!((u - at_u).hypot(v - at_v) < 1e-6, "{u} {v} {at_u} {at_v}");
            both += i32::from(
                target_observations
                    .find(1, time_ns, &landmark.point)
                    .is_some(),
            );
            let far = f64::from(depth[v.round() as usize * 160 + u.round() as usize]);
            let rig = simulation.walker().rig(seconds(time_ns));
            let (origin, rotation) = simulation.cameras()[camera].world_from_eye(0, &rig, None);
            let own = (rotation.inverse() * (landmark.point - origin)).z;
            agree += i32::from((far / own - 1.0).abs() < 0.05);
        }
        // Except at edges and on the wearer's legs.
        let least = landmarks.len() as i32
            * if simulation.cameras()[camera].name == "feet" {
                5
            } else {
                8
            }
            / 10;
        assert!(agree > least, "{camera}: {agree} of {}", landmarks.len());
    }
    assert!(both > 300, "{both}");
}
