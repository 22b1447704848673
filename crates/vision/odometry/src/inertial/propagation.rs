//! Motion by one IMU between frames, and the constant-velocity model without IMU samples.

use cad_transforms::RigidTransform;
use camera_models::{ImuNoise, ImuSample};
use nalgebra::{SMatrix, UnitQuaternion, Vector3};

use crate::backend::state::State;
use crate::config::InertialConfig;
use crate::inertial::imu_buffer::{
    Coverage, GYROSCOPE, ImuBuffer, LeverArm, Preintegration, Reading,
};
use crate::rig::Imu;

/// One IMU with its buffer.
///
/// Contract: readings and biases are in the axes of the body frame. An IMU elsewhere on the plate
/// has a lever arm, which is part of its preintegrated motion: the motion is that of the origin of
/// the body frame.
pub(crate) struct ImuPropagator {
    pub(crate) samples: ImuBuffer,
    noise: ImuNoise,
    range: [f64; 2],
    rate_hz: f64,
    body_from_imu: UnitQuaternion<f64>,
    /// Position of the IMU in the body frame, m.
    arm: Vector3<f64>,
    config: InertialConfig,
}

impl ImuPropagator {
    pub(crate) fn new(imu: &Imu, body_from_imu: &RigidTransform, config: &InertialConfig) -> Self {
        let [gyro, accel] = config.noise_inflation;
        Self {
            samples: ImuBuffer::new(config, imu.rate_hz),
            noise: ImuNoise {
                gyro_noise_density: imu.noise.gyro_noise_density * gyro,
                accel_noise_density: imu.noise.accel_noise_density * accel,
                gyro_random_walk: imu.noise.gyro_random_walk * gyro,
                accel_random_walk: imu.noise.accel_random_walk * accel,
            },
            range: imu.range,
            rate_hz: imu.rate_hz,
            body_from_imu: *body_from_imu.rotation(),
            arm: *body_from_imu.translation(),
            config: *config,
        }
    }

    /// Adds a sample.
    pub(crate) fn push(&mut self, sample: &ImuSample) {
        self.samples.push(sample, self.range);
    }

    /// Reading at a time, and whether its neighbors are near.
    pub(crate) fn at(&self, time_ns: i64) -> Option<(Reading, bool)> {
        let (reading, is_near) = self.samples.at(time_ns)?;
        Some((self.in_body(&reading), is_near))
    }

    /// Readings of an interval, with interpolated ones at both ends.
    pub(crate) fn between(&self, from_ns: i64, to_ns: i64) -> (Vec<Reading>, Coverage) {
        let mut readings = Vec::new();
        let coverage = self.samples.between(from_ns, to_ns, &mut readings);
        for reading in &mut readings {
            *reading = self.in_body(reading);
        }
        (readings, coverage)
    }

    fn in_body(&self, reading: &Reading) -> Reading {
        Reading {
            gyro: self.body_from_imu * reading.gyro,
            accel: self.body_from_imu * reading.accel,
            ..*reading
        }
    }

    /// Angular rate at a time, rad/s, with its bias; `None` if it is missing or saturated.
    pub(crate) fn gyro_rate(&self, time_ns: i64) -> Option<Vector3<f64>> {
        let (reading, is_near) = self.at(time_ns)?;
        (is_near && !reading.saturated[GYROSCOPE]).then_some(reading.gyro)
    }

    /// Preintegrated motion from a state to a time, and whether it includes gravity; `None` if
    /// samples are missing or both sensors are saturated. Of a saturated sensor the
    /// constant-velocity model takes the place: `rate` is its angular rate in the body frame,
    /// rad/s.
    pub(crate) fn preintegrate(
        &self,
        from: &State,
        to_ns: i64,
        rate: Vector3<f64>,
    ) -> Option<(Preintegration, bool)> {
        let (mut readings, coverage) = self.between(from.time_ns, to_ns);
        let mut noise = self.noise;
        let [accel_density, gyro_density] = self.config.constant_velocity_noise_density;
        // Without a gyroscope the motion of the lever arm is not known.
        let has_arm = self.arm != Vector3::zeros();
        match coverage {
            Coverage::Complete => {}
            Coverage::GyroscopeOnly => {
                readings.iter_mut().for_each(|r| r.accel = from.accel_bias);
                noise.accel_noise_density = accel_density;
            }
            Coverage::AccelerometerOnly if !has_arm => {
                let gyro = rate + from.gyro_bias;
                readings.iter_mut().for_each(|r| r.gyro = gyro);
                noise.gyro_noise_density = gyro_density;
            }
            Coverage::AccelerometerOnly | Coverage::Gap => return None,
        }
        let biases = [from.gyro_bias, from.accel_bias];
        let mut motion =
            Preintegration::new(&readings, &biases[0], &biases[1], &noise, &self.config);
        match coverage {
            Coverage::GyroscopeOnly => motion.by_bias.fixed_columns_mut::<3>(3).fill(0.0),
            Coverage::AccelerometerOnly => {
                motion.by_bias.fixed_columns_mut::<3>(0).fill(0.0);
                motion.by_gyro_scale.fill(0.0);
            }
            Coverage::Complete if has_arm => {
                let ends = [&readings[0], &readings[readings.len() - 1]];
                motion = motion.at_body_origin(&LeverArm {
                    arm: self.arm,
                    rates: ends.map(|end| end.gyro - from.gyro_bias),
                    rate_sigma: self.noise.gyro_noise_density * self.rate_hz.sqrt(),
                    scale_error: self.config.gyro_scale_sigma,
                });
            }
            Coverage::Complete | Coverage::Gap => {}
        }
        Some((motion, coverage != Coverage::GyroscopeOnly))
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
) -> Preintegration {
    let reading = |time_ns: i64| Reading {
        time_ns,
        gyro: rate,
        accel: Vector3::zeros(),
        saturated: [false; 2],
    };
    let noise = ImuNoise {
        gyro_noise_density: config.constant_velocity_noise_density[1],
        gyro_random_walk: 0.0,
        accel_noise_density: config.constant_velocity_noise_density[0],
        accel_random_walk: 0.0,
    };
    let zero = Vector3::zeros();
    let ends = [reading(from.time_ns), reading(to_ns)];
    let mut preintegrate = Preintegration::new(&ends, &zero, &zero, &noise, config);
    // It is independent of the IMU.
    preintegrate.by_bias = SMatrix::zeros();
    preintegrate.by_gyro_scale = SMatrix::zeros();
    preintegrate
}
