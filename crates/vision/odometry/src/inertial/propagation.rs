//! IMU propagation between frames, and the constant-velocity model without IMU samples.

use cad_transforms::RigidTransform;
use camera_models::ImuNoise;
use nalgebra::{SMatrix, Vector3};

use crate::backend::observation::Camera;
use crate::backend::state::State;
use crate::config::InertialConfig;
use crate::inertial::imu_buffer::{Coverage, ImuBuffer, Preintegrated, Reading};
use crate::rig::Rig;

/// The IMU in use, with its buffer.
pub(crate) struct ImuPropagator {
    pub(crate) index: usize,
    pub(crate) noise: ImuNoise,
    pub(crate) range: [f64; 2],
    pub(crate) samples: ImuBuffer,
    scale_error: [f64; 2],
}

impl ImuPropagator {
    /// Cameras, body frame and IMU of a rig: the body frame is that of the first IMU, or the rig
    /// frame without an IMU.
    pub(crate) fn of(
        rig: &Rig,
        config: &InertialConfig,
    ) -> (Vec<Camera>, RigidTransform, Option<Self>) {
        let body_from_rig = rig
            .imus
            .first()
            .map_or_else(RigidTransform::identity, |imu| imu.rig_from_imu.inverse());
        let cameras = rig.cameras.iter();
        let imu = rig.imus.first().map(|imu| Self {
            index: 0,
            noise: ImuNoise {
                gyro_noise_density: imu.noise.gyro_noise_density * config.noise_inflation,
                accel_noise_density: imu.noise.accel_noise_density * config.noise_inflation,
                gyro_random_walk: imu.noise.gyro_random_walk * config.noise_inflation,
                accel_random_walk: imu.noise.accel_random_walk * config.noise_inflation,
            },
            range: imu.range,
            samples: ImuBuffer::new(config, imu.rate_hz),
            scale_error: config.scale_error,
        });
        let cameras = cameras.map(|c| Camera::new(c, &body_from_rig)).collect();
        (cameras, body_from_rig, imu)
    }

    /// Preintegrated motion from a state to a time; `None` if samples are missing or saturated.
    pub(crate) fn preintegrate(&self, from: &State, to_ns: i64) -> Option<Preintegrated> {
        let mut readings = Vec::new();
        let coverage = self.samples.between(from.time_ns, to_ns, &mut readings);
        (coverage == Coverage::Complete).then(|| {
            Preintegrated::new(
                &readings,
                &from.gyro_bias,
                &from.accel_bias,
                &self.noise,
                &self.scale_error,
            )
        })
    }

    /// Bias random walk densities.
    pub(crate) fn bias_walk(&self) -> [f64; 2] {
        [self.noise.gyro_random_walk, self.noise.accel_random_walk]
    }
}

/// Constant-velocity motion with an angular rate in the body frame, rad/s, for intervals without
/// IMU samples.
pub(crate) fn constant_velocity(
    config: &InertialConfig,
    from: &State,
    rate: Vector3<f64>,
    to_ns: i64,
) -> Preintegrated {
    let reading = |time_ns: i64| Reading {
        time_ns,
        gyro: rate,
        accel: Vector3::zeros(),
        saturated: false,
    };
    let noise = ImuNoise {
        gyro_noise_density: config.constant_velocity_noise_density[1],
        gyro_random_walk: 0.0,
        accel_noise_density: config.constant_velocity_noise_density[0],
        accel_random_walk: 0.0,
    };
    let zero = Vector3::zeros();
    let ends = [reading(from.time_ns), reading(to_ns)];
    let mut preintegrate = Preintegrated::new(&ends, &zero, &zero, &noise, &config.scale_error);
    // It is independent of the biases.
    preintegrate.by_bias = SMatrix::zeros();
    preintegrate
}
