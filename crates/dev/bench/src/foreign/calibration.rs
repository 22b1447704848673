//! The check of a calibration on the rendered walk, as it is and with the right eye rotated.

use anyhow::{Context, Result};
use cad_transforms::RigidTransform;
use calib::verify::{
    BurstConfig, Camera, Config, FeatureTracker, Gyro, StereoFrame, Tolerances, choose_bursts,
    verify,
};
use harness::sequences::OwnedFrameSet;
use odometry::input::View;
use serde_json::{Value, json};

use super::Walk;

/// Rotations of the right eye about y, degrees.
const ROTATIONS_DEG: [f64; 5] = [0.0, 0.1, 0.2, 0.3, 0.5];
/// Bursts, and the length of each, as in an ordinary check.
const BURSTS: usize = 8;
const BURST_NS: i64 = 1_050_000_000;

/// The findings for each rotation.
pub(super) fn rows(walk: &Walk) -> Result<Value> {
    let (width, height) = {
        let lens = &walk.sequence.rig().cameras[0].left;
        (lens.width, lens.height)
    };
    let mav = walk.folder.join("mav0");
    let (calibration, _) = calibration_files::read_stereo(&mav, width, height)?;
    let samples = walk.sequence.imu()[0].iter();
    let gyro = Gyro::new(samples.map(|s| (s.time_ns, s.gyro)));
    let times: Vec<i64> = walk.sequence.times().collect();
    let span = [times[0], *times.last().context("an empty walk")?];
    let bursts = choose_bursts(&[&gyro], span, BURSTS, BURST_NS, &BurstConfig::default());
    let sets: Vec<OwnedFrameSet> = walk.sequence.frame_sets()?.collect::<Result<_>>()?;
    // Features are tracked once; an error of the nominal calibration needs no other tracks.
    let mut tracker = FeatureTracker::new(&calibration, Some(&gyro), &Config::default());
    let mut tracks = Vec::new();
    for [from, to] in bursts {
        for set in sets.iter().filter(|s| (from..=to).contains(&s.time_ns)) {
            let view = View::from(set.views[0].as_ref().context("a pair without images")?);
            tracker.push(&StereoFrame {
                time_ns: view.time_ns,
                left: view.left,
                right: view.right,
            });
        }
        tracks.push(tracker.end());
    }
    let mut rows = Vec::new();
    for deg in ROTATIONS_DEG {
        let vector = [0.0, deg.to_radians(), 0.0];
        let mut nominal = calibration.clone();
        nominal.right_from_left =
            RigidTransform::from_rotation_vector(vector, [0.0; 3])? * nominal.right_from_left;
        let camera = Camera {
            name: "camera",
            nominal: &nominal,
            rig_from_left: None,
            joint_sigma_rad: None,
            line_s: Some(0.0),
            bursts: &tracks,
            gyro: Some(&gyro),
        };
        let found = verify(&[camera], &Tolerances::default(), &Config::default());
        let findings = found.findings.iter().map(|f| {
            json!({
                "parameter": f.parameter,
                "status": f.status,
                "estimate": f.estimate,
                "sigma": f.sigma,
                "min_detectable": f.min_detectable,
                "text": f.text,
            })
        });
        rows.push(json!({ "right_eye_deg": deg, "findings": findings.collect::<Vec<_>>() }));
    }
    Ok(Value::Array(rows))
}
