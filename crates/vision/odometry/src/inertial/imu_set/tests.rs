//! A rig that accelerates while it rotates, with an IMU at its origin and one elsewhere.

use nalgebra::UnitQuaternion;

use super::*;
use crate::test_rig;

const PERIOD_NS: i64 = 10_000_000;
const RATE: [f64; 3] = [0.2, -0.1, 0.8];
const FORCE: [f64; 3] = [1.0, 0.5, 9.8];

/// The second IMU is 30 cm to the side, with its axes rotated by a quarter.
fn rig() -> Rig {
    let first = test_rig::imu();
    let mut second = test_rig::imu();
    second.name = "feet/imu".to_owned();
    let half = std::f64::consts::FRAC_1_SQRT_2;
    second.rig_from_imu =
        RigidTransform::from_wxyz([half, 0.0, 0.0, half], [0.0, 0.3, 0.0]).expect("a pose");
    Rig {
        cameras: vec![test_rig::stereo(0.1)],
        imus: vec![first, second],
    }
}

/// Samples of both IMUs in a uniform rotation, those of the first only where `has_first`.
fn samples(set: &mut ImuSet, rig: &Rig, count: i64, has_first: impl Fn(i64) -> bool) {
    for k in 0..count {
        for (index, imu) in rig.imus.iter().enumerate() {
            if index == 0 && !has_first(k) {
                continue;
            }
            let arm = Vector3::from(*imu.rig_from_imu.translation());
            let gyro = Vector3::from(RATE);
            // No sensor gives the same value for long.
            let noise = Vector3::repeat(1e-9 * (k % 7) as f64);
            let accel = Vector3::from(FORCE) + gyro.cross(&gyro.cross(&arm)) + noise;
            let back = imu.rig_from_imu.rotation().inverse();
            let sample = ImuSample {
                time_ns: k * PERIOD_NS,
                gyro: (back * (gyro + noise)).into(),
                accel: (back * accel).into(),
            };
            set.push(index, &sample);
        }
    }
}

fn state(time_ns: i64) -> State {
    State::at_rest(time_ns)
}

fn factor(set: &mut ImuSet, from_ns: i64, to_ns: i64) -> MotionFactor {
    let config = Config::default();
    let zero = Vector3::zeros();
    motion_factor(Some(set), &config, &state(from_ns), to_ns, zero, true)
}

#[test]
fn another_imu_takes_over_when_the_first_is_silent() {
    let rig = rig();
    let config = Config::default();
    let mut set = ImuSet::new(&rig, &config).expect("two IMUs");
    samples(&mut set, &rig, 100, |k| k < 50);
    set.initialize(0);
    let first = factor(&mut set, 100_000_000, 400_000_000);
    assert!(first.has_gravity);
    assert_eq!(set.uses(), [ImuUse { time_ns: 0, imu: 0 }]);
    assert_eq!(first.bias_walk, set.imus[0].bias_walk());
    // It is not silent for long enough.
    assert!(!factor(&mut set, 400_000_000, 600_000_000).has_gravity);
    assert_eq!(set.uses().len(), 1);

    let across = factor(&mut set, 400_000_000, 700_000_000);
    let used = ImuUse {
        time_ns: 700_000_000,
        imu: 1,
    };
    assert_eq!(set.uses()[1..], [used]);
    // The same motion of the body, without a bias that is known of this IMU.
    assert!(across.has_gravity);
    assert_eq!(across.preintegrated.by_bias.amax(), 0.0);
    let difference = first.preintegrated.velocity - across.preintegrated.velocity;
    assert!(difference.norm() < 1e-6, "{difference}");
    let expected = config.estimator.initialization.bias_sigma;
    let sigma = [0, 3].map(|k| across.preintegrated.covariance[(k, k)].sqrt());
    assert!(sigma[0] > 0.95 * 0.3 * expected[0], "{sigma:?}");
    assert!(sigma[1] > 0.9 * 0.3 * expected[1], "{sigma:?}");
    for (walk, expected) in across.bias_walk.iter().zip(expected) {
        assert!((walk * 0.3_f64.sqrt() - expected).abs() < 1e-9);
    }

    // The earlier keyframe is still the last one, then the later one is.
    let again = factor(&mut set, 400_000_000, 750_000_000);
    assert_eq!(again.preintegrated.by_bias.amax(), 0.0);
    let after = factor(&mut set, 700_000_000, 900_000_000);
    assert!(after.has_gravity && after.preintegrated.by_bias.amax() > 0.0);
    assert_eq!(after.bias_walk, set.imus[1].bias_walk());
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(RATE) * 0.2);
    assert!(after.preintegrated.rotation.angle_to(&rotation) < 1e-6);
    assert_eq!(set.uses().len(), 2);
}

#[test]
fn gap_of_all_imus_is_bridged_by_constant_velocity() {
    let rig = Rig {
        imus: rig().imus[..1].to_vec(),
        ..rig()
    };
    let mut set = ImuSet::new(&rig, &Config::default()).expect("an IMU");
    samples(&mut set, &rig, 100, |k| !(40..60).contains(&k));
    set.initialize(0);
    assert!(!factor(&mut set, 300_000_000, 500_000_000).has_gravity);
    assert!(factor(&mut set, 650_000_000, 850_000_000).has_gravity);
    assert_eq!(set.uses().len(), 1);
}

#[test]
fn first_imu_with_samples_begins() {
    let rig = rig();
    let mut set = ImuSet::new(&rig, &Config::default()).expect("two IMUs");
    samples(&mut set, &rig, 100, |_| false);
    set.initialize(100_000_000);
    let used = ImuUse {
        time_ns: 100_000_000,
        imu: 1,
    };
    assert_eq!(set.uses(), [used]);
    let motion = factor(&mut set, 100_000_000, 300_000_000);
    // Its biases are those of the first state.
    assert!(motion.has_gravity && motion.preintegrated.by_bias.amax() > 0.0);
}

/// A motion by samples of the first IMU with this range, rad/s and m/s².
fn clipped(range: [f64; 2]) -> MotionFactor {
    let mut rig = rig();
    rig.imus.truncate(1);
    rig.imus[0].range = range;
    let mut set = ImuSet::new(&rig, &Config::default()).expect("an IMU");
    samples(&mut set, &rig, 100, |_| true);
    set.initialize(0);
    factor(&mut set, 100_000_000, 300_000_000)
}

#[test]
fn clipped_accelerometer_leaves_the_gyroscope() {
    let motion = clipped([10.0, 9.8]);
    let rotation = UnitQuaternion::from_scaled_axis(Vector3::from(RATE) * 0.2);
    assert!(motion.preintegrated.rotation.angle_to(&rotation) < 1e-6);
    assert!(motion.preintegrated.covariance[(0, 0)].sqrt() < 2e-3);
    // Constant velocity, with the noise of an unknown acceleration.
    assert!(!motion.has_gravity && motion.preintegrated.has_gyroscope());
    assert_eq!(motion.preintegrated.velocity, Vector3::zeros());
    assert!(motion.preintegrated.covariance[(3, 3)].sqrt() > 1.0);
    assert_eq!(
        motion.preintegrated.by_bias.fixed_columns::<3>(3).amax(),
        0.0
    );
}

#[test]
fn clipped_gyroscope_leaves_the_accelerometer() {
    let motion = clipped([0.8, 80.0]);
    assert!(motion.has_gravity && !motion.preintegrated.has_gyroscope());
    // The assumed rate is zero.
    let velocity = Vector3::from(FORCE) * 0.2;
    assert!((motion.preintegrated.velocity - velocity).norm() < 1e-6);
    assert!(motion.preintegrated.covariance[(0, 0)].sqrt() > 0.3);
    assert!(motion.preintegrated.by_bias.fixed_columns::<3>(3).amax() > 0.0);
}
