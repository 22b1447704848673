//! Real recordings with a right eye whose nominal rotation is falsified, without truth of their
//! own: what counts is that the estimate changes by the error, or that it is said not to be
//! determined.

use anyhow::Result;
use cad_transforms::RigidTransform;
use calib::verify::{
    Burst, Camera, Config, FeatureTracker, Gyro, Parameter, StereoFrame, Tolerances, choose_bursts,
    verify,
};
use camera_models::StereoCalibration;
use harness::sequences::{self, Sequence};
use serde::Serialize;

use super::infinity::{self, Infinity};

/// Length of a burst, ns, and their number at most, as `paws calib verify` has them.
const BURST_NS: i64 = 1_050_000_000;
const BURSTS: usize = 16;
/// Rotations of the right eye, degrees.
const ROTATIONS_DEG: [f64; 5] = [0.0, 0.05, 0.1, 0.2, 0.3];

/// One recording, one error.
#[derive(Clone, Debug, Serialize)]
pub(super) struct RealPoint {
    recording: String,
    /// Falsified axis of the right optical frame: 0 x, 1 y, 2 z.
    axis: usize,
    rotation_deg: f64,
    /// Estimate about x, y and z, degrees, and its sigmas.
    estimate_deg: [f64; 3],
    sigma_deg: [f64; 3],
    /// Segments with parallax.
    parallax_segments: usize,
    text: String,
    /// The rotation about y without the error, by another way, where positions are known.
    infinity: Option<Infinity>,
}

/// Runs all recordings that are available; the others are skipped with a printed reason.
///
/// # Errors
/// Images that cannot be read.
pub(super) fn run() -> Result<Vec<RealPoint>> {
    let mut points = Vec::new();
    match harness::data::sets(["02_stereo_odometry_kitti/KITTI_sequence_1"]) {
        Ok([folder]) => points.extend(recording(&sequences::kitti(&folder)?)?),
        Err(reason) => eprintln!("{reason}"),
    }
    match harness::data::sets([
        "03_stereo_imu/euroc_V1_01_micro",
        "03_stereo_imu/euroc_groundtruth/V1_01_easy.csv",
    ]) {
        Ok([folder, truth]) => {
            points.extend(recording(&sequences::euroc(&folder, &truth, None)?)?);
        }
        Err(reason) => eprintln!("{reason}"),
    }
    Ok(points)
}

fn recording(sequence: &Sequence) -> Result<Vec<RealPoint>> {
    let camera = &sequence.rig().cameras[0];
    let nominal = StereoCalibration {
        left: camera.left,
        right: camera.right,
        right_from_left: camera.right_from_left,
        imu: None,
        provenance: camera_models::Provenance {
            format: None,
            files: Vec::new(),
            part: None,
        },
    };
    let bursts = bursts(sequence, &nominal)?;
    let infinity = infinity::measure(sequence, &nominal, &bursts);
    if let Some(found) = &infinity {
        println!(
            "{} by true positions: disparity at infinity {:.2} ± {:.2} px, {:.3} ± {:.3}° about y, baseline {:.4} of nominal, {} features",
            sequence.name(),
            found.px,
            found.sigma_px,
            found.deg,
            found.sigma_deg,
            found.baseline_ratio,
            found.features
        );
    }
    let mut points = Vec::new();
    for (axis, deg) in (0..3).flat_map(|axis| ROTATIONS_DEG.map(|deg| (axis, deg))) {
        if axis > 0 && deg == 0.0 {
            continue;
        }
        let mut turn = [0.0; 3];
        turn[axis] = deg.to_radians();
        let turned = RigidTransform::from_rotation_vector(turn, [0.0; 3])?;
        let mut wrong = nominal.clone();
        wrong.right_from_left = turned.inverse() * nominal.right_from_left;
        let camera = Camera {
            name: sequence.name(),
            nominal: &wrong,
            rig_from_left: None,
            joint_sigma_rad: None,
            line_s: Some(0.0),
            bursts: &bursts,
            gyro: None,
        };
        let found = verify(&[camera], &Tolerances::default(), &Config::default());
        let finding = (found.findings.iter()).find(|f| f.parameter == Parameter::StereoRotation);
        let eyes = found.cameras[0].eyes.as_ref();
        let degrees = |rad: [f64; 3]| rad.map(f64::to_degrees);
        let point = RealPoint {
            recording: sequence.name().to_owned(),
            axis,
            rotation_deg: deg,
            estimate_deg: eyes.map_or([f64::NAN; 3], |e| degrees(e.rotation_rad)),
            sigma_deg: eyes.map_or([f64::NAN; 3], |e| degrees(e.sigma_rad)),
            parallax_segments: eyes.map_or(0, |e| e.parallax_segments),
            infinity: infinity.clone(),
            text: finding.map_or_else(String::new, |f| f.text.clone()),
        };
        println!("{}", point.line());
        points.push(point);
    }
    Ok(points)
}

fn bursts(sequence: &Sequence, nominal: &StereoCalibration) -> Result<Vec<Burst>> {
    let config = Config::default();
    let times: Vec<i64> = sequence.times().collect();
    let span = [times[0], times[times.len() - 1]];
    let planned = choose_bursts(&[] as &[&Gyro], span, BURSTS, BURST_NS, &config.bursts);
    let mut tracker = FeatureTracker::new(nominal, None, &config);
    let mut bursts = vec![Burst::default(); planned.len()];
    let mut within = None;
    sequence.for_each(|set| {
        let now = planned
            .iter()
            .position(|[from, to]| (*from..=*to).contains(&set.time_ns));
        if now != within
            && let Some(burst) = within
        {
            bursts[burst] = tracker.end();
        }
        within = now;
        if let (Some(_), Some(view)) = (now, &set.borrowed().views[0]) {
            tracker.push(&StereoFrame {
                time_ns: view.time_ns,
                left: view.left,
                right: view.right,
            });
        }
        Ok(())
    })?;
    if let Some(burst) = within {
        bursts[burst] = tracker.end();
    }
    Ok(bursts)
}

impl RealPoint {
    fn line(&self) -> String {
        let axes: Vec<String> = (self.estimate_deg.iter().zip(&self.sigma_deg))
            .map(|(value, sigma)| format!("{value:.3} ± {sigma:.3}"))
            .collect();
        format!(
            "{} {}° about {}: {}°, {} segments with parallax: {}",
            self.recording,
            self.rotation_deg,
            ["x", "y", "z"][self.axis],
            axes.join(", "),
            self.parallax_segments,
            self.text
        )
    }
}
