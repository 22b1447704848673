//! Is the calibration still true? Asked of an ordinary walk, without a target.
//!
//! [`verify`] compares what a rig's cameras and gyroscopes saw of one walk with what is told of them: the eyes of each
//! camera with one another, each camera with its own gyroscope, the gyroscopes with one another, and by way of these
//! the cameras. Each comparison has a covariance; together they say what is off, by how much, and which one of
//! several cameras it is.
//!
//! Contract: pictures come in as the places that [`FeatureTracker`] finds in short bursts ([`choose_bursts`] says when). A
//! walk that does not tell (nothing to see, nothing turns, too short) gives [`Status::Undetermined`] for what it does
//! not tell, never a verdict. What is *off* is so beyond the tolerance of its joint and the uncertainty of the measurement
//! together ([`DETECTION_SIGMA`]). Scenes may move in part; what most of the picture agrees on counts as the world. The same input
//! gives the same result.
//!
//! How each part works stands at its head; what it can and cannot see: `docs/calibration-verify.md`.

use cad_transforms::RigidTransform;
use serde::Serialize;

use crate::stereo::StereoCalibration;

mod bursts;
mod camera_imu;
mod corners;
mod decision;
mod epipolar_search;
mod findings;
mod gyro;
mod gyro_pairs;
mod klt;
mod motion;
mod pyramid;
mod robust;
mod stereo;
#[cfg(test)]
mod tests;
mod tracks;

pub use bursts::choose_bursts;
pub use camera_imu::CameraImu;
pub use decision::DETECTION_SIGMA;
pub use findings::{Finding, Parameter, Status};
pub use gyro::Gyro;
pub use gyro_pairs::GyroAlignment;
pub use pyramid::ImageView;
pub use stereo::StereoAlignment;
pub use tracks::{Burst, Feature, FeatureTracker, StereoFrame, TrackSegment};

/// What is told of a camera, and what it saw.
#[derive(Clone, Debug)]
pub struct Camera<'a> {
    /// `left_shoulder`, `right_shoulder`, `feet`.
    pub name: &'a str,
    /// Lenses, eyes, and the IMU's place in the camera.
    pub nominal: &'a StereoCalibration,
    /// Takes points in the left optical frame to the rig, where a rig file says so.
    pub rig_from_left: Option<RigidTransform>,
    /// Tolerance of the joint that holds the camera on the plate, rad, standard deviation per axis.
    pub joint_sigma_rad: Option<f64>,
    /// From the exposure of a row to that of the next, s; 0 where all are exposed at once. Found out where it is not told.
    pub line_s: Option<f64>,
    /// What its pictures gave.
    pub bursts: &'a [Burst],
    /// Its gyroscope.
    pub gyro: Option<&'a Gyro>,
}

/// What is tolerated where nothing else is told, standard deviations.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerances {
    /// A camera's joint on the plate, rad.
    pub joint_rad: f64,
    /// An IMU in its camera, rad: its chip on the board, the axes of its sensors. Larger where its place is assumed.
    pub imu_rad: f64,
    /// The right eye against the left one, rad.
    pub eyes_rad: f64,
    /// A clock, s: of a device, or of pictures or samples of one.
    pub clock_s: f64,
}

impl Default for Tolerances {
    fn default() -> Self {
        Self {
            joint_rad: 0.07_f64.to_radians(),
            imu_rad: 0.07_f64.to_radians(),
            eyes_rad: 0.04_f64.to_radians(),
            clock_s: 3e-4,
        }
    }
}

/// One camera's comparisons.
#[derive(Clone, Debug, Serialize)]
pub struct CameraEstimate {
    /// The camera.
    pub name: String,
    /// Its eyes against each other, where enough was matched.
    pub eyes: Option<StereoAlignment>,
    /// It against its own gyroscope, where enough turned.
    pub imu: Option<CameraImu>,
}

/// Two gyroscopes' comparison.
#[derive(Clone, Debug, Serialize)]
pub struct GyroPairEstimate {
    /// The cameras they are in.
    pub of: [String; 2],
    /// The second against the first.
    pub gyros: GyroAlignment,
}

/// Everything that was found.
#[derive(Clone, Debug, Serialize)]
pub struct Verification {
    /// Cameras in the order given.
    pub cameras: Vec<CameraEstimate>,
    /// Pairs of gyroscopes whose places are told.
    pub pairs: Vec<GyroPairEstimate>,
    /// What that means, told number by told number.
    pub findings: Vec<Finding>,
}

/// Compares what is told of a rig with what it saw: [`compare`] for each camera, then [`judge`].
pub fn verify(cameras: &[Camera<'_>], tolerances: &Tolerances) -> Verification {
    let found = cameras.iter().map(compare).collect();
    judge(cameras, found, tolerances)
}

/// Compares one camera's eyes, and the camera with its own gyroscope. Where the camera sits on the rig has no part in it.
pub fn compare(camera: &Camera<'_>) -> CameraEstimate {
    let eyes = stereo::estimate(camera.nominal, camera.bursts);
    let imu = eyes.as_ref().zip(camera.gyro).and_then(|(eyes, gyro)| {
        camera_imu::estimate(camera.nominal, eyes, camera.line_s, gyro, camera.bursts)
    });
    CameraEstimate {
        name: camera.name.to_owned(),
        eyes,
        imu,
    }
}

/// Compares the gyroscopes, and says what all that means. `found` are the cameras' comparisons in the same order.
pub fn judge(
    cameras: &[Camera<'_>],
    found: Vec<CameraEstimate>,
    tolerances: &Tolerances,
) -> Verification {
    let mut pairs = Vec::new();
    for (b, second) in cameras.iter().enumerate() {
        for (a, first) in cameras[..b].iter().enumerate() {
            let rig_from_imu = |camera: &Camera<'_>| {
                let imu = camera.nominal.imu.as_ref()?;
                Some(camera.rig_from_left? * imu.imu_from_left.inverse())
            };
            let gyros = || {
                let b_from_a = rig_from_imu(second)?.inverse() * rig_from_imu(first)?;
                gyro_pairs::estimate(b_from_a.rotation(), first.gyro?, second.gyro?)
            };
            pairs.extend(gyros().map(|gyros| (a, b, gyros)));
        }
    }
    let findings = findings::judge(cameras, &found, &pairs, tolerances);
    let name = |i: usize| cameras[i].name.to_owned();
    let pairs = pairs.into_iter().map(|(a, b, gyros)| GyroPairEstimate {
        of: [name(a), name(b)],
        gyros,
    });
    Verification {
        pairs: pairs.collect(),
        cameras: found,
        findings,
    }
}
