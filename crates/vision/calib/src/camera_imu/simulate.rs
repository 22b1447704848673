//! Simulated recordings of a board with ground truth, for tests and benchmarks of the estimator.
//!
//! The IMU moves on sums of sines, in position and in the rotation vector, so that rate and
//! acceleration are exact. Corners are projected and get normal noise; the sensor gets white noise,
//! random-walk biases, scale, skew and a time offset. No images are rendered: that is the task of
//! the simulated rig. Random values are a function of the seed.

use cad_transforms::RigidTransform;
use camera_models::{CameraModel, Distortion, Eye, ImuNoise};
use nalgebra::{Matrix3, Vector3};

use super::recording::{self, Cameras, Corner, Recording, TargetObservation};
use super::so3;
use camera_models::ImuSample;

/// Standard gravity, m/s².
const GRAVITY: f64 = recording::GRAVITY;

/// Random numbers from a seed (SplitMix64; normal values by Box and Muller 1958).
#[derive(Clone, Debug)]
pub struct Random(u64);

impl Random {
    /// From a seed.
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ 0x5851_f42d_4c95_7f2d)
    }

    /// Uniform above 0 and below 1.
    pub fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut x = self.0;
        x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        x ^= x >> 31;
        ((x >> 12) as f64 + 0.5) / (1_u64 << 52) as f64
    }

    /// Mean 0, standard deviation 1.
    pub fn normal(&mut self) -> f64 {
        let (u, v) = (self.uniform(), self.uniform());
        (-2.0 * u.ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    }

    fn vector(&mut self) -> Vector3<f64> {
        Vector3::new(self.normal(), self.normal(), self.normal())
    }
}

/// Settings of a simulated recording.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Length, s.
    pub seconds: f64,
    /// Frame rate, Hz.
    pub frame_hz: f64,
    /// IMU rate, Hz.
    pub imu_hz: f64,
    /// Noise of a corner, pixels, per axis.
    pub corner_px: f64,
    /// Nominal sigma of a corner, pixels.
    pub nominal_corner_px: f64,
    /// Whether the right eye observes the board too.
    pub stereo: bool,
    /// Corners along x and y, and their spacing, m.
    pub board: ([usize; 2], f64),
    /// True size of the board over its nominal size.
    pub board_scale: f64,
    /// True noise of the sensor.
    pub noise: ImuNoise,
    /// Nominal noise of the sensor.
    pub nominal_noise: ImuNoise,
    /// Turn-on bias, standard deviation, rad/s and m/s².
    pub turn_on_bias: [f64; 2],
    /// Scale and skew, standard deviation.
    pub scale_and_skew: [f64; 2],
    /// Largest rotation about each axis of the IMU frame, rad.
    pub turn_rad: [f64; 3],
    /// Largest translation along each axis of the target's frame, m.
    pub shift_m: [f64; 3],
    /// Takes the left optical frame to the IMU's.
    pub imu_from_left: RigidTransform,
    /// IMU time minus camera time in the middle of the recording, s.
    pub time_offset_s: f64,
    /// Drift of the time offset, seconds per second.
    pub time_drift: f64,
    /// Line time, s; 0 for a global shutter.
    pub line_s: f64,
    /// Fraction of corners displaced by up to 20 px.
    pub corner_outliers: f64,
}

/// Noise of the sensor in a ZED Mini.
pub const ZED_NOISE: ImuNoise = ImuNoise {
    gyro_noise_density: 1.2e-4,
    gyro_random_walk: 2e-6,
    accel_noise_density: 1.6e-3,
    accel_random_walk: 3e-5,
};

impl Scene {
    /// A recording with strong excitation and a good camera.
    pub fn lively(seconds: f64) -> Self {
        Self {
            seconds,
            frame_hz: 20.0,
            imu_hz: 400.0,
            corner_px: 0.15,
            nominal_corner_px: 0.15,
            stereo: true,
            board: ([8, 6], 0.08),
            board_scale: 1.0,
            noise: ZED_NOISE,
            nominal_noise: ZED_NOISE,
            turn_on_bias: [5e-3, 4e-2],
            scale_and_skew: [0.0, 0.0],
            turn_rad: [0.35, 0.35, 0.45],
            shift_m: [0.18, 0.14, 0.12],
            imu_from_left: RigidTransform::from_rotation_vector(
                [1.2, -1.25, 1.19],
                [0.021, -0.031, 0.008],
            )
            .expect("finite numbers"),
            time_offset_s: 0.0042,
            time_drift: 0.0,
            line_s: 0.0,
            corner_outliers: 0.0,
        }
    }
}

/// A sum of sines in three axes with its first two derivatives.
struct Sines(Vec<[(f64, f64, f64); 3]>);

impl Sines {
    /// Amplitudes sum up to `most` per axis; `slowest` and `fastest` in Hz.
    fn new(random: &mut Random, most: [f64; 3], slowest: f64, fastest: f64) -> Self {
        let count = 4;
        let mut terms = Vec::new();
        for k in 0..count {
            let low = slowest + (fastest - slowest) * f64::from(k) / f64::from(count);
            let high = low + (fastest - slowest) / f64::from(count);
            terms.push(std::array::from_fn(|axis| {
                let hz = low + (high - low) * random.uniform();
                let share = [0.4, 0.25, 0.2, 0.15][k as usize];
                let omega = std::f64::consts::TAU * hz;
                let phase = std::f64::consts::TAU * random.uniform();
                (most[axis] * share, omega, phase)
            }));
        }
        Self(terms)
    }

    fn at(&self, t: f64) -> [Vector3<f64>; 3] {
        let mut out = [Vector3::zeros(); 3];
        for term in &self.0 {
            for (axis, &(a, w, phase)) in term.iter().enumerate() {
                let (sin, cos) = (w * t + phase).sin_cos();
                out[0][axis] += a * sin;
                out[1][axis] += a * w * cos;
                out[2][axis] -= a * w * w * sin;
            }
        }
        out
    }
}

/// A recording and its ground truth.
pub struct SimulatedRecording {
    /// Input of an estimator.
    pub recording: Recording,
    /// Gravity in the target's frame, m/s².
    pub gravity_in_target: Vector3<f64>,
    /// Gyroscope and accelerometer bias in the middle of the recording.
    pub biases: [Vector3<f64>; 2],
}

/// Simulates a recording.
pub fn simulate(scene: &Scene, seed: u64) -> SimulatedRecording {
    let mut random = Random::new(seed);
    let turns = Sines::new(&mut random, scene.turn_rad, 0.15, 1.3);
    let shifts = Sines::new(&mut random, scene.shift_m, 0.2, 1.2);
    let cameras = cameras(scene.stereo).with_rolling_shutter(scene.line_s);
    let ([columns, rows], spacing) = scene.board;
    let board: Vec<Vector3<f64>> = (0..rows * columns)
        .map(|k| {
            let (x, y) = ((k % columns) as f64, (k / columns) as f64);
            Vector3::new(x * spacing, y * spacing, 0.0)
        })
        .collect();
    let middle = Vector3::new((columns - 1) as f64, (rows - 1) as f64, 0.0) * (0.5 * spacing);

    // The board is upright and slightly inclined; its y axis points down as in images.
    let lean = so3::exp(&(random.vector() * 0.05));
    let gravity_in_target = lean * Vector3::new(0.0, GRAVITY, 0.0);
    // The camera faces the board from 0.7 m: optical axes parallel to the board's.
    let left_from_imu = scene.imu_from_left.inverse();
    let resting = left_from_imu.rotation().to_rotation_matrix().into_inner();
    let imu_at = |t: f64| {
        let [turn, turning, _] = turns.at(t);
        let [shift, velocity, acceleration] = shifts.at(t);
        // The ground truth is in the board's true size.
        let position = middle * scene.board_scale + Vector3::new(0.0, 0.0, -0.7) + shift;
        let rotation = resting * so3::exp(&turn);
        let rate = so3::right_jacobian(&turn) * turning;
        (position, rotation, velocity, acceleration, rate)
    };

    let half = 0.5 * scene.seconds;
    let count = (scene.seconds * scene.imu_hz) as usize;
    let dt = 1.0 / scene.imu_hz;
    let shapes: [Matrix3<f64>; 2] = std::array::from_fn(|_| {
        let [scale, skew] = scene.scale_and_skew;
        Matrix3::from_fn(|r, c| match r == c {
            true => 1.0 + scale * random.normal(),
            false => skew * random.normal(),
        })
    });
    let mut biases = [
        random.vector() * scene.turn_on_bias[0],
        random.vector() * scene.turn_on_bias[1],
    ];
    let mut biases_in_middle = biases;
    let noise = &scene.noise;
    let mut imu = Vec::with_capacity(count);
    for k in 0..count {
        // IMU samples start a little before the views and end a little after them.
        let t = k as f64 * dt;
        let (_, rotation, _, acceleration, rate) = imu_at(t);
        let force = rotation.transpose() * (acceleration - gravity_in_target);
        let gyro =
            shapes[0] * rate + biases[0] + random.vector() * (noise.gyro_noise_density / dt.sqrt());
        let accel = shapes[1] * force
            + biases[1]
            + random.vector() * (noise.accel_noise_density / dt.sqrt());
        imu.push(ImuSample {
            time_ns: (t * 1e9).round() as i64,
            gyro: gyro.into(),
            accel: accel.into(),
        });
        biases[0] += random.vector() * (noise.gyro_random_walk * dt.sqrt());
        biases[1] += random.vector() * (noise.accel_random_walk * dt.sqrt());
        if k == count / 2 {
            biases_in_middle = biases;
        }
    }

    let mut observations = Vec::new();
    for k in 0..(scene.seconds * scene.frame_hz) as usize {
        let t = (k as f64 + 0.37) / scene.frame_hz;
        let mut corners = Vec::new();
        let eyes = [Eye::Left, Eye::Right];
        for eye in &eyes[..1 + usize::from(scene.stereo)] {
            for x_in_target in &board {
                let seen = |row_delay_s: f64| {
                    let (position, rotation, ..) = imu_at(t + row_delay_s);
                    let x_in_imu =
                        rotation.transpose() * (x_in_target * scene.board_scale - position);
                    let x_in_left = left_from_imu.apply(x_in_imu.into());
                    match (eye, &cameras.right) {
                        (Eye::Right, Some(right)) => {
                            let x = right.rotation * Vector3::from(x_in_left) + right.translation;
                            right.lens.project(x.into())
                        }
                        _ => cameras.left.project(x_in_left),
                    }
                };
                let lens = &cameras.left;
                let middle_row = 0.5 * (f64::from(lens.model().height) - 1.0);
                let mut pixel = seen(0.0);
                if scene.line_s != 0.0 {
                    // The exposure time depends on the row of the corner, and the row on the time.
                    for _ in 0..4 {
                        pixel = pixel.and_then(|p| seen(scene.line_s * (p[1] - middle_row)));
                    }
                }
                let Some(pixel) = pixel else {
                    continue;
                };
                let (width, height) = (lens.model().width, lens.model().height);
                let inside = |v: f64, size: u32| v > 3.0 && v < f64::from(size) - 4.0;
                if !inside(pixel[0], width) || !inside(pixel[1], height) {
                    continue;
                }
                let wrong = random.uniform() < scene.corner_outliers;
                let pixel = pixel.map(|v| {
                    let stray = if wrong {
                        40.0 * (random.uniform() - 0.5)
                    } else {
                        0.0
                    };
                    v + scene.corner_px * random.normal() + stray
                });
                corners.push(Corner {
                    x_in_target: (*x_in_target).into(),
                    pixel,
                    sigma_px: scene.nominal_corner_px,
                    eye: *eye,
                });
            }
        }
        let offset = scene.time_offset_s + scene.time_drift * (t - half);
        observations.push(TargetObservation {
            time_ns: ((t - offset) * 1e9).round() as i64,
            corners,
        });
    }
    SimulatedRecording {
        recording: Recording {
            cameras,
            observations,
            imu,
            noise: scene.nominal_noise,
            range: [f64::INFINITY; 2],
        },
        gravity_in_target,
        biases: biases_in_middle,
    }
}

fn cameras(stereo: bool) -> Cameras {
    let model = |cx: f64| CameraModel {
        width: 1280,
        height: 720,
        fx: 700.0,
        fy: 701.0,
        cx,
        cy: 355.0,
        distortion: Distortion::RadTan4 {
            k1: -0.17,
            k2: 0.025,
            p1: 2e-4,
            p2: -1e-4,
        },
    };
    let right_from_left =
        RigidTransform::from_rotation_vector([1e-3, 2e-3, -1e-3], [-0.063, 1e-4, -2e-4])
            .expect("finite numbers");
    let right = stereo.then(|| (model(652.0), right_from_left));
    Cameras::new(&model(641.0), right.as_ref().map(|(m, t)| (m, t)))
}
