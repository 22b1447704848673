//! Output `tracks`, written and read.

use cad_transforms::RigidTransform;
use scene_bundle::outputs::tracks::{
    Keypoint, StereoObservation, TrackedKeyframe, TracksWriter, read,
};
use scene_bundle::{Bundle, BundleError, Scene, outputs};

use crate::sample;

fn keyframe(k: u64, corners: u64) -> TrackedKeyframe {
    let s = k as f64;
    TrackedKeyframe {
        set: 7 * k,
        time_ns: 1_000_000_000 + 333_333_333 * k as i64,
        world_from_body: RigidTransform::from_rotation_vector([0.1 * s, -0.2, 0.3], [s, 2.0, -s])
            .expect("finite"),
        velocity: [1.0, -0.1 * s, 0.0],
        gyro_bias: [0.001, -0.002, 0.003 * s],
        accel_bias: [0.01, 0.02 * s, -0.03],
        gyro_rate: [0.5, -0.25, s],
        imu_valid: s > 0.0,
        exposure_offset_s: vec![0.0, 0.004, -0.002],
        stereo_errors: vec![
            [0.0; 7],
            [1e-3, -2e-3, 0.0, 0.01, 0.0, 1e-4, 2e-3],
            [0.0; 7],
        ],
        extrinsics_errors: vec![
            [1e-3, 0.0, -1e-3, 4e-3, 0.0, 5e-3],
            [0.0; 6],
            [0.0, 2e-4, 0.0, 0.0, -1e-3, s * 1e-3],
        ],
        observations: (0..corners)
            .map(|n| StereoObservation {
                track: 1000 * k + n,
                camera: (n % 3) as u8,
                left_px: [n as f32 + 0.25, 17.5],
                right_px: n.is_multiple_of(2).then_some([n as f32 - 3.0, 17.0]),
            })
            .collect(),
        keypoints: (0..corners / 2)
            .map(|n| Keypoint {
                camera: 2,
                left_px: [5.0, n as f32],
                inverse_range: 0.3 * n as f32,
                descriptor: [n, !n, k, 1 << 63],
            })
            .collect(),
    }
}

/// Writes keyframes, and reads them as those of a rig with `cameras` cameras.
fn through(
    keyframes: &[TrackedKeyframe],
    cameras: usize,
) -> Result<Vec<TrackedKeyframe>, BundleError> {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("walk.scene");
    let bundle = Bundle::create_or_open(&path, sample::provenance()).expect("a bundle");
    let draft = bundle.begin(outputs::TRACKS).expect("a draft");
    let mut writer = TracksWriter::new(&draft).expect("tables");
    for keyframe in keyframes {
        writer.push(keyframe).expect("a row");
    }
    writer.finish().expect("whole tables");
    draft
        .commit(sample::record(outputs::TRACKS))
        .expect("committed");
    drop(bundle);
    let scene = Scene::open(&path).expect("a scene");
    read(&scene.output(outputs::TRACKS).expect("tracks"), cameras)
}

#[test]
fn tracks_read_back_unchanged() {
    // One of them has no observations.
    let keyframes = [keyframe(0, 9), keyframe(1, 0), keyframe(2, 4)];
    assert_eq!(through(&keyframes, 3).expect("read"), keyframes);
    assert_eq!(through(&[], 3).expect("read"), []);
}

#[test]
fn observations_of_unknown_cameras_are_refused() {
    let error = through(&[keyframe(0, 9)], 2)
        .expect_err("two cameras")
        .to_string();
    assert!(
        error.contains("an observation of camera 2") && error.contains("one of 2"),
        "{error}"
    );
}
