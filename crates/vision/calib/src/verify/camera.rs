//! A camera with its observations, and the tolerances of a rig.

use cad_transforms::RigidTransform;
use camera_models::StereoCalibration;

use super::gyro::Gyro;
use super::tracks::Burst;

/// Nominal calibration of a camera, and its observations.
#[derive(Clone, Debug)]
pub struct Camera<'a> {
    /// `left_shoulder`, `right_shoulder`, `feet`.
    pub name: &'a str,
    /// Intrinsics, stereo extrinsics, and IMU extrinsics.
    pub nominal: &'a StereoCalibration,
    /// Takes points in the left optical frame to the rig, if a rig file gives it.
    pub rig_from_left: Option<RigidTransform>,
    /// Tolerance of the joint between camera and plate, rad, standard deviation per axis.
    pub joint_sigma_rad: Option<f64>,
    /// Line time: from the exposure of a row to that of the next, s; 0 for a global shutter.
    /// Estimated if `None`.
    pub line_s: Option<f64>,
    /// Feature tracks of its images.
    pub bursts: &'a [Burst],
    /// Its gyroscope.
    pub gyro: Option<&'a Gyro>,
}

/// Default tolerances, standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerances {
    /// A camera's joint on the plate, rad.
    pub joint_rad: f64,
    /// IMU in its camera, rad: mounting of the chip and alignment of its axes. Larger if the
    /// extrinsics are assumed.
    pub imu_rad: f64,
    /// Right eye against left eye, rad.
    pub eyes_rad: f64,
    /// Clock, s: of a device, or of its images or samples.
    pub clock_s: f64,
}

impl Default for Tolerances {
    fn default() -> Self {
        Self {
            joint_rad: 0.07_f64.to_radians(),
            imu_rad: 0.07_f64.to_radians(),
            eyes_rad: 0.03_f64.to_radians(),
            clock_s: 3e-4,
        }
    }
}
