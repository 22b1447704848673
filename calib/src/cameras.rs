//! `paws calib cameras`: intrinsics, stereo extrinsics and the rig, from a session in which targets
//! were shown.
//!
//! Results are printed and written as `cameras.json` and `cameras.html`. The rig file, `rig.toml`,
//! and the cameras' calibrations are written only if no gate fails; otherwise the failed gates are
//! listed, the exit code is 1, and such files of an earlier run are removed.
//!
//! The rig file is a new revision of the given one. Without one it is the first revision, and the
//! first camera is its origin: `rig` is at that camera's left lens, x along the view, y to the
//! left, z up in the image.

mod document;
mod page;
mod plots;

use std::path::PathBuf;

use anyhow::{Result, bail, ensure};
use boards::Target as Board;
use cad_transforms::{Frame, FramePart, Rig};
use calib::cameras::{Calibration, Camera, Config, Eye, Input, Severity, calibrate};
use calibration_files::{Format, contents};
use camera_models::{CameraModel, CameraSet, Provenance as CalibProvenance, StereoCalibration};
use clap::Args;
use console_output::{Console, Outcome, text};
use session_access::{SessionFolder, open, read_or_build};
use session_archive::manifest::Manifest;

use super::nominal_rig::NominalRig;
use super::rig_file::{self, Joint, revised};
use super::rig_poses;
use super::target_detections::{self, DetectedTargets};
use crate::results::Output;

/// The JSON document.
pub(crate) const DOCUMENT: &str = "cameras.json";
/// The report.
pub(crate) const PAGE: &str = "cameras.html";
/// The calibrated rig file.
pub(crate) const RIG: &str = "rig.toml";

/// Options of `paws calib cameras`.
#[derive(Clone, Debug, Default, Args)]
pub(crate) struct Options {
    /// A target's description, as `paws calib targets` writes it, or Kalibr's; once for each that
    /// was shown [default: those in the session]
    #[arg(long = "target", value_name = "FILE")]
    pub(crate) targets: Vec<PathBuf>,
    /// The rig file to start from [default: the session's; without any the first camera is the
    /// origin of a new one]
    #[arg(long, value_name = "FILE")]
    pub(crate) rig: Option<PathBuf>,
    /// Keep the lens model of the factory's file instead of choosing one
    #[arg(long)]
    pub(crate) keep_model: bool,
}

/// Calibrates the cameras of a session.
///
/// # Errors
/// The session cannot be read, no target was detected often enough, an output file exists already,
/// or it cannot be written.
pub(crate) fn run(
    session: &SessionFolder,
    options: &Options,
    output: &Output,
    console: &mut Console<'_>,
) -> Result<Outcome> {
    let reader = open(&session.folder)?;
    let mut possible_files = vec![DOCUMENT.to_owned(), PAGE.to_owned(), RIG.to_owned()];
    possible_files.extend(reader.manifest().cameras.iter().map(|c| file_of(&c.name)));
    let results = output.prepare(output.folder(session)?, possible_files)?;
    let boards = target_detections::targets(&reader, &options.targets)?;
    let mut nominal = NominalRig::read(&reader)?;
    if let Some(path) = &options.rig {
        nominal.replace_rig_file(path)?;
        let mut cameras = reader.manifest().cameras.iter();
        ensure!(
            cameras.any(|camera| nominal.rig_from_left(&camera.name).is_some()),
            "taking the rig file of --rig: it has none of the session's cameras, so its frame is unknown: {}",
            path.display()
        );
    }
    let index = read_or_build(&reader, console)?;
    let detected = target_detections::detect(&reader, &index, &boards, console)?;
    ensure!(
        !detected.detections.is_empty(),
        "none of {} was detected in {}: do the descriptions match the boards? {}",
        text::count(boards.len() as u64, "target"),
        text::count(detected.images, "stereo frame"),
        session.folder.display()
    );
    let missing = detected.missing;
    let input = input(reader.manifest(), &nominal, boards, detected)?;
    let mut config = Config::default();
    config.choose_lens = !options.keep_model;
    let found = {
        let progress = console.progress("calibrating", 1000);
        let mut done = 0;
        let result = calibrate(input, &config, &mut |_, share| {
            let now = (1000.0 * share) as u64;
            progress.add(now.saturating_sub(done));
            done = done.max(now);
        });
        result?
    };
    let failed = found.severity() == Some(Severity::Fail);
    let manifest = reader.manifest();
    let rig = match calibrated(&nominal, &found, manifest) {
        // A failed result need not form a valid rig.
        Err(_) if failed => None,
        rig => rig?,
    };
    let rig = rig.as_ref();
    let mut files = vec![
        (DOCUMENT.to_owned(), document::json(manifest, &found, rig)?),
        (
            PAGE.to_owned(),
            page::html(manifest, &found, rig)?.into_bytes(),
        ),
    ];
    let mut without_rig = None;
    if failed {
        without_rig = Some("see what is marked FAIL");
    } else {
        for (name, set) in stereo(&found) {
            let [(_, bytes)] = &contents(&set, format_of(&set))?[..] else {
                bail!("writing {name}: its format has several files");
            };
            files.push((name, bytes.clone()));
        }
        // Written last: its existence means that the other files are complete.
        match rig {
            Some(rig) => files.push((RIG.to_owned(), rig.to_toml().into_bytes())),
            None => without_rig = nominal.unreadable.as_deref(),
        }
    }
    for line in document::lines(&found) {
        console.line(line)?;
    }
    if let Some(rig) = rig {
        for line in rig_poses::lines(rig)? {
            console.line(line)?;
        }
        console.line("")?;
    }
    results.write(&files, console)?;
    if let Some(reason) = without_rig {
        console.line(format!("no rig file was written: {reason}"))?;
    }
    Ok(match (failed, missing) {
        (true, _) => Outcome::Failed,
        (false, 0) => Outcome::Fine,
        (false, _) => Outcome::Loss,
    })
}

/// The file of a camera's calibration.
pub(super) fn file_of(camera: &str) -> String {
    format!("{camera}.yaml")
}

/// Input of the estimation.
fn input(
    manifest: &Manifest,
    nominal: &NominalRig,
    targets: Vec<Board>,
    detected: DetectedTargets,
) -> Result<Input> {
    let mut input = Input {
        targets,
        times_ns: detected.times_ns,
        detections: detected.detections,
        ..Input::default()
    };
    for (number, camera) in manifest.cameras.iter().enumerate() {
        for side in ["left", "right"] {
            let name = format!("{}/{side}", camera.name);
            input.eyes.push(Eye {
                size: (camera.width / 2, camera.height),
                factory: nominal.lens(&name),
                name,
            });
        }
        input.cameras.push(Camera {
            name: camera.name.clone(),
            left: 2 * number,
            right: Some(2 * number + 1),
            left_from_right: nominal.left_from_right(&camera.name),
            rig_from_left: nominal.rig_from_left(&camera.name),
        });
    }
    Ok(input)
}

/// OpenCV's format, which most programs read; Kalibr's for models that OpenCV does not have.
fn format_of(set: &CameraSet) -> Format {
    let model = |m: &CameraModel| m.distortion.name();
    match set
        .cameras
        .iter()
        .any(|c| ["double_sphere", "eucm"].contains(&model(&c.model)))
    {
        true => Format::Kalibr,
        false => Format::OpenCv,
    }
}

/// The calibration of every camera, by file name.
fn stereo(found: &Calibration) -> Vec<(String, CameraSet)> {
    let cameras = found.input.cameras.iter().enumerate();
    let of = |(number, camera): (usize, &Camera)| {
        let (right, results) = (camera.right?, found.poses.pairs[number]?);
        let set = CameraSet::of_stereo(&StereoCalibration {
            left: *found.lens(camera.left),
            right: *found.lens(right),
            right_from_left: found.pose(results).0.inverse(),
            imu: None,
            provenance: CalibProvenance {
                format: None,
                files: Vec::new(),
                part: None,
            },
        });
        Some((file_of(&camera.name), set))
    };
    cameras.filter_map(of).collect()
}

/// The calibrated rig: a new revision of the given one, or the first one. `None` if the session's
/// rig file cannot be read, because its revision is then unknown.
fn calibrated(
    nominal: &NominalRig,
    found: &Calibration,
    manifest: &Manifest,
) -> Result<Option<Rig>> {
    let mut joints = joints(found)?;
    if let Some((_, rig)) = &nominal.rig {
        return revised(rig, &joints, "cameras", "calibrated", manifest).map(Some);
    }
    if nominal.unreadable.is_some() {
        return Ok(None);
    }
    // IMU extrinsics are those of the factory calibrations.
    for camera in &found.input.cameras {
        let left = Frame::of_camera(&camera.name, FramePart::Left)?;
        let imu = Frame::of_camera(&camera.name, FramePart::Imu)?;
        if let Some(left_from_imu) = nominal.frames.transform(left.as_str(), imu.as_str()) {
            joints.push(Joint {
                parent: left,
                child: imu,
                parent_from_child: left_from_imu,
                covariance: None,
            });
        }
    }
    let frame = match found.input.origin() {
        Some(origin) => format!(
            "from boards alone: the rig's frame is at the left lens of {}, x along its view, y to its left, z up in its image",
            found.input.cameras[origin].name
        ),
        None => "starting from the extrinsics recorded with the session".to_owned(),
    };
    rig_file::first(&joints, "cameras", &frame, manifest).map(Some)
}

/// The estimated extrinsics.
fn joints(found: &Calibration) -> Result<Vec<Joint>> {
    let mut joints = Vec::new();
    let mut put = |parent: &Frame, child: &Frame, results: usize| {
        let (parent_from_child, covariance) = found.pose(results);
        joints.push(Joint {
            parent: parent.clone(),
            child: child.clone(),
            parent_from_child,
            covariance: Some(covariance),
        });
    };
    for (number, camera) in found.input.cameras.iter().enumerate() {
        let left = Frame::of_camera(&camera.name, FramePart::Left)?;
        let right = Frame::of_camera(&camera.name, FramePart::Right)?;
        if let Some(results) = found.poses.cameras[number] {
            put(&Frame::rig(), &left, results);
        }
        if let Some(results) = found.poses.pairs[number] {
            put(&left, &right, results);
        }
    }
    Ok(joints)
}
