//! Sessions that are rendered, so that blur and noise are those of images and detection is
//! included.

use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use anyhow::Result;
use boards::Target;
use calib::cameras::{Input, TargetDetection, calibrate};
use calib::target::{self, ImageView};
use rig_sim::simulation::{Imaging, Simulation};

use super::scenario::{Impairments, Recording};
use super::{Point, judge, quiet};

/// Exposures, ms, and multiples of the usual noise.
const EXPOSURES_MS: &[f64] = &[2.0, 8.0, 20.0, 40.0, 80.0];
const NOISES: &[f64] = &[1.0, 4.0, 10.0, 20.0];

/// All of them.
pub(super) fn points(quick: bool) -> Result<Vec<Point>> {
    let mut points = Vec::new();
    let mut one = |kind: &'static str, strength: f64, imaging: Imaging| -> Result<()> {
        eprintln!("{kind}: {strength} ...");
        let mut recording = Recording::new(11, &Impairments::default())?;
        recording.simulation = recording.simulation.clone().with_imaging(imaging)?;
        let input = detect(&recording, if quick { 2 } else { 1 });
        let result = calibrate(input, &quiet(), &mut |_, _| {});
        points.push(judge(kind, strength, 11, &recording, result));
        Ok(())
    };
    for (i, &ms) in EXPOSURES_MS.iter().enumerate() {
        if !quick || i % 2 == 0 {
            let imaging = Imaging {
                exposure_s: Some(1e-3 * ms),
                ..Imaging::USUAL
            };
            one("exposure, rendered", ms, imaging)?;
        }
    }
    for (i, &noise) in NOISES.iter().enumerate() {
        if !quick || i % 2 == 0 {
            let imaging = Imaging {
                noise,
                ..Imaging::USUAL
            };
            one("image noise, rendered", noise, imaging)?;
        }
    }
    Ok(points)
}

/// Target detections in every `every`-th frame.
pub(super) fn detect(recording: &Recording, every: usize) -> Input {
    let mut input = recording.input(0.1);
    input.detections.clear();
    let simulation = Arc::new(recording.simulation.clone());
    let found: Mutex<Vec<TargetDetection>> = Mutex::new(Vec::new());
    thread::scope(|scope| {
        for camera in 0..simulation.cameras().len() {
            let (simulation, targets, found) = (&simulation, &input.targets, &found);
            scope.spawn(move || {
                let own = one_camera(simulation, camera, targets, every);
                found
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .extend(own);
            });
        }
    });
    input.detections = found.into_inner().unwrap_or_else(PoisonError::into_inner);
    input
        .detections
        .sort_by_key(|s| (s.instant, s.eye, s.target));
    input
}

fn one_camera(
    simulation: &Arc<Simulation>,
    camera: usize,
    targets: &[Target],
    every: usize,
) -> Vec<TargetDetection> {
    let settings = simulation.settings();
    let (width, height) = (settings.width as usize, settings.height as usize);
    let mut found = Vec::new();
    let mut images = simulation.frames(camera);
    for instant in (0..settings.frame_count()).step_by(every) {
        let frame = images.expose(instant, settings.frame_ns(instant));
        let instant = instant as usize;
        for side in 0..2 {
            let luma = &frame.i420[side * width..frame.width * height];
            let Some(view) = ImageView::new(width, height, frame.width, luma) else {
                continue;
            };
            let seen = target::detect_all(&view, targets, &target::Config::default());
            for (target, detection) in seen.into_iter().enumerate() {
                if !detection.corners.is_empty() {
                    found.push(TargetDetection {
                        instant,
                        eye: 2 * camera + side,
                        target,
                        corners: detection.corners,
                    });
                }
            }
        }
    }
    found
}
