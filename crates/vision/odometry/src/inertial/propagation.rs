//! IMU propagation between frames, and the constant-velocity model without IMU samples.

use cad_transforms::RigidTransform;
use calib::ImuNoise;
use nalgebra::{SMatrix, Vector3};

use crate::backend::observation::Camera;
use crate::backend::state::State;
use crate::inertial::imu_buffer::{Coverage, ImuBuffer, Preintegrated, Reading};
use crate::rig::Rig;

/// Noise densities of the constant-velocity model, m/s²/√Hz and rad/s/√Hz.
const NO_IMU_NOISE_DENSITY: [f64; 2] = [3.0, 0.7];
/// Factor on the data-sheet noise densities; covers scale error, misalignment and thermal drift.
const IMU_NOISE_INFLATION: f64 = 2.0;

/// The IMU in use, with its buffer.
pub(crate) struct ImuPropagator {
    pub(crate) index: usize,
    pub(crate) noise: ImuNoise,
    pub(crate) range: [f64; 2],
    pub(crate) samples: ImuBuffer,
}

impl ImuPropagator {
    /// Cameras, body frame and IMU of a rig: the body frame is that of the first IMU, or the rig
    /// frame without an IMU.
    pub(crate) fn of(rig: &Rig) -> (Vec<Camera>, RigidTransform, Option<Self>) {
        let body_from_rig = rig
            .imus
            .first()
            .map_or_else(RigidTransform::identity, |imu| imu.rig_from_imu.inverse());
        let cameras = rig.cameras.iter();
        let imu = rig.imus.first().map(|imu| Self {
            index: 0,
            noise: ImuNoise {
                gyro_noise_density: imu.noise.gyro_noise_density * IMU_NOISE_INFLATION,
                accel_noise_density: imu.noise.accel_noise_density * IMU_NOISE_INFLATION,
                gyro_random_walk: imu.noise.gyro_random_walk * IMU_NOISE_INFLATION,
                accel_random_walk: imu.noise.accel_random_walk * IMU_NOISE_INFLATION,
            },
            range: imu.range,
            samples: ImuBuffer::new(imu.rate_hz),
        });
        let cameras = cameras.map(|c| Camera::new(c, &body_from_rig)).collect();
        (cameras, body_from_rig, imu)
    }

    /// Preintegrated motion from a state to a time; `None` if samples are missing or saturated.
    pub(crate) fn preintegrate(&self, from: &State, to_ns: i64) -> Option<Preintegrated> {
        let mut readings = Vec::new();
        let coverage = self.samples.between(from.time_ns, to_ns, &mut readings);
        (coverage == Coverage::Complete)
            .then(|| Preintegrated::new(&readings, &from.gyro_bias, &from.accel_bias, &self.noise))
    }

    /// Bias random walk densities.
    pub(crate) fn bias_walk(&self) -> [f64; 2] {
        [self.noise.gyro_random_walk, self.noise.accel_random_walk]
    }
}

/// Constant-velocity motion with an angular rate in the body frame, rad/s, for intervals without
/// IMU samples.
pub(crate) fn constant_velocity(from: &State, rate: Vector3<f64>, to_ns: i64) -> Preintegrated {
    let reading = |time_ns: i64| Reading {
        time_ns,
        gyro: rate,
        accel: Vector3::zeros(),
        saturated: false,
    };
    let noise = ImuNoise {
        gyro_noise_density: NO_IMU_NOISE_DENSITY[1],
        gyro_random_walk: 0.0,
        accel_noise_density: NO_IMU_NOISE_DENSITY[0],
        accel_random_walk: 0.0,
    };
    let zero = Vector3::zeros();
    let ends = [reading(from.time_ns), reading(to_ns)];
    let mut preintegrate = Preintegrated::new(&ends, &zero, &zero, &noise);
    // It is independent of the biases.
    preintegrate.by_bias = SMatrix::zeros();
    preintegrate
}
