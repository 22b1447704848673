//! Right eyes of a car's rectified stereo camera, with lenses that differ.

use super::*;

/// A rectified stereo camera of a car: a baseline of half a metre, points from 5 to 100 m, no IMU.
/// It drives straight, or turns by `turn` rad in each segment; a tenth of the points move.
fn drive(right_lens: Distortion, turn: f64, seed: u64) -> (StereoCalibration, Vec<Burst>) {
    let lens = CameraModel {
        width: 1226,
        height: 370,
        fx: 707.0,
        fy: 707.0,
        cx: 601.0,
        cy: 183.0,
        distortion: Distortion::None,
    };
    let nominal = StereoCalibration {
        left: lens,
        right: lens,
        right_from_left: transform([0.0; 3], [-0.537, 0.0, 0.0]),
        imu: None,
        ..stereo()
    };
    let right = Lens::new(&CameraModel {
        distortion: right_lens,
        ..lens
    });
    let left = Lens::new(&lens);
    let mut draw = Draw(seed);
    let mut segment = |from_ns: i64| {
        let to_ns = from_ns + 300_000_000;
        let later_from_first = transform(
            [0.002 * draw.bell(), turn, 0.002 * draw.bell()],
            [0.1 * draw.bell(), 0.05 * draw.bell(), -3.0],
        );
        let other = [draw.bell(), 0.0, 2.0];
        let mut features = Vec::new();
        while features.len() < 150 {
            let pixel = [601.0 + 600.0 * draw.next(), 183.0 + 170.0 * draw.next()];
            let ray = Vector3::from(left.unproject(pixel).unwrap());
            let x = ray / (0.01 + 0.19 * draw.next().abs());
            let own = match draw.next().abs() < 0.1 {
                true => Vector3::from(other),
                false => Vector3::zeros(),
            };
            let mut seen = |lens: &Lens, x: [f64; 3]| {
                let [u, v] = lens.project(x)?;
                let inside = (0.0..1225.0).contains(&u) && (0.0..369.0).contains(&v);
                inside.then_some([u + 0.2 * draw.bell(), v + 0.2 * draw.bell()])
            };
            features.push(Feature {
                left: pixel,
                right: seen(&right, nominal.right_from_left.apply(x.into())),
                later: seen(&left, later_from_first.apply((x + own).into())),
            });
        }
        TrackSegment {
            from_ns,
            to_ns,
            features,
        }
    };
    let burst = |b: i64| Burst {
        segments: (0..4)
            .map(|k| segment(b * 1_000_000_000 + k * 200_000_000))
            .collect(),
    };
    let bursts = (0..3).map(burst).collect();
    (nominal, bursts)
}

/// The finding on a right eye that is rotated by this.
fn right_eye(
    nominal: &StereoCalibration,
    bursts: &[Burst],
    rotation_deg: [f64; 3],
) -> (Finding, StereoAlignment) {
    let rotation = transform(rotation_deg.map(f64::to_radians), [0.0; 3]);
    let wrong = StereoCalibration {
        right_from_left: rotation.inverse() * nominal.right_from_left,
        ..nominal.clone()
    };
    let camera = Camera {
        name: "car",
        nominal: &wrong,
        rig_from_left: None,
        joint_sigma_rad: None,
        line_s: Some(0.0),
        bursts,
        gyro: None,
    };
    let found = verify(&[camera], &Tolerances::default(), &Config::default());
    let eyes = found.cameras[0].eyes.clone().unwrap();
    (found.findings[0].clone(), eyes)
}

/// The right lens decentered as the rows of `KITTI_sequence_1` look.
const DECENTERED: Distortion = decentered(5e-3);

const fn decentered(p2: f64) -> Distortion {
    Distortion::RadTan4 {
        k1: 0.0,
        k2: 0.0,
        p1: 0.0,
        p2,
    }
}

#[test]
fn decentered_lens_is_not_taken_for_a_rotation() {
    let (nominal, bursts) = drive(DECENTERED, 0.0, 10);
    for degrees in [0.0, 0.1, 0.3] {
        let (finding, eyes) = right_eye(&nominal, &bursts, [0.0, degrees, 0.0]);
        assert!(eyes.sigma_rad[1].to_degrees() < 0.02, "{eyes:?}");
        let expected = match degrees {
            0.0 => Status::Consistent,
            _ => Status::Inconsistent,
        };
        assert_eq!(finding.status, expected, "{finding:#?}");
    }
}

/// Straight and turning drives with various right lenses.
#[test]
fn rotation_of_a_right_eye_is_within_three_sigmas() {
    let radial = Distortion::RadTan4 {
        k1: 5e-3,
        k2: -3e-3,
        p1: 2e-3,
        p2: 0.0,
    };
    let lenses = [Distortion::None, DECENTERED, decentered(-3e-3), radial];
    for (seed, lens) in (20..).zip(lenses) {
        for turn in [0.0, 0.05] {
            let (nominal, bursts) = drive(lens, turn, seed);
            for (axis, degrees) in [(1, 0.0), (0, 0.1), (1, 0.1), (2, 0.1), (1, 0.3)] {
                let mut rotation = [0.0; 3];
                rotation[axis] = degrees;
                let (_, eyes) = right_eye(&nominal, &bursts, rotation);
                let off = (0..3).map(|k| {
                    (eyes.rotation_rad[k] - rotation[k].to_radians()).abs() / eyes.sigma_rad[k]
                });
                let worst = off.fold(0.0, f64::max);
                assert!(
                    worst < 3.0,
                    "{lens:?} {turn} {rotation:?}: {worst} {eyes:?}"
                );
            }
        }
    }
}

#[test]
fn yaw_is_not_determined_at_rest_but_pitch_is() {
    let (nominal, mut bursts) = drive(DECENTERED, 0.0, 11);
    for of in bursts.iter_mut().flat_map(|b| &mut b.segments) {
        of.features.iter_mut().for_each(|f| f.later = Some(f.left));
    }
    let (finding, eyes) = right_eye(&nominal, &bursts, [0.0, 0.1, 0.0]);
    assert_eq!(finding.status, Status::Undetermined, "{finding:#?}");
    assert!(
        finding.text.contains("about its y not determined") && finding.text.contains("move"),
        "{}",
        finding.text
    );
    assert_eq!(eyes.parallax_segments, 0, "{eyes:?}");
    let (finding, _) = right_eye(&nominal, &bursts, [0.3, 0.0, 0.0]);
    assert_eq!(finding.status, Status::Inconsistent, "{finding:#?}");
    assert!(
        finding.text.contains("rotated by 0.3") && finding.text.contains("about its x"),
        "{}",
        finding.text
    );
}
