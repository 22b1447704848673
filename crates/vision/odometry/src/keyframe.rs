//! Keyframe: the data of a frame that later stages need.
//!
//! Plain numbers, so that they can be stored and read back: observations of tracked features, and
//! keypoints with descriptors for loop closure. A keyframe takes about 40 kB for three cameras.

use nalgebra::{UnitQuaternion, Vector3};

use crate::backend::state::State;

/// State of the body; see [`crate::estimator`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyState {
    /// Time, ns.
    pub time_ns: i64,
    /// Position in the world, m.
    pub position: Vector3<f64>,
    /// Orientation: world from body.
    pub rotation: UnitQuaternion<f64>,
    /// Velocity in the world, m/s.
    pub velocity: Vector3<f64>,
    /// Gyroscope bias, rad/s.
    pub gyro_bias: Vector3<f64>,
    /// Accelerometer bias, m/s².
    pub accel_bias: Vector3<f64>,
    /// Angular rate in the body frame as measured by the gyroscope, bias included, rad/s.
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

/// A keyframe of the estimator.
#[derive(Clone, Debug, PartialEq)]
pub struct Keyframe {
    /// Number of the frame set, from 1.
    pub number: u64,
    /// Last estimate of the sliding window.
    pub state: BodyState,
    /// Whether the IMU samples since the previous keyframe were used: none was missing, and they
    /// agreed with the images.
    pub imu_valid: bool,
    /// Estimated error of the stereo calibration of each camera, see
    /// [`RefinedStereo::error`](crate::mapping::RefinedStereo::error).
    pub stereo_errors: Vec<[f64; 7]>,
    /// Estimated error of the extrinsics of each camera: small motion of its left optical frame in
    /// its own axes, translation m and rotation rad.
    pub extrinsics_errors: Vec<[f64; 6]>,
    /// Exposure offset of the middle row of each camera against the state, s; 0 without a frame.
    pub exposure_offset_s: Vec<f64>,
    /// Observations of tracked features.
    pub observations: Vec<StereoObservation>,
    /// Keypoints for loop closure.
    pub keypoints: Vec<Keypoint>,
}

/// Observation of a tracked feature in a stereo frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StereoObservation {
    /// Track id, the same in every keyframe that observed the feature.
    pub id: u64,
    /// Index of the camera in the rig.
    pub camera: u8,
    /// Position in the left image, px.
    pub left: [f32; 2],
    /// Position in the right image, px, if matched.
    pub right: Option<[f32; 2]>,
}

/// Keypoint for loop closure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Keypoint {
    /// Index of the camera in the rig.
    pub camera: u8,
    /// Position in the left image, px.
    pub left: [f32; 2],
    /// Inverse range from the left camera, 1/m; 0 if stereo does not determine it.
    pub rho: f32,
    /// BRIEF descriptor: 256 comparisons of gray levels, without rotation invariance.
    pub descriptor: [u64; 4],
}
