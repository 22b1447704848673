//! Simulated IMU on the rig.
//!
//! Contract: sample `n` is a function of walk, model, seed and `n`. Without noise
//! ([`ImuModel::PERFECT`]) it is the exact specific force and angular rate at the sensor's
//! position, from the spline's derivatives. Biases are random walks: independent normal steps, one
//! per sample, summed when the sensor is created.

use cad_transforms::RigidTransform;
use nalgebra::Vector3;

use crate::random;
use crate::walker::Walker;

/// Standard gravity, m/s², along -z of the world.
pub const GRAVITY: f64 = 9.806_65;

/// Error model of an IMU.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuModel {
    /// Samples per second.
    pub rate_hz: f64,
    /// White noise density, rad/s/√Hz and m/s²/√Hz.
    pub noise_density: [f64; 2],
    /// Bias random walk, rad/s²/√Hz and m/s³/√Hz.
    pub random_walk: [f64; 2],
    /// Turn-on bias, standard deviation, rad/s and m/s².
    pub turn_on_bias: [f64; 2],
    /// Scale error per axis and misalignment between axes, standard deviation.
    pub scale_and_skew: [f64; 2],
    /// Bias drift rate while warming up, rad/s² and m/s³; halves every two minutes.
    pub warming: [f64; 2],
    /// Range (saturation), rad/s and m/s².
    pub range: [f64; 2],
    /// Quantization step, rad/s and m/s²; 0 for none.
    pub count: [f64; 2],
}

impl ImuModel {
    /// Ideal sensor without errors.
    pub const PERFECT: Self = Self {
        rate_hz: 400.0,
        noise_density: [0.0; 2],
        random_walk: [0.0; 2],
        turn_on_bias: [0.0; 2],
        scale_and_skew: [0.0; 2],
        warming: [0.0; 2],
        range: [f64::INFINITY; 2],
        count: [0.0; 2],
    };

    /// IMU of a ZED Mini: ranges and quantization from zed-open-capture, noise as in data sheets of
    /// such parts.
    pub const ZED_MINI: Self = Self {
        rate_hz: 400.0,
        noise_density: [1.2e-4, 1.6e-3],
        random_walk: [2e-6, 3e-5],
        turn_on_bias: [5e-3, 4e-2],
        scale_and_skew: [5e-3, 1e-3],
        warming: [1e-6, 1e-5],
        range: [1000.0 * std::f64::consts::PI / 180.0, 9.8189 * 8.0],
        count: [
            1000.0 / 32_768.0 * std::f64::consts::PI / 180.0,
            9.8189 * 8.0 / 32_768.0,
        ],
    };
}

/// One measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImuSample {
    /// Time, s.
    pub time_s: f64,
    /// Angular rate in the sensor's frame, rad/s.
    pub gyro: Vector3<f64>,
    /// Specific force in the sensor's frame, m/s².
    pub accel: Vector3<f64>,
}

/// Faults of an IMU at one time.
#[derive(Clone, Debug, PartialEq)]
pub struct ImuFaults {
    /// Fraction of the range at which values saturate.
    pub range_share: f64,
    /// Displacement of its camera on the rig: [`crate::rig::SimCamera::slip`].
    pub slip: Option<RigidTransform>,
}

impl ImuFaults {
    /// No faults.
    pub const NONE: Self = Self {
        range_share: 1.0,
        slip: None,
    };
}

/// Angular rate and specific force at a pose on the rig, in the sensor frame.
fn measured(walker: &Walker, time_s: f64, imu_from_rig: &RigidTransform) -> [Vector3<f64>; 2] {
    let rig = walker.rig(time_s);
    let arm = *imu_from_rig.inverse().translation();
    let turn = imu_from_rig.rotation();
    let gravity = Vector3::z() * -GRAVITY;
    let force = rig.rotation.inverse() * (rig.acceleration - gravity)
        + rig.angular_acceleration.cross(&arm)
        + rig.angular_rate.cross(&rig.angular_rate.cross(&arm));
    [turn * rig.angular_rate, turn * force]
}

/// A sensor on the rig for the length of a walk.
#[derive(Clone, Debug)]
pub struct Imu {
    model: ImuModel,
    seed: u64,
    imu_from_rig: RigidTransform,
    /// Gyro and accelerometer bias at each sample.
    biases: Vec<[Vector3<f64>; 2]>,
    /// Scale on the diagonal, misalignment off it; rows.
    shapes: [[Vector3<f64>; 3]; 2],
}

impl Imu {
    /// A sensor at a pose on the rig for `seconds`. Each sensor has its own `seed`.
    pub fn new(model: ImuModel, imu_from_rig: RigidTransform, seconds: f64, seed: u64) -> Self {
        let normal = |k: u64, i: u64| random::bell(seed, random::IMU + k, i);
        let vector = |k: u64, i: u64| {
            Vector3::new(normal(k, 3 * i), normal(k, 3 * i + 1), normal(k, 3 * i + 2))
        };
        let shapes = [0, 1].map(|s| {
            let [scale, skew] = model.scale_and_skew;
            [0, 1, 2].map(|row| {
                let mut shape = vector(s, row) * skew;
                shape[row as usize] = 1.0 + scale * normal(2 + s, row);
                shape
            })
        });
        // Slightly longer than the walk: the oscillator of a device may run fast.
        let count = (seconds * model.rate_hz * 1.001).ceil() as usize + 2;
        let dt = 1.0 / model.rate_hz;
        let mut walked = [0, 1].map(|s| vector(4 + s, 0) * model.turn_on_bias[s as usize]);
        let warming = [0, 1].map(|s| vector(6 + s, 0) * model.warming[s as usize]);
        let mut biases = Vec::with_capacity(count);
        for i in 0..count {
            biases.push(walked);
            let cooling = libm::exp2(-(i as f64) * dt / 120.0);
            for s in 0..2 {
                let step = vector(8 + s as u64, i as u64) * (model.random_walk[s] * dt.sqrt());
                walked[s] += step + warming[s] * (cooling * dt);
            }
        }
        Self {
            model,
            seed,
            imu_from_rig,
            biases,
            shapes,
        }
    }

    /// Error model.
    pub fn model(&self) -> &ImuModel {
        &self.model
    }

    /// True angular rate and specific force at a time, s.
    pub fn truth(&self, walker: &Walker, time_s: f64) -> [Vector3<f64>; 2] {
        measured(walker, time_s, &self.imu_from_rig)
    }

    /// Sample `n`, at `n / rate` of the device's own seconds; `time_s` is the true time.
    ///
    /// # Panics
    /// If `n` is beyond the length of the sensor's walk.
    pub fn sample(&self, walker: &Walker, n: usize, time_s: f64, faults: &ImuFaults) -> ImuSample {
        let imu_from_rig = match &faults.slip {
            None => self.imu_from_rig,
            Some(slip) => self.imu_from_rig * slip.inverse(),
        };
        let true_values = measured(walker, time_s, &imu_from_rig);
        let per_root = self.model.rate_hz.sqrt();
        let [gyro, accel] = [0, 1].map(|s| {
            let shape = &self.shapes[s];
            let value = true_values[s];
            let mut value = Vector3::new(
                shape[0].dot(&value),
                shape[1].dot(&value),
                shape[2].dot(&value),
            ) + self.biases[n][s];
            for axis in 0..3 {
                let draw = random::bell(
                    self.seed,
                    random::IMU + 16 + (3 * s + axis) as u64,
                    n as u64,
                );
                value[axis] += draw * self.model.noise_density[s] * per_root;
                let range = self.model.range[s] * faults.range_share;
                value[axis] = value[axis].clamp(-range, range);
                if self.model.count[s] > 0.0 {
                    value[axis] = (value[axis] / self.model.count[s]).round() * self.model.count[s];
                }
            }
            value
        });
        ImuSample {
            time_s,
            gyro,
            accel,
        }
    }

    /// The sample in counts, gyro and accelerometer.
    ///
    /// # Panics
    /// If the model has no quantization.
    pub fn counts(&self, sample: &ImuSample) -> [[i16; 3]; 2] {
        let of = |values: &Vector3<f64>, count: f64| {
            assert!(count > 0.0, "a model that is not digital has no counts");
            [0, 1, 2].map(|k| (values[k] / count).round().clamp(-32_768.0, 32_767.0) as i16)
        };
        let [gyro, accel] = self.model.count;
        [of(&sample.gyro, gyro), of(&sample.accel, accel)]
    }

    /// Bias of sample `n`: gyro and accelerometer.
    pub fn bias(&self, n: usize) -> [Vector3<f64>; 2] {
        self.biases[n]
    }
}
