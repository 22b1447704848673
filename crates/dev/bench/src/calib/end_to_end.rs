//! End to end: sessions are rendered with the usual blur and noise, boards are detected, and a rig
//! with the extrinsics and time offsets of its IMUs is estimated. Images are stamped a few
//! milliseconds late, which must be estimated.

use anyhow::{Context, Result};
use cad_transforms::frame::{Frame, FramePart};
use cad_transforms::{Rig, RigidTransform};
use calib::camera_imu::simulate::ZED_NOISE;
use calib::camera_imu::{
    CameraImu, Cameras, Config, Corner, ImuSample, Priors, Recording as MotionRecording,
    TargetObservation, Verdict, estimate,
};
use calib::cameras::{Calibration, Severity, calibrate};
use camera_models::Eye;
use nalgebra::Vector3;
use rig_sim::camera::Shutter;
use rig_sim::simulation::Simulation;
use serde_json::{Value, json};

use super::quiet;
use super::rendered::detect;
use super::scenario::{Impairments, Recording};
use crate::meter::timed;

/// Time offset of each camera's timestamps, ms.
const TIME_OFFSET_MS: [f64; 3] = [1.7, -2.6, 4.2];

/// Errors of one kind: the worst one, and the number within two of the stated sigmas.
#[derive(Default)]
struct Errors {
    worst: f64,
    within: u32,
    all: u32,
}

impl Errors {
    fn add(&mut self, size: f64, sigmas: impl IntoIterator<Item = f64>) {
        self.worst = self.worst.max(size);
        for sigma in sigmas {
            self.within += u32::from(sigma.abs() <= 2.0);
            self.all += 1;
        }
    }

    fn json(&self) -> Value {
        json!({ "worst": self.worst, "within_two_sigma": self.within, "of": self.all })
    }
}

/// Errors of some sessions.
pub(super) fn sessions(count: u64) -> Result<Value> {
    let (mut rms_px, mut failed, mut seconds) = (0.0_f64, 0, 0.0);
    let (mut places_mm, mut places_deg) = (Errors::default(), 0.0_f64);
    let [mut turn_deg, mut shift_mm, mut late_ms] = [(); 3].map(|()| Errors::default());
    for seed in 0..count {
        eprintln!("rendered session {seed} ...");
        let impairments = Impairments {
            late_ms: TIME_OFFSET_MS,
            ..Impairments::default()
        };
        let recording = Recording::new(2000 + seed, &impairments)?;
        let input = detect(&recording, 1);
        let (found, took) = timed(|| calibrate(input, &quiet(), &mut |_, _| {}));
        let found = found.context("calibrating cameras")?;
        seconds += took.cpu_s;
        failed += usize::from(found.severity() == Some(Severity::Fail));
        rms_px = rms_px.max(found.solution.rms_px(|_| true));
        for error in recording.errors(&found) {
            places_mm.worst = places_mm.worst.max(1e3 * error.metres);
            places_deg = places_deg.max(error.degrees);
            places_mm.within += error.inside;
            places_mm.all += 6;
        }
        let simulation = &recording.simulation;
        let truth = Rig::parse(&simulation.true_rig_toml(&recording.rig))?;
        for (camera, nominal_time_offset_ms) in TIME_OFFSET_MS.iter().enumerate() {
            let (result, priors) =
                imu_calibration(simulation, &recording.rig, &truth, camera, &found)?;
            failed += usize::from(result.verdict() == Verdict::Fail);
            let turn =
                (priors.rotation().inverse() * result.imu_from_left.rotation()).scaled_axis();
            let shift: Vector3<f64> = result.imu_from_left.translation() - priors.translation();
            let sigmas = &result.sigmas;
            turn_deg.add(
                turn.norm().to_degrees(),
                (0..3).map(|k| turn[k] / sigmas.rotation_rad[k]),
            );
            shift_mm.add(
                1e3 * shift.norm(),
                (0..3).map(|k| shift[k] / sigmas.translation_m[k]),
            );
            let late = result.time_offset_s + 1e-3 * nominal_time_offset_ms;
            late_ms.add(1e3 * late.abs(), [late / sigmas.time_offset_s]);
        }
    }
    Ok(json!({
        "sessions": count,
        "failed": failed,
        "rms_px": rms_px,
        "calibrating_cpu_s": seconds / count as f64,
        "cameras_mm": places_mm.json(),
        "cameras_worst_deg": places_deg,
        "imu_deg": turn_deg.json(),
        "imu_mm": shift_mm.json(),
        "offset_ms": late_ms.json(),
    }))
}

/// Estimate of a camera's IMU, and its true extrinsics.
fn imu_calibration(
    simulation: &Simulation,
    rig: &Rig,
    truth: &Rig,
    camera: usize,
    found: &Calibration,
) -> Result<(CameraImu, RigidTransform)> {
    let of = &simulation.cameras()[camera];
    let [left, imu] = [FramePart::Left, FramePart::Imu]
        .map(|part| Frame::of_camera(&of.name, part).expect("a camera of the rig"));
    let pair = found.poses.pairs[camera].context("the right eye was not found")?;
    let right_from_left = found.pose(pair).0.inverse();
    let (lens, right) = (found.lens(2 * camera), found.lens(2 * camera + 1));
    let line_s = match of.shutter {
        Shutter::Global => 0.0,
        Shutter::Rolling { line_s } => line_s,
    };
    let cameras = Cameras::new(lens, Some((right, &right_from_left))).with_rolling_shutter(line_s);
    let sensor = &simulation.imus()[camera];
    let samples = simulation
        .samples(sensor)
        .map(|(_, time_ns, sample)| ImuSample {
            time_ns,
            gyro: sample.gyro.into(),
            accel: sample.accel.into(),
        });
    let recording = MotionRecording {
        cameras,
        observations: observations(found, camera),
        imu: samples.collect(),
        noise: ZED_NOISE,
        range: sensor.imu.model().range,
    };
    let priors = Priors {
        imu_from_left: Some(rig.transform(&imu, &left)?),
        ..Priors::default()
    };
    let result = estimate(&recording, &priors, &Config::default())
        .with_context(|| format!("the IMU of {}", of.name))?;
    Ok((result, truth.transform(&imu, &left)?))
}

/// Detections in both images of a camera of the board with most detections.
fn observations(found: &Calibration, camera: usize) -> Vec<TargetObservation> {
    let input = &found.input;
    let own = || {
        let all = input.detections.iter();
        all.filter(move |s| s.eye / 2 == camera)
    };
    let seen = |target: usize| -> usize {
        own()
            .filter(|s| s.target == target)
            .map(|s| s.corners.len())
            .sum()
    };
    let board = (0..input.targets.len())
        .max_by_key(|target| seen(*target))
        .unwrap_or(0);
    let known = input.targets[board].corners();
    let mut observations: Vec<TargetObservation> = input
        .times_ns
        .iter()
        .map(|time_ns| TargetObservation {
            time_ns: *time_ns,
            corners: Vec::new(),
        })
        .collect();
    for sighting in own().filter(|s| s.target == board) {
        let eye = if sighting.eye % 2 == 0 {
            Eye::Left
        } else {
            Eye::Right
        };
        let corners = sighting.corners.iter().filter_map(|seen| {
            let at = known.binary_search_by_key(&seen.id, |c| c.id).ok()?;
            let [x, y] = known[at].at_m;
            Some(Corner {
                x_in_target: [x, y, 0.0],
                pixel: seen.pixel,
                sigma_px: seen.sigma_px.max(0.05),
                eye,
            })
        });
        observations[sighting.instant].corners.extend(corners);
    }
    observations
}
