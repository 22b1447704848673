//! A synthetic rig that moves among points, with a corner error of a fifth of a pixel.

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion, ImuCalibration, Lens, Provenance, StereoCalibration};
use imaging::ImageView;
use nalgebra::{UnitQuaternion, Vector3};

use super::*;

mod right_eye;

/// Reproducible values from -1 to 1.
struct Draw(u64);

impl Draw {
    fn next(&mut self) -> f64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as f64 / f64::from(1_u32 << 30) - 1.0
    }

    /// Standard deviation 1, approximately normal.
    fn bell(&mut self) -> f64 {
        (0..6).map(|_| self.next()).sum::<f64>() / 2.0_f64.sqrt()
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::new(self.bell(), self.bell(), self.bell())
    }
}

/// Motion of the rig.
#[derive(Clone, Copy, PartialEq)]
enum Gait {
    /// As a walker who looks around.
    Walk,
    /// Straight on without rotation.
    Glide,
}

impl Gait {
    fn pose(self, t: f64) -> (UnitQuaternion<f64>, Vector3<f64>) {
        let s = |hz: f64, phase: f64| (std::f64::consts::TAU * hz * t + phase).sin();
        let rotation = match self {
            Self::Walk => Vector3::new(
                0.04 * s(0.95, 0.0) + 0.05 * s(0.21, 1.0),
                0.03 * s(1.9, 0.5) + 0.06 * s(0.33, 2.0),
                0.05 * s(0.95, 1.3) + 0.6 * s(0.11, 0.3),
            ),
            Self::Glide => Vector3::zeros(),
        };
        let place = Vector3::new(1.2 * t, 0.03 * s(0.95, 0.2), 0.02 * s(1.9, 0.0));
        (UnitQuaternion::from_scaled_axis(rotation), place)
    }
}

/// A camera with its actual and nominal calibration, and its observations.
struct SimulatedCamera {
    name: &'static str,
    nominal: StereoCalibration,
    rig_from_left: RigidTransform,
    bursts: Vec<Burst>,
    gyro: Gyro,
}

fn transform(rotation: [f64; 3], place: [f64; 3]) -> RigidTransform {
    RigidTransform::from_rotation_vector(rotation, place).unwrap()
}

fn stereo() -> StereoCalibration {
    let lens = CameraModel {
        width: 672,
        height: 376,
        fx: 300.0,
        fy: 300.0,
        cx: 336.0,
        cy: 190.0,
        distortion: Distortion::RadTan4 {
            k1: -0.05,
            k2: 0.006,
            p1: 1e-4,
            p2: -1e-4,
        },
    };
    StereoCalibration {
        left: lens,
        right: lens,
        right_from_left: transform([0.001, -0.002, 0.003], [-0.06, 0.0, 0.0]),
        imu: Some(ImuCalibration {
            imu_from_left: transform([0.4, 0.1, -0.2], [0.01, 0.0, 0.0]),
            rate_hz: 400.0,
            noise: None,
        }),
        provenance: Provenance {
            format: None,
            files: Vec::new(),
            part: None,
        },
    }
}

/// `moving` is the fraction of features on moving objects.
fn make(gait: Gait, moving: f64, seed: u64) -> Vec<SimulatedCamera> {
    // Optical axes to the rig's: x right, y down, z forward.
    let ahead = RigidTransform::from_wxyz([0.5, -0.5, 0.5, -0.5], [0.0; 3]).unwrap();
    let out = |yaw: f64, pitch: f64, y: f64| {
        transform([0.0, 0.0, yaw], [0.05, y, 0.1]) * transform([0.0, pitch, 0.0], [0.0; 3]) * ahead
    };
    let places = [
        ("feet", out(0.0, 1.2, 0.0)),
        ("left_shoulder", out(0.5, 0.0, 0.15)),
        ("right_shoulder", out(-0.5, 0.0, -0.15)),
    ];
    let camera = |(k, (name, rig_from_left)): (usize, (&'static str, RigidTransform))| {
        let nominal = stereo();
        let mut draw = Draw(seed * 10 + k as u64);
        SimulatedCamera {
            name,
            gyro: gyro(gait, &nominal, &rig_from_left, &mut draw),
            bursts: (0..8)
                .map(|b| {
                    burst(
                        gait,
                        &nominal,
                        &rig_from_left,
                        1.0 + 3.5 * f64::from(b),
                        moving,
                        &mut draw,
                    )
                })
                .collect(),
            nominal,
            rig_from_left,
        }
    };
    places.into_iter().enumerate().map(camera).collect()
}

fn gyro(
    gait: Gait,
    nominal: &StereoCalibration,
    rig_from_left: &RigidTransform,
    draw: &mut Draw,
) -> Gyro {
    let imu = nominal.imu.unwrap().imu_from_left.rotation() * rig_from_left.rotation().inverse();
    let bias = draw.vector() * 3e-3;
    let sample = |n: i64| {
        let t = n as f64 / 400.0;
        let (a, b) = (gait.pose(t - 1e-4).0, gait.pose(t + 1e-4).0);
        let rate = imu * ((a.inverse() * b).scaled_axis() / 2e-4) + bias + draw.vector() * 2.4e-3;
        (n * 2_500_000, rate.into())
    };
    Gyro::new((0..12_400).map(sample))
}

/// One second: four overlapping segments of a third of a second.
fn burst(
    gait: Gait,
    nominal: &StereoCalibration,
    rig_from_left: &RigidTransform,
    start_s: f64,
    moving: f64,
    draw: &mut Draw,
) -> Burst {
    let lenses = [Lens::new(&nominal.left), Lens::new(&nominal.right)];
    let world_from_left = |t: f64| {
        let (rotation, place) = gait.pose(t);
        let t = rig_from_left.translation();
        (rotation * rig_from_left.rotation(), place + rotation * t)
    };
    let segments = (0..5).map(|k| {
        let from_ns = ((start_s + 0.15 * f64::from(k)) * 1e9) as i64;
        let to_ns = from_ns + 300_000_000;
        let (first, second) = (
            world_from_left(from_ns as f64 * 1e-9),
            world_from_left(to_ns as f64 * 1e-9),
        );
        let drift = draw.vector() * 0.1;
        let mut features = Vec::new();
        while features.len() < 150 {
            let pixel = [336.0 + 330.0 * draw.next(), 188.0 + 180.0 * draw.next()];
            let ray = Vector3::from(lenses[0].unproject(pixel).unwrap());
            let x = ray * (1.0 + 6.0 * draw.next().abs());
            let own = match draw.next().abs() < moving {
                true => drift,
                false => Vector3::zeros(),
            };
            let later = second.0.inverse() * (first.0 * x + first.1 + own - second.1);
            let right = nominal.right_from_left.apply(x.into());
            let mut seen = |lens: &Lens, x: [f64; 3]| {
                let [u, v] = lens.project(x)?;
                let inside = (0.0..671.0).contains(&u) && (0.0..375.0).contains(&v);
                inside.then_some([u + 0.15 * draw.bell(), v + 0.15 * draw.bell()])
            };
            features.push(Feature {
                left: pixel,
                right: seen(&lenses[1], right),
                later: seen(&lenses[0], later.into()),
            });
        }
        TrackSegment {
            from_ns,
            to_ns,
            features,
        }
    });
    Burst {
        segments: segments.collect(),
    }
}

fn camera(made: &SimulatedCamera) -> Camera<'_> {
    Camera {
        name: made.name,
        nominal: &made.nominal,
        rig_from_left: Some(made.rig_from_left),
        joint_sigma_rad: None,
        line_s: Some(0.0),
        bursts: &made.bursts,
        gyro: Some(&made.gyro),
    }
}

fn verified(made: &[SimulatedCamera]) -> Verification {
    let cameras: Vec<Camera<'_>> = made.iter().map(camera).collect();
    verify(&cameras, &Tolerances::default(), &Config::default())
}

fn off(found: &Verification) -> Vec<&Finding> {
    let all = found.findings.iter();
    all.filter(|f| f.status == Status::Inconsistent).collect()
}

/// The only inconsistent finding.
fn only<'a>(found: &'a Verification, parameter: Parameter, camera: &str) -> &'a Finding {
    let off = off(found);
    let [one] = off[..] else {
        panic!("expected one finding: {off:#?}");
    };
    assert_eq!(
        (one.parameter, one.camera.as_str()),
        (parameter, camera),
        "{one:#?}"
    );
    one
}

#[test]
fn correct_rig_is_consistent_in_every_parameter() {
    let found = verified(&make(Gait::Walk, 0.0, 1));
    for finding in &found.findings {
        assert_eq!(finding.status, Status::Consistent, "{finding:#?}");
    }
    // Three rotations and three time offsets per camera.
    assert_eq!(found.findings.len(), 18);
    for camera in &found.cameras {
        let (eyes, imu) = (camera.eyes.as_ref().unwrap(), camera.imu.as_ref().unwrap());
        assert!(eyes.nominal_rms_px < 0.17, "{eyes:?}");
        for k in 0..3 {
            assert!(
                eyes.rotation_rad[k].abs() < 4.0 * eyes.sigma_rad[k],
                "{eyes:?}"
            );
            assert!(
                imu.rotation_rad[k].abs() < 4.0 * imu.sigma_rad[k],
                "{imu:?}"
            );
            assert!(imu.sigma_rad[k] < 1.2e-3, "{imu:?}");
        }
        assert!(
            imu.time_offset_s.abs() < 4.0 * imu.time_offset_sigma_s
                && imu.time_offset_sigma_s < 3e-4,
            "{imu:?}"
        );
    }
}

#[test]
fn rotated_camera_is_identified_with_angle_and_axis() {
    for (k, axis, degrees) in [(0, 0, 0.6_f64), (1, 1, -0.6), (2, 2, 2.0)] {
        let mut made = make(Gait::Walk, 0.0, 2);
        let mut rotation = [0.0; 3];
        rotation[axis] = degrees.to_radians();
        // The nominal value is the pose before the rotation.
        made[k].rig_from_left = made[k].rig_from_left * transform(rotation, [0.0; 3]).inverse();
        let found = verified(&made);
        let one = only(&found, Parameter::Camera, made[k].name);
        assert!(
            (one.estimate[axis].to_degrees() - degrees).abs() < 0.15,
            "{one:#?}"
        );
        assert!(one.alternatives.is_empty(), "{one:#?}");
        let letter = ["x", "y", "z"][axis];
        assert!(
            one.text.contains(letter) && one.text.contains("rotated by"),
            "{}",
            one.text
        );
    }
}

#[test]
fn rotation_between_two_cameras_names_both() {
    let mut made = make(Gait::Walk, 0.0, 3);
    made.truncate(2);
    made[0].rig_from_left = made[0].rig_from_left * transform([0.02, 0.0, 0.0], [0.0; 3]);
    let found = verified(&made);
    let off = off(&found);
    assert_eq!(off.len(), 1, "{off:#?}");
    assert_eq!(off[0].parameter, Parameter::Camera);
    assert_eq!(off[0].alternatives.len(), 1, "{off:#?}");
}

#[test]
fn rotated_imu_is_distinguished_from_a_rotated_camera() {
    let mut made = make(Gait::Walk, 0.0, 4);
    let imu = made[1].nominal.imu.as_mut().unwrap();
    imu.imu_from_left = imu.imu_from_left * transform([0.0, 0.0, 0.02], [0.0; 3]);
    let one = verified(&made);
    let one = only(&one, Parameter::Imu, "left_shoulder");
    assert!((one.estimate[2] + 0.02).abs() < 2e-3, "{one:#?}");
}

#[test]
fn image_imu_and_clock_time_offsets_are_distinguished() {
    let late_ns = 3_000_000;
    let images = |made: &mut SimulatedCamera| {
        for of in made.bursts.iter_mut().flat_map(|b| &mut b.segments) {
            of.from_ns += late_ns;
            of.to_ns += late_ns;
        }
    };
    let check = |made: &[SimulatedCamera], parameter: Parameter| {
        let found = verified(made);
        let one = only(&found, parameter, "right_shoulder");
        assert!((one.estimate[0] - 3e-3).abs() < 6e-4, "{one:#?}");
        assert!(one.text.contains("late"), "{}", one.text);
    };
    let mut made = make(Gait::Walk, 0.0, 5);
    images(&mut made[2]);
    check(&made, Parameter::ImageTime);
    made[2].gyro = made[2].gyro.shifted_by_ns(late_ns);
    check(&made, Parameter::Clock);
    let mut made = make(Gait::Walk, 0.0, 5);
    made[2].gyro = made[2].gyro.shifted_by_ns(late_ns);
    check(&made, Parameter::ImuTime);
}

#[test]
fn rotation_of_the_right_eye_is_measured() {
    let mut made = make(Gait::Walk, 0.0, 6);
    let predicted = [0.4_f64, -0.3, 0.2].map(f64::to_radians);
    let nominal = &mut made[0].nominal;
    nominal.right_from_left = transform(predicted, [0.0; 3]).inverse() * nominal.right_from_left;
    let found = verified(&made);
    let one = only(&found, Parameter::StereoRotation, "feet");
    #[expect(clippy::needless_range_loop, reason = "three vectors go side by side")]
    for k in 0..3 {
        assert!((one.estimate[k] - predicted[k]).abs() < 1e-3, "{one:#?}");
    }
    let eyes = found.cameras[0].eyes.as_ref().unwrap();
    assert!(eyes.nominal_rms_px > 5.0 * eyes.found_rms_px, "{eyes:?}");
}

#[test]
fn moving_objects_are_rejected() {
    let made = make(Gait::Walk, 0.3, 7);
    let found = verified(&made);
    assert!(off(&found).is_empty(), "{:#?}", off(&found));
    for camera in &found.cameras {
        let imu = camera.imu.as_ref().unwrap();
        assert!(imu.time_offset_s.abs() < 1e-3, "{imu:?}");
    }
}

#[test]
fn without_rotation_rotations_and_times_are_undetermined() {
    let found = verified(&make(Gait::Glide, 0.0, 8));
    for finding in &found.findings {
        match finding.parameter {
            Parameter::StereoRotation => {
                assert_eq!(finding.status, Status::Consistent, "{finding:#?}")
            }
            _ => assert_eq!(finding.status, Status::Undetermined, "{finding:#?}"),
        }
    }
}

#[test]
fn without_images_or_samples_everything_is_undetermined() {
    let mut made = make(Gait::Walk, 0.0, 9);
    for camera in &mut made {
        camera.bursts.clear();
        camera.gyro = Gyro::default();
    }
    let found = verified(&made);
    assert!(
        found
            .cameras
            .iter()
            .all(|c| c.eyes.is_none() && c.imu.is_none())
    );
    assert!(found.pairs.is_empty());
    for finding in &found.findings {
        assert_eq!(finding.status, Status::Undetermined, "{finding:#?}");
        assert!(finding.text.contains("not determined"), "{}", finding.text);
    }
    assert!(
        verify(&[], &Tolerances::default(), &Config::default())
            .findings
            .is_empty()
    );
}

/// Aperiodic texture from sums of waves.
fn texture(x: f64, y: f64) -> f64 {
    let wave = |a: f64, b: f64, c: f64| (a * x + b * y + c).sin();
    128.0
        + 25.0 * wave(0.31, 0.12, 0.0)
        + 25.0 * wave(-0.17, 0.37, 1.0)
        + 20.0 * wave(0.53, -0.41, 2.0)
        + 20.0 * wave(0.07, 0.23, 0.7)
        + 15.0 * wave(0.23, -0.05, 0.2)
}

fn image(width: usize, height: usize, of: impl Fn(f64, f64) -> f64) -> Vec<u8> {
    let pixel = |i: usize| of((i % width) as f64, (i / width) as f64).round() as u8;
    (0..width * height).map(pixel).collect()
}

/// Tracked and matched features are accurate to a tenth of a pixel, in bright and dim images.
#[test]
fn corners_are_tracked_and_matched_in_images() {
    let nominal = stereo();
    let lens = CameraModel {
        distortion: Distortion::None,
        ..nominal.left
    };
    let nominal = StereoCalibration {
        left: lens,
        right: lens,
        right_from_left: transform([0.0; 3], [-0.06, 0.0, 0.0]),
        ..nominal
    };
    let (width, height) = (672, 376);
    let mut follower = FeatureTracker::new(&nominal, None, &Config::default());
    // The right image: a distance of 2 m, and 3.3 rows of vertical offset, as if the eye were
    // rotated.
    let disparity = 0.06 * 300.0 / 2.0;
    for n in 0..6 {
        let (dx, dy) = (4.3 * f64::from(n), -2.6 * f64::from(n));
        let left = image(width, height, |x, y| texture(x - dx, y - dy));
        let right = image(width, height, |x, y| {
            20.0 + 0.8 * texture(x + disparity - dx, y - 3.3 - dy)
        });
        follower.push(&StereoFrame {
            time_ns: i64::from(n) * 66_666_667,
            left: ImageView::new(width, height, width, &left).unwrap(),
            right: ImageView::new(width, height, width, &right).unwrap(),
        });
    }
    let burst = follower.end();
    let first = &burst.segments[0];
    assert_eq!(first.to_ns - first.from_ns, 5 * 66_666_667);
    let off = |found: fn(&Feature) -> Option<[f64; 2]>, by: [f64; 2]| -> Vec<f64> {
        let of = |f: &Feature| {
            let [u, v] = found(f)?;
            Some((u - f.left[0] - by[0]).hypot(v - f.left[1] - by[1]))
        };
        let mut off: Vec<f64> = first.features.iter().filter_map(of).collect();
        off.sort_by(f64::total_cmp);
        off
    };
    let match_stereo = off(|f| f.right, [-disparity, 3.3]);
    let tracked = off(|f| f.later, [21.5, -13.0]);
    assert!(
        match_stereo.len() > 100 && tracked.len() > 150,
        "{} {} of {}",
        match_stereo.len(),
        tracked.len(),
        first.features.len()
    );
    for off in [match_stereo, tracked] {
        // The waves nearly repeat, so that a few matches may slip.
        let (middle, most) = (off[off.len() / 2], off[off.len() * 97 / 100]);
        assert!(middle < 0.07 && most < 0.3, "{middle} {most}");
    }
}

#[test]
fn blank_images_give_no_corners() {
    let blank = vec![90; 672 * 376];
    let mut follower = FeatureTracker::new(&stereo(), None, &Config::default());
    let eye = ImageView::new(672, 376, 672, &blank).unwrap();
    for n in 0..6 {
        follower.push(&StereoFrame {
            time_ns: n * 66_666_667,
            left: eye,
            right: eye,
        });
    }
    assert!(
        follower
            .end()
            .segments
            .iter()
            .all(|m| m.features.is_empty())
    );
    assert!(ImageView::new(672, 376, 600, &blank).is_none());
    assert!(ImageView::new(672, 377, 672, &blank).is_none());
}

#[test]
fn bursts_are_spread_and_placed_at_rotations() {
    // The rate changes at 3 to 4 s and at 13 to 14 s.
    let rate = |n: i64| {
        let t = n as f64 * 2.5e-3;
        match (3.0..4.0).contains(&(t % 10.0)) {
            true => [(6.0 * t).sin(), 0.0, 0.0],
            false => [0.0; 3],
        }
    };
    let gyro = Gyro::new((0..8000).map(|n| (n * 2_500_000, rate(n))));
    let second = 1_000_000_000;
    let bursts = choose_bursts(
        &[&gyro],
        [0, 20 * second],
        2,
        second,
        &BurstConfig::default(),
    );
    assert_eq!(bursts.len(), 2);
    assert!((bursts[0][0] - 3 * second).abs() < second / 2, "{bursts:?}");
    assert!(
        (bursts[1][0] - 13 * second).abs() < second / 2,
        "{bursts:?}"
    );
    let alone = choose_bursts(&[], [0, 20 * second], 4, second, &BurstConfig::default());
    assert_eq!(alone[0], [2 * second, 3 * second]);
    let short = choose_bursts(&[], [0, second / 2], 4, second, &BurstConfig::default());
    assert_eq!(short, [[0, second / 2]]);
    assert!(choose_bursts(&[], [second, 0], 4, second, &BurstConfig::default()).is_empty());
}
