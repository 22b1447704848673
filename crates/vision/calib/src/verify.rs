//! Calibration check from an ordinary recording, without a target.
//!
//! [`verify`] compares the observations of a rig's cameras and gyroscopes with their nominal
//! calibration: the eyes of each camera with one another, each camera with its own gyroscope, the
//! gyroscopes with one another, and through these the cameras. Each comparison has a covariance;
//! together they show which parameter is inconsistent, by how much, and which of several cameras it
//! belongs to.
//!
//! Contract: images come in as the features that [`FeatureTracker`] tracks in short bursts
//! ([`choose_bursts`] selects their times). A parameter that the recording does not constrain (no
//! texture, no rotation, too short) is [`Status::Undetermined`], which is no verdict. A parameter
//! is *inconsistent* if its deviation exceeds the tolerance of its joint and the uncertainty of the
//! measurement together ([`DecisionConfig::detection_sigma`]). Parts of the scene may move; the
//! motion of most of the image counts as static. The same input gives the same result.
//!
//! Each part documents its method; capabilities and limits: `docs/guides/calibration-verify.md`.

use serde::Serialize;

mod bursts;
mod camera;
mod camera_estimate;
mod camera_imu;
mod config;
mod corners;
mod decision;
mod epipolar_search;
mod findings;
mod gyro;
mod gyro_pairs;
mod motion;
mod pair;
mod parallax;
mod pyramid;
mod robust;
mod segment;
mod stereo;
#[cfg(test)]
mod tests;
mod tracks;

pub use bursts::choose_bursts;
pub use camera::{Camera, Tolerances};
pub use camera_estimate::CameraEstimate;
pub use camera_imu::CameraImu;
pub use config::{
    BurstConfig, CameraImuConfig, Config, CornerConfig, DecisionConfig, GyroPairConfig,
    MotionConfig, ParallaxConfig, ReadoutConfig, SearchConfig, StereoConfig, TrackingConfig,
};
pub use findings::{Finding, Parameter, Status};
pub use gyro::Gyro;
pub use gyro_pairs::GyroAlignment;
pub use stereo::StereoAlignment;
pub use tracks::{Burst, Feature, FeatureTracker, StereoFrame, TrackSegment};

/// Comparison of two gyroscopes.
#[derive(Clone, Debug, Serialize)]
pub struct GyroPairEstimate {
    /// Their cameras.
    pub of: [String; 2],
    /// The second against the first.
    pub gyros: GyroAlignment,
}

/// Result of a verification.
#[derive(Clone, Debug, Serialize)]
pub struct Verification {
    /// Configuration of the verification.
    pub config: Config,
    /// Cameras in the order given.
    pub cameras: Vec<CameraEstimate>,
    /// Pairs of gyroscopes with nominal extrinsics.
    pub pairs: Vec<GyroPairEstimate>,
    /// Findings, one per nominal parameter.
    pub findings: Vec<Finding>,
}

/// Compares the nominal calibration of a rig with its observations: [`compare`] for each camera,
/// then [`judge`].
pub fn verify(cameras: &[Camera<'_>], tolerances: &Tolerances, config: &Config) -> Verification {
    let found = cameras
        .iter()
        .map(|camera| compare(camera, config))
        .collect();
    judge(cameras, found, tolerances, config)
}

/// Compares one camera's eyes, and the camera with its own gyroscope. The pose of the camera on the
/// rig is not used.
pub fn compare(camera: &Camera<'_>, config: &Config) -> CameraEstimate {
    let eyes = stereo::estimate(camera, config);
    let imu = eyes
        .as_ref()
        .zip(camera.gyro)
        .and_then(|(eyes, gyro)| camera_imu::estimate(camera, eyes, gyro, config));
    CameraEstimate {
        name: camera.name.to_owned(),
        eyes,
        imu,
    }
}

/// Compares the gyroscopes and decides on all parameters. `found` are the comparisons of the
/// cameras in the same order.
pub fn judge(
    cameras: &[Camera<'_>],
    found: Vec<CameraEstimate>,
    tolerances: &Tolerances,
    config: &Config,
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
                gyro_pairs::estimate(b_from_a.rotation(), first.gyro?, second.gyro?, config)
            };
            pairs.extend(gyros().map(|gyros| (a, b, gyros)));
        }
    }
    let findings = findings::judge(cameras, &found, &pairs, tolerances, &config.decision);
    let name = |i: usize| cameras[i].name.to_owned();
    let pairs = pairs.into_iter().map(|(a, b, gyros)| GyroPairEstimate {
        of: [name(a), name(b)],
        gyros,
    });
    Verification {
        config: *config,
        pairs: pairs.collect(),
        cameras: found,
        findings,
    }
}
