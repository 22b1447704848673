//! What odometry keeps of a keyframe for everything that comes after it.
//!
//! Plain numbers, so that they can be written down and read again: corners that were followed through it, and corners that are
//! easy to find again with a description of how they look. A keyframe takes some 40 kB for three cameras.

use nalgebra::{UnitQuaternion, Vector3};

use crate::backend::state::State;

/// The state of the body; see [`crate::estimator`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyState {
    /// ns.
    pub time_ns: i64,
    /// In the world, m.
    pub position: Vector3<f64>,
    /// World from body.
    pub rotation: UnitQuaternion<f64>,
    /// In the world, m/s.
    pub velocity: Vector3<f64>,
    /// rad/s.
    pub gyro_bias: Vector3<f64>,
    /// m/s².
    pub accel_bias: Vector3<f64>,
    /// Rate of the body about its own axes as the gyroscope read it, rad/s.
    pub gyro_rate: Vector3<f64>,
}

impl From<&State> for BodyState {
    fn from(state: &State) -> Self {
        Self {
            time_ns: state.time_ns,
            position: state.position,
            rotation: state.rotation,
            velocity: state.velocity,
            gyro_bias: state.gyro_bias,
            accel_bias: state.accel_bias,
            gyro_rate: state.gyro_rate,
        }
    }
}

impl From<&BodyState> for State {
    fn from(state: &BodyState) -> Self {
        Self {
            time_ns: state.time_ns,
            position: state.position,
            rotation: state.rotation,
            velocity: state.velocity,
            gyro_bias: state.gyro_bias,
            accel_bias: state.accel_bias,
            gyro_rate: state.gyro_rate,
        }
    }
}

/// See the module.
#[derive(Clone, Debug, PartialEq)]
pub struct Keyframe {
    /// Number of the frame set, from 1.
    pub number: u64,
    /// As the window saw it last.
    pub state: BodyState,
    /// Whether what the IMU felt since the keyframe before was believed: nothing was missing, and it went with what was seen.
    pub imu_valid: bool,
    /// How much later than the state each camera's middle row was exposed, s; 0 where it has no picture.
    pub exposure_offset_s: Vec<f64>,
    /// Corners that were followed through it.
    pub observations: Vec<StereoObservation>,
    /// Corners to find it again by.
    pub keypoints: Vec<Keypoint>,
}

/// A corner that was followed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoObservation {
    /// The same in every keyframe that saw it.
    pub id: u64,
    /// Place of the camera in the rig.
    pub camera: u8,
    /// In the left picture, px.
    pub left: [f32; 2],
    /// In the right one, where it was found.
    pub right: Option<[f32; 2]>,
}

/// A corner to find again.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// Place of the camera in the rig.
    pub camera: u8,
    /// In the left picture, px.
    pub left: [f32; 2],
    /// Inverse range from the left eye, 1/m; 0 where the eyes do not tell.
    pub rho: f32,
    /// How it looks: 256 comparisons of grey levels around it, upright as the picture is.
    pub descriptor: [u64; 4],
}
