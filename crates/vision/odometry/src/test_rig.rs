//! Synthetic rig parts for tests.

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion, ImuNoise};

use crate::rig::{Imu, StereoCamera};

/// Image size of [`stereo`]: columns and rows.
pub(crate) const SIZE_PX: [usize; 2] = [160, 120];

/// A small stereo camera without distortion at the rig's origin.
pub(crate) fn stereo(baseline_m: f64) -> StereoCamera {
    let lens = CameraModel {
        width: SIZE_PX[0] as u32,
        height: SIZE_PX[1] as u32,
        fx: 100.0,
        fy: 100.0,
        cx: 79.5,
        cy: 59.5,
        distortion: Distortion::None,
    };
    StereoCamera {
        name: "front".to_owned(),
        left: lens,
        right: lens,
        rig_from_left: RigidTransform::identity(),
        covariance: None,
        right_from_left: RigidTransform::from_translation_m([-baseline_m, 0.0, 0.0])
            .expect("finite"),
        right_from_left_covariance: None,
        line_s: 0.0,
    }
}

/// An IMU at the rig origin with an infinite range, at 100 Hz.
pub(crate) fn imu() -> Imu {
    Imu {
        name: "front/imu".to_owned(),
        rig_from_imu: RigidTransform::identity(),
        noise: ImuNoise {
            gyro_noise_density: 1e-4,
            accel_noise_density: 2e-3,
            gyro_random_walk: 1e-5,
            accel_random_walk: 1e-4,
        },
        rate_hz: 100.0,
        range: [f64::INFINITY; 2],
    }
}
