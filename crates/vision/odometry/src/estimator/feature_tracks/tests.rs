use nalgebra::Vector3;

use super::*;
use crate::backend::state::GRAVITY;
use crate::config::Preset;
use crate::test_rig;

/// A body that moves sideways and up at constant acceleration, in front of landmarks.
#[test]
fn bearings_and_imu_give_poses_at_true_scale() {
    let rig = Rig {
        cameras: vec![test_rig::stereo(0.1)],
        imus: vec![test_rig::imu()],
    };
    let acceleration = Vector3::new(0.3, 0.2, -0.1);
    let position = |t: f64| acceleration * (0.5 * t * t);
    let force = acceleration + Vector3::new(0.0, 0.0, GRAVITY);
    let imu: Vec<ImuSample> = (0..=300)
        .map(|k| ImuSample {
            time_ns: k * 10_000_000,
            gyro: [1e-9 * (k % 7) as f64; 3],
            accel: force.map(|v| v + 1e-9 * (k % 5) as f64).into(),
        })
        .collect();
    let landmarks: Vec<Vector3<f64>> = (0..40)
        .map(|k| {
            let k = f64::from(k);
            Vector3::new(
                3.0 * (7.0 * k).sin(),
                2.0 * (3.0 * k).cos(),
                4.0 + (5.0 * k).sin(),
            )
        })
        .collect();
    let sets: Vec<Bearings> = (0..=12)
        .map(|k| {
            let t = 0.25 * f64::from(k);
            let seen = landmarks.iter().enumerate().map(|(id, x)| {
                let x = x - position(t);
                let at = [100.0 * x.x / x.z + 79.5, 100.0 * x.y / x.z + 59.5];
                (id as u64, at.map(|v| v as f32))
            });
            Bearings {
                time_ns: (t * 1e9) as i64,
                tracks: seen.collect(),
            }
        })
        .collect();
    let first = FirstState {
        world_from_imu: RigidTransform::identity(),
        velocity: [0.0; 3],
        sigmas: [1e-3, 1e-2, 0.05, 0.1, 0.15],
    };
    let found = estimate(&rig, &Config::preset(Preset::Balanced), &first, &imu, &sets);
    let found = found.expect("samples without a gap");
    for poses in found {
        assert_eq!(poses.len(), sets.len());
        let last = poses[poses.len() - 1];
        let error = last.world_from_imu.translation() - position(3.0);
        assert!(error.norm() < 0.02 * position(3.0).norm(), "{error:?}");
    }
}
