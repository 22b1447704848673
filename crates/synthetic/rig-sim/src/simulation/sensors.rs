//! Cameras and IMUs of a rig, and their nominal calibration.

use cad_transforms::RigidTransform;
use cad_transforms::frame::{Frame, FramePart};
use cad_transforms::rig::{Rig, RigError};
use camera_models::{CameraModel, ImuCalibration, ImuNoise, Provenance, StereoCalibration};

use super::settings::{Settings, SimulationError};
use crate::imu::{Imu, ImuModel};
use crate::random;
use crate::rig::{SimCamera, cameras};

/// Random streams that seed the IMUs; distinct from the streams that the IMUs use themselves.
const IMU_SEEDS: u64 = random::IMU + 0x80;
/// Maximum exposure as a fraction of the frame period; the rest is readout.
pub(super) const MAX_EXPOSURE_RATIO: f64 = 0.9;

/// An IMU on the rig.
#[derive(Clone, Debug)]
pub struct RigImu {
    /// Sensor model.
    pub imu: Imu,
    /// Extrinsics.
    pub imu_from_rig: RigidTransform,
}

/// Nominal intrinsics and extrinsics of one camera: those that the recording contains.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct NominalCamera {
    pub(super) models: [CameraModel; 2],
    pub(super) rig_from_eye: [RigidTransform; 2],
    pub(super) imu_from_rig: RigidTransform,
}

/// Cameras and IMUs of a rig, after validation of the settings.
pub(super) fn sensors(
    settings: &Settings,
    rig: &Rig,
) -> Result<(Vec<SimCamera>, Vec<RigImu>), SimulationError> {
    settings.check()?;
    let mut cameras = cameras(rig, settings.width, settings.height)?;
    for camera in &mut cameras {
        let period_s = 1.0 / settings.rate_hz;
        camera.max_exposure_s = camera.max_exposure_s.min(MAX_EXPOSURE_RATIO * period_s);
    }
    let imus = imus(ImuModel::ZED_MINI, &cameras, settings, rig)?;
    Ok((cameras, imus))
}

/// Nominal calibration without error: equal to the ground truth.
pub(super) fn nominal_cameras(cameras: &[SimCamera], imus: &[RigImu]) -> Vec<NominalCamera> {
    let of = |(camera, imu): (&SimCamera, &RigImu)| NominalCamera {
        models: camera.models,
        rig_from_eye: camera.rig_from_eye,
        imu_from_rig: imu.imu_from_rig,
    };
    cameras.iter().zip(imus).map(of).collect()
}

pub(super) fn calibration_of(nominal: &NominalCamera, model: &ImuModel) -> StereoCalibration {
    let [left, right] = nominal.rig_from_eye;
    StereoCalibration {
        left: nominal.models[0],
        right: nominal.models[1],
        right_from_left: right.inverse() * left,
        imu: Some(ImuCalibration {
            imu_from_left: nominal.imu_from_rig * left,
            rate_hz: model.rate_hz,
            noise: Some(ImuNoise {
                gyro_noise_density: model.noise_density[0],
                gyro_random_walk: model.random_walk[0],
                accel_noise_density: model.noise_density[1],
                accel_random_walk: model.random_walk[1],
            }),
        }),
        provenance: Provenance {
            format: None,
            files: Vec::new(),
            part: None,
        },
    }
}

/// The IMUs of the cameras, each with its own errors.
pub(super) fn imus(
    model: ImuModel,
    cameras: &[SimCamera],
    settings: &Settings,
    rig: &Rig,
) -> Result<Vec<RigImu>, RigError> {
    let imu = |(camera, number): (&SimCamera, u64)| {
        let frame = Frame::of_camera(&camera.name, FramePart::Imu)
            .expect("a rig names its cameras by valid names");
        let imu_from_rig = rig.transform(&frame, &Frame::rig())?;
        let seed = random::bits(settings.seed, IMU_SEEDS, number);
        let imu = Imu::new(model, imu_from_rig, settings.seconds, seed);
        Ok(RigImu { imu, imu_from_rig })
    };
    cameras.iter().zip(0..).map(imu).collect()
}
